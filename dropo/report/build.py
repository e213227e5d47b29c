"""Writes the page of what a run left in its folder."""

from pathlib import Path

from dropo.core.services.files.atomic_write import write_text
from dropo.core.services.files.saved_files import refusing_faults
from dropo.report.folder import RESULT, Result, read_result
from dropo.report.pages.diagnosis_page import diagnosis_page
from dropo.report.pages.fit_page import fit_page
from dropo.report.pages.quick_page import quick_page
from dropo.report.pages.runs_page import runs_page
from dropo.report.pages.unfinished_page import unfinished_page

PAGES = {
    "fit": fit_page,
    "diagnosis": diagnosis_page,
    "quick diagnosis": quick_page,
    "comparison": runs_page,
    "unfinished": unfinished_page,
}


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write the page of what `dropo fit` or `dropo diagnose` left in a folder.

    The page holds everything that it shows and loads nothing.

    Parameters
    ----------
    folder : str or Path
        The folder.
    out : str or Path, optional
        The file to write; report.html in the folder by default.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    BadFile
        If the folder holds no result.
    MissingPackage
        If matplotlib is not installed (extra `plots`).
    """
    result = read_result(folder)
    path = Path(folder) / "report.html" if out is None else Path(out)
    return write_page(result, path)


def write_page(result: Result, path: Path) -> Path:
    """Write the page of a result, whole or not at all.

    Parameters
    ----------
    result : Result
        What a run left.
    path : Path
        The file to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    BadFile
        If parts of the result do not fit together, so that no page can be made of them.
    """
    write_text(path, page_of(result))
    return path


def page_of(result: Result) -> str:
    """Make the page of a result.

    Parameters
    ----------
    result : Result
        What a run left.

    Returns
    -------
    str
        The HTML file's text.

    Raises
    ------
    BadFile
        If parts of the result do not fit together, so that no page can be made of them.
    """
    with refusing_faults(result.folder, RESULT):
        return PAGES[result.kind](result)
