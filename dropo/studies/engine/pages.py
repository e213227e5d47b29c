"""Writes a study into a folder: its text, its numbers, its figure, and its block of the README."""

import hashlib
import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dropo.core.services.errors import BadFile
from dropo.core.services.files.atomic_write import write_json, write_text
from dropo.core.services.files.journal import describe_differences
from dropo.core.services.files.saved_files import read_json
from dropo.core.services.run_warning import DropoWarning
from dropo.studies.engine.study import Study


def write(study: Study, folder: Path) -> None:
    """Write a study's files into a folder.

    They are `<study>.md`, `<study>.json` and, if it draws, `<study>.svg`. In the folder's README.md
    the text between `<!-- study: <name> -->` and `<!-- end -->` is replaced. What the folder holds
    of the same study under other settings is kept beside, under another name.

    Parameters
    ----------
    study : Study
        A finished study.
    folder : Path
        The folder, made if it is not there.

    Raises
    ------
    BadFile
        If the study's block of README.md has no end.
    """
    keep_others(study, folder)
    if study.draw is not None:
        write_text(folder / f"{study.name}.svg", picture(study.draw))
    write_json(folder / f"{study.name}.json", study.to_json())
    write_text(folder / f"{study.name}.md", f"# {study.name}\n\n{markdown(study)}")
    readme = folder / "README.md"
    if readme.is_file():
        write_text(readme, with_block(readme.read_text(), study, readme))


def keep_others(study: Study, folder: Path) -> None:
    """Rename the files of the same study under other settings, with a warning.

    Parameters
    ----------
    study : Study
        What is to be written.
    folder : Path
        Where.

    Raises
    ------
    BadFile
        If the numbers that are there cannot be read.
    """
    page = folder / f"{study.name}.json"
    if not page.is_file():
        return
    theirs = read_json(page, "the numbers of a study").get("settings")
    ours = study.to_json().get("settings")
    if not isinstance(theirs, dict) or ours is None or theirs == ours:
        return
    text = json.dumps(theirs, sort_keys=True)
    name = f"{study.name}.{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    for suffix in (".svg", ".md", ".json"):  # the last one says whose they are
        own = folder / f"{study.name}{suffix}"
        if not own.is_file():
            continue
        if suffix == ".md":
            picture_of = own.read_text(encoding="utf-8")
            write_text(own, picture_of.replace(f"({study.name}.svg)", f"({name}.svg)"))
        own.replace(folder / f"{name}{suffix}")
    differ = describe_differences(ours, theirs)
    sentence = f"{page}: what other settings found is kept as {name}.json{differ}."
    warnings.warn(sentence, DropoWarning, stacklevel=2)


def markdown(study: Study) -> str:
    """Write a study as Markdown.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    str
        Its printed text as a block, and a link to its figure where it has one.
    """
    figure = f"\n![{study.title}]({study.name}.svg)\n" if study.draw is not None else ""
    return f"```text\n{study}\n```\n{figure}"


def with_block(text: str, study: Study, path: Path) -> str:
    """A page with the study's block replaced.

    Parameters
    ----------
    text : str
        The page.
    study : Study
        The study.
    path : Path
        Where the page is, for a message.

    Returns
    -------
    str
        The new page; the old one if it has no block of the study.

    Raises
    ------
    BadFile
        If the block has no end before the next one begins.
    """
    begin = f"<!-- study: {study.name} -->\n"
    if begin not in text:
        return text
    if "<!-- end -->" not in text.split(begin, 1)[1].split("<!-- study:")[0]:
        raise BadFile(path, begin.strip(), "an `<!-- end -->` below it", "none")
    block = re.compile(re.escape(begin) + r".*?<!-- end -->", re.DOTALL)
    return block.sub(lambda _: f"{begin}{markdown(study)}<!-- end -->", text, count=1)


def picture(draw: Callable[[Any], None]) -> str:
    """A figure as SVG.

    Parameters
    ----------
    draw : callable
        Draws on a matplotlib Figure.

    Returns
    -------
    str
        The same text for the same numbers: without a date, and with fixed names inside.
    """
    import io

    import matplotlib as mpl
    from matplotlib.figure import Figure

    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "dropo", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(8, 3.4), layout="constrained")
        draw(figure)
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"
