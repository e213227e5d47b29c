"""What a run left in its folder, read without its data or model."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dropo._version import __version__
from dropo.core.records.figure_data import FigureData
from dropo.core.records.fit import Fit
from dropo.core.records.predictions import FILE, Predictions
from dropo.core.services.errors import BadFile
from dropo.report.history import History, read_history

RESULT = "a folder that `dropo fit --out` or `dropo diagnose --out` wrote"
EVALUATION_LOG = "evaluations.jsonl"


@dataclass(frozen=True, eq=False)
class Result:
    """A fit, a diagnosis, or neither, where a run was interrupted before its end.

    Attributes
    ----------
    folder : Path
        Where it is.
    content : dict
        Of fit.json or diagnosis.json; empty without.
    record : dict
        Of run.json, or the header of the evaluation log.
    made : dict
        Of made.json: the command, and versions.
    fit : Fit or None
        The fit.
    figures : FigureData or None
        The numbers behind a diagnosis' figures.
    predictions : Predictions or None
        Measured and simulated motion.
    history : History or None
        How the search went.
    """

    folder: Path
    content: dict[str, Any]
    record: dict[str, Any]
    made: dict[str, Any]
    fit: Fit | None = None
    figures: FigureData | None = None
    predictions: Predictions | None = None
    history: History | None = None

    @property
    def kind(self) -> str:
        """What it is: "fit", "diagnosis" or "unfinished"."""
        if self.fit is not None:
            return "fit"
        return "diagnosis" if "verdict" in self.content else "unfinished"

    @property
    def problem(self) -> str:
        """The problem's name."""
        named = self.content.get("problem") or self.record.get("problem")
        return str(named or self.folder.resolve().name)


def read_result(folder: str | Path) -> Result:
    """Read what a run left in its folder.

    Parameters
    ----------
    folder : str or Path
        The folder.

    Returns
    -------
    Result

    Raises
    ------
    BadFile
        If it holds no result, one that cannot be read, or one that a newer version wrote.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadFile(folder, "", RESULT, "a file" if folder.exists() else "no such folder")
    record = _json(folder / "run.json")
    made = _json(folder / "made.json")
    predictions = Predictions.load(folder) if (folder / FILE).is_file() else None
    if (folder / "diagnosis.json").is_file():
        content = _json(folder / "diagnosis.json")
        _check(folder / "diagnosis.json", content, ("verdict", "headline", "causes", "remaining"))
        kept = content.get("pictures")
        figures = _figures(folder, kept) if kept else None
        return Result(folder, content, record, made, figures=figures, predictions=predictions)
    evaluation_log = folder / EVALUATION_LOG
    if (folder / "fit.json").is_file():
        content = _json(folder / "fit.json")
        _check(folder / "fit.json", content, ("method", "parameters", "status"))
        fit = Fit.load(folder)
        history = None
        if evaluation_log.is_file():
            history = read_history(evaluation_log, len(fit.space))[1]
        return Result(folder, content, record, made, fit, None, predictions, history)
    if not evaluation_log.is_file():
        raise BadFile(folder, "", RESULT, _listing(folder))
    header, history = read_history(evaluation_log, None)
    _check(evaluation_log, header, ())
    return Result(folder, {}, header, made, history=history)


def _json(path: Path) -> dict[str, Any]:
    """The content of a file, {} where there is none."""
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise BadFile(path, "", "JSON", f"{error}") from None
    if not isinstance(content, dict):
        raise BadFile(path, "", "an object with keys", type(content).__name__)
    return content


def _check(path: Path, content: dict[str, Any], keys: tuple[str, ...]) -> None:
    """Refuse a file of a newer version, or one without some of its keys."""
    version = str(content.get("version", ""))
    if _numbers(version) > _numbers(__version__):
        expected = f"{__version__} or older (a newer dropo reads it: pip install -U dropo)"
        raise BadFile(path, "version", expected, version)
    missing = [key for key in keys if key not in content]
    if missing:
        raise BadFile(path, missing[0], "what a run writes", "nothing")


def _numbers(version: str) -> tuple[int, ...]:
    """The numbers of a version, to compare it."""
    parts = version.split("+")[0].split(".")
    return tuple(int(part) for part in parts if part.isdigit())


def _figures(folder: Path, kept: dict[str, Any]) -> FigureData:
    """The figure data that a diagnosis kept."""
    try:
        return FigureData.from_json(kept)
    except (KeyError, TypeError) as error:
        got = f"{type(error).__name__}: {error}"
        path = folder / "diagnosis.json"
        raise BadFile(path, "pictures", "what a diagnosis writes", got) from None


def _listing(folder: Path) -> str:
    """What is in a folder instead, for a message."""
    names = sorted(path.name for path in folder.iterdir())[:5]
    return f"one with {', '.join(names)}" if names else "an empty one"
