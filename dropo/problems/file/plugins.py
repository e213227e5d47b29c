"""The key `plugins` of a problem file: Python files with parts of one's own."""

from pathlib import Path

from dropo.core.services.errors import BadEntry
from dropo.core.services.files.file_content import FileContent
from dropo.core.services.files.places import way_to
from dropo.core.services.plugin_files import is_loaded, load_plugins
from dropo.problems.file.schema import ProblemFile


def run_plugins(file: FileContent[ProblemFile], *, trusted: bool) -> tuple[str, ...]:
    """Import the files that a problem file names, those first that it names first.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    trusted : bool
        Whether they may be run. Files that this process has imported as they are, such as those of
        `--plugin`, are not run again.

    Returns
    -------
    tuple of str
        Their paths.

    Raises
    ------
    BadFile
        If one is missing, may not be run, or cannot be imported; none is run before all are there.
    """
    places = [file.path.parent / name for name in file.content.plugins]
    for i, place in enumerate(places):
        if not place.is_file():
            got = file.content.plugins[i]
            raise file.refusal(f"plugins.{i}", "a Python file, by its path from this file", got)
    for i, place in enumerate(places):
        if is_loaded(place):
            continue
        if not trusted:
            raise BadEntry(
                file.path,
                f"plugins.{i}",
                f"{file.content.plugins[i]!r} is Python code, which runs only where it is trusted:"
                f" give --plugin {place} (or --trust, which some commands have), or load the"
                " problem in Python.",
            )
        load_plugins(place, f"plugins of {file.path.name}")
    return tuple(str(place.resolve()) for place in places)


def places_from(plugins: tuple[str, ...], folder: Path) -> list[str]:
    """Name plug-in files by their way from a folder, which may move with them.

    Parameters
    ----------
    plugins : tuple of str
        Their paths.
    folder : Path
        Where the problem file is going to be.

    Returns
    -------
    list of str
    """
    return [way_to(path, folder) for path in plugins]
