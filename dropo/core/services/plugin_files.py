"""Plug-ins from files of one's own: `--plugin FILE`, and `plugins` of a problem file.

Such a file is Python code that calls `register` for each of its parts when it is imported.
"""

import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path

from dropo.core.services.errors import BadFile
from dropo.core.services.registry import registered

_sums: dict[str, str] = {}
_loaded: dict[Path, str] = {}
_parts: dict[tuple[str, str], Path] = {}
"""The file whose import registered a part, by kind and name."""


def load_plugins(path: str | Path, key: str = "--plugin") -> list[str]:
    """Import a file, whose plug-ins are then found by their names in this process.

    Parameters
    ----------
    path : str or Path
        A Python file, which is run.
    key : str
        What names the file, for refusals.

    Returns
    -------
    list of str
        What it registered, such as "optimizers: random-search".

    Raises
    ------
    BadFile
        If there is no such file, its name is no Python module's, it cannot be imported, or it
        registers nothing.
    """
    file = Path(path)
    if not file.is_file():
        raise BadFile(file, key, "a Python file", "no file")
    if file.suffix != ".py" or not file.stem.isidentifier():
        rule = "a name like my_parts.py, which Python can import"
        raise BadFile(file, key, rule, file.name)
    own = getattr(sys.modules.get(file.stem), "__file__", None)
    is_free = file.stem not in sys.modules or own == str(file.resolve())
    if not is_free:
        raise BadFile(file, key, "a name that no imported module has", file.stem)
    before = registered()
    _run(file)
    new = [key for key, part in registered().items() if before.get(key) is not part]
    if not new:
        rule = "a call of dropo.register(kind, name, plugin)"
        raise BadFile(file, key, rule, "none when it was imported")
    _sums[file.name] = _loaded[file.resolve()] = _sum(file)
    _parts.update(dict.fromkeys(new, file.resolve()))
    return [f"{kind}: {name}" for kind, name in sorted(new)]


def is_loaded(path: str | Path) -> bool:
    """Tell whether a file was imported as it is now.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    bool
    """
    file = Path(path).resolve()
    return file.is_file() and _loaded.get(file) == _sum(file)


def loaded_files() -> list[Path]:
    """The plug-in files of this process.

    Returns
    -------
    list of Path
        In the order in which they were run.
    """
    return list(_loaded)


def file_of(kind: str, name: str) -> Path | None:
    """Find the plug-in file that registered a part in this process.

    Parameters
    ----------
    kind, name : str
        As of `register`.

    Returns
    -------
    Path or None
        None where no such file did.
    """
    path = _parts.get((kind, name))
    return path if path in _loaded else None


def plugin_sums() -> dict[str, str]:
    """SHA-256 sums of the plug-in files of this process by name, for the records of runs.

    Returns
    -------
    dict of str to str
    """
    return dict(_sums)


def _sum(file: Path) -> str:
    """The SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _run(file: Path) -> None:
    """Import a file as the module of its name; its folder is where it finds its neighbours."""
    place = file.resolve()
    if str(place.parent) not in sys.path:
        sys.path.append(str(place.parent))
    spec = importlib.util.spec_from_file_location(file.stem, place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[file.stem]
        got = f"{type(error).__name__}: {error}".rstrip(".")
        raise BadFile(file, _line(error, place), "code that can be imported", got) from error


def _line(error: Exception, place: Path) -> str:
    """The last line of the file that an error passed, such as "line 3"."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(place)]
    return f"line {lines[-1]}" if lines else ""
