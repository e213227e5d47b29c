"""Writes a study into a folder: its text, its numbers, its picture, and its block in the folder's
README.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dropo.core.services.atomic_write import write_json, write_text
from dropo.core.services.errors import BadFile
from dropo.studies.engine.study import Study


def write(study: Study, folder: Path) -> None:
    """<study>.md, .json and, where it draws, .svg; and what stands between `<!-- study: <name> -->`
    and `<!-- end -->` in README.md.
    """
    if study.draw is not None:
        write_text(folder / f"{study.name}.svg", picture(study.draw))
    write_json(folder / f"{study.name}.json", study.to_json())
    write_text(folder / f"{study.name}.md", f"# {study.name}\n\n{markdown(study)}")
    readme = folder / "README.md"
    if readme.is_file():
        write_text(readme, with_block(readme.read_text(), study, readme))


def markdown(study: Study) -> str:
    """What is printed, as a block of text, and the picture."""
    shown = f"\n![{study.title}]({study.name}.svg)\n" if study.draw is not None else ""
    return f"```text\n{study}\n```\n{shown}"


def with_block(text: str, study: Study, path: Path) -> str:
    """The page with the study's block replaced; without such a block, the page as it is."""
    reset = f"<!-- study: {study.name} -->\n"
    if reset not in text:
        return text
    if "<!-- end -->" not in text.split(reset, 1)[1].split("<!-- study:")[0]:
        raise BadFile(path, reset.strip(), "an `<!-- end -->` below it", "none")
    block = re.compile(re.escape(reset) + r".*?<!-- end -->", re.DOTALL)
    return block.sub(lambda _: f"{reset}{markdown(study)}<!-- end -->", text, count=1)


def picture(draw: Callable[[Any], None]) -> str:
    """The figure as SVG; the same text for the same numbers, so without a date and with fixed names
    inside.
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
