"""A folder in, one HTML file out."""

from pathlib import Path

from dropo.core.services.atomic_write import write_text
from dropo.report.diagnosis_page import diagnosis_page
from dropo.report.fit_page import fit_page
from dropo.report.folder import Result, read_result
from dropo.report.unfinished_page import unfinished_page

PAGES = {"fit": fit_page, "diagnosis": diagnosis_page, "unfinished": unfinished_page}


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Makes the page of what `dropo fit` or `dropo diagnose` left in a folder, report.html there
    unless `out` says otherwise.

    The page holds everything that it shows and loads nothing. Raises BadFile where the folder holds
    no result.
    """
    result = read_result(folder)
    path = Path(folder) / "report.html" if out is None else Path(out)
    return write_page(result, path)


def write_page(result: Result, path: Path) -> Path:
    """The page of a result, whole or not at all."""
    text = PAGES[result.kind](result)
    write_text(path, text)
    return path
