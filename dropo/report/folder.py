"""What a run left in its folder, read without its data or model."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dropo.core.records.figure_data import FigureData
from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.fit_files import WRITTEN
from dropo.core.records.predictions import FILE, Predictions
from dropo.core.records.saved_schema import (
    REGRESSION,
    SavedMade,
    SavedRun,
    read_comparison,
    read_diagnosis,
)
from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_schema import Saved, check_content, read_saved
from dropo.core.services.files.progress_file import LOCK, Step, read_progress
from dropo.core.services.files.saved_files import read_json
from dropo.report.history import History, read_history

RESULT = "a folder that `dropo fit --out` or `dropo diagnose --out` wrote"
EVALUATION_LOG = "evaluations.jsonl"
COMMANDS = ("fit", "diagnose")
"""Commands whose folders have pages."""


@dataclass(frozen=True)
class Media:
    """What was rendered for a page.

    Attributes
    ----------
    video : bytes
        H.264 in MP4.
    told : str
        What the video shows, in sentences.
    still : bytes
        PNG of the robot, from the camera and in the pose of its drawing; empty without.
    """

    video: bytes
    told: str
    still: bytes = b""


@dataclass(frozen=True, eq=False)
class Result:
    """A fit, a diagnosis, or neither, where a run was interrupted before its end.

    Attributes
    ----------
    folder : Path
        Where it is.
    content : dict
        Of fit.json, diagnosis.json or runs.json; empty without.
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
    media : Media or None
        What was rendered for its page.
    at_work : bool
        Whether a process seems to be at work in the folder.
    steps : tuple of Step
        What it did last.
    """

    folder: Path
    content: dict[str, Any]
    record: dict[str, Any]
    made: dict[str, Any]
    fit: Fit | None = None
    figures: FigureData | None = None
    predictions: Predictions | None = None
    history: History | None = None
    media: Media | None = None
    at_work: bool = False
    steps: tuple[Step, ...] = ()

    @property
    def kind(self) -> str:
        """What it is: "fit", "diagnosis", "quick diagnosis", "comparison" or "unfinished"."""
        if self.fit is not None:
            return "fit"
        if "runs" in self.content:
            return "comparison"
        if "verdict" not in self.content:
            return "unfinished"
        quick = self.content.get("method") == REGRESSION
        return "quick diagnosis" if quick else "diagnosis"

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
    record = _optional(folder / "run.json", SavedRun, "what a run of dropo decided")
    made = _optional(folder / "made.json", SavedMade, "how a run of dropo was made")
    predictions = Predictions.load(folder) if (folder / FILE).is_file() else None
    if (folder / "diagnosis.json").is_file():
        content = read_diagnosis(folder / "diagnosis.json")
        kept = content.get("pictures")
        figures = FigureData.from_json(kept) if kept else None
        return Result(folder, content, record, made, figures=figures, predictions=predictions)
    if (folder / "runs.json").is_file():
        return Result(folder, read_comparison(folder / "runs.json"), record, made)
    evaluation_log = folder / EVALUATION_LOG
    if (folder / "fit.json").is_file():
        fit = Fit.load(folder)
        content = read_json(folder / "fit.json", WRITTEN)
        history = None
        if evaluation_log.is_file():
            history = read_history(evaluation_log, len(fit.space))[1]
        return Result(folder, content, record, made, fit, None, predictions, history)
    alive = (folder / LOCK).exists()
    steps = read_progress(folder)
    if not evaluation_log.is_file():
        if record.get("command") not in COMMANDS:
            raise BadFile(folder, "", RESULT, _listing(folder))
        return Result(folder, {}, record, made, at_work=alive, steps=steps)
    header, history = read_history(evaluation_log, None)
    check_content(evaluation_log, header, SavedRun)
    return Result(folder, {}, header, made, history=history, at_work=alive, steps=steps)


def _optional(path: Path, schema: type[Saved], what: str) -> dict[str, Any]:
    """The content of a file, {} where there is none."""
    return read_saved(path, schema, what) if path.is_file() else {}


def _listing(folder: Path) -> str:
    """What is in a folder instead, for a message."""
    names = sorted(path.name for path in folder.iterdir())[:5]
    return f"one with {', '.join(names)}" if names else "an empty one"
