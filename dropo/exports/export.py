"""Writes a fit or an extended model in the form of another tool."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dropo._version import __version__
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.records.saved_schema import SavedRun, read_diagnosis
from dropo.core.services.errors import BadFile, Incompatible
from dropo.core.services.files.atomic_write import write_bytes, write_json, write_text
from dropo.core.services.files.file_schema import read_saved
from dropo.core.services.files.saved_files import read_json
from dropo.core.services.registry import find
from dropo.core.services.tables import Report, Table
from dropo.exports.support.subject import Subject, Written, simulator_of, subject_of_fit
from dropo.mjmodel.files.loading import model_sum
from dropo.problems.file.verification import values_of
from dropo.problems.loading import load
from dropo.simulators.mujoco.model_assets import with_assets_beside

RECORD = "export.json"
"""What an export wrote, by which the next one knows its own files."""
FOLDER = "a folder that `dropo fit --out` or `dropo diagnose --out` wrote"
MODEL = "model.xml"


@dataclass(frozen=True, repr=False)
class Exported(Report):
    """What was written for a target.

    Attributes
    ----------
    target : str
        Its name.
    files : tuple of Path
        The main one first.
    left_out, approximated : tuple of str
        What the target cannot hold, and what it holds otherwise, a sentence each.
    """

    target: str
    files: tuple[Path, ...]
    left_out: tuple[str, ...]
    approximated: tuple[str, ...]

    def parts(self) -> list[str | Table]:
        """The paths, then what is not as in the result."""
        lines: list[str | Table] = [str(path) for path in self.files]
        return [*lines, *self.left_out, *self.approximated]

    def to_json(self) -> dict[str, Any]:
        """As `dropo export --json` prints it.

        Returns
        -------
        dict
            As `dropo export --json` prints it.
        """
        return {
            "target": self.target,
            "files": [str(path) for path in self.files],
            "left_out": list(self.left_out),
            "approximated": list(self.approximated),
        }


def export(
    result: Fit | str | Path,
    target: str,
    out: str | Path | None = None,
    *,
    problem: Problem | str | Path | None = None,
) -> Exported:
    """Write a fit or an extended model in the form of another tool.

    Parameters
    ----------
    result : Fit, str or Path
        The fit, or the folder of `dropo fit --out` or `dropo diagnose --out`.
    target : str
        A name that `dropo list exports` prints.
    out : str or Path, optional
        The folder to write into, or the path of the main file, which has an ending; by default a
        folder named like the target, in the folder of the result where there is one.
    problem : Problem, str or Path, optional
        What was fitted; by default what the fit or its folder says.

    Returns
    -------
    Exported
        The files, and what the target cannot hold or holds otherwise.

    Raises
    ------
    UnknownName
        If there is no such target; the message gives the nearest valid one.
    BadFile
        If the folder holds no result, or a file that is in the way was not written by an export.
    Incompatible
        If the problem is not known, has no MuJoCo model, or is another than the one fitted.
    """
    make = find("exports", target)
    if isinstance(result, Fit):
        subject = _of_fit(result, problem)
        folder = Path()
    else:
        folder = Path(result)
        subject = _of_folder(folder, problem)
    written: Written = make(subject)
    place = folder / target if out is None else Path(out)
    return _write(target, subject, written, place)


def _of_fit(fit: Fit, problem: Problem | str | Path | None) -> Subject:
    """A fit with the problem that was fitted."""
    if isinstance(problem, Problem):
        return subject_of_fit(fit, problem)
    if not (problem or fit.source):
        raise Incompatible(
            f"The fit of {fit.problem!r} does not say what it was fitted to. Name it: problem=... "
            "in Python, --problem on the command line."
        )
    return subject_of_fit(fit, load(problem or fit.source, checked=False, trusted=False))


def _of_folder(folder: Path, problem: Problem | str | Path | None) -> Subject:
    """What a folder holds: a diagnosis, or a fit."""
    if not folder.is_dir():
        raise BadFile(folder, "", FOLDER, "a file" if folder.exists() else "no such folder")
    if (folder / "diagnosis.json").is_file():
        return _of_diagnosis(folder)
    if not (folder / "fit.json").is_file():
        raise BadFile(folder, "", FOLDER, "one without fit.json and diagnosis.json")
    subject = _of_fit(Fit.load(folder), problem)
    path = folder / "run.json"
    if path.is_file():
        before = read_saved(path, SavedRun, "what a run of dropo decided").get("model_sha256")
        if before not in (None, model_sum(subject.simulator.model)):
            raise Incompatible(
                f"The fit in {folder} is of another model than that of {subject.name!r} now. Put "
                "that one back, or fit this one."
            )
    return subject


def _of_diagnosis(folder: Path) -> Subject:
    """The extended model of a diagnosis, at its means."""
    path = folder / "diagnosis.json"
    content = read_diagnosis(path)
    if not content.get("extended_problem"):
        raise BadFile(path, "extended_problem", "the path of an extended problem", "none")
    problem = load(folder / str(content["extended_problem"]), checked=False, trusted=False)
    simulator = simulator_of(problem)
    return Subject(str(content["problem"]), simulator, values_of(simulator, content), None)


def _write(target: str, subject: Subject, written: Written, place: Path) -> Exported:
    """Write all files, or refuse where one of another's is in the way.

    The record comes first: after an interruption what is there is of this export.
    """
    main = next(iter(written.files), MODEL)
    folder = place.parent if place.suffix else place
    named = {
        place.name if place.suffix and name == main else name: content
        for name, content in written.files.items()
    }
    names = [*named, MODEL] if written.model else list(named)
    _refuse_others(folder, names, target)
    paths = tuple(folder / name for name in names)
    found = Exported(target, paths, written.left_out, written.approximated)
    record = found.to_json() | {"files": names, "problem": subject.name, "version": __version__}
    write_json(folder / RECORD, record)
    if written.model:
        write_text(folder / MODEL, with_assets_beside(written.model, folder))
    for name, content in named.items():
        if isinstance(content, bytes):
            write_bytes(folder / name, content)
        else:
            write_text(folder / name, content)
    return found


def _refuse_others(folder: Path, names: list[str], target: str) -> None:
    """Refuse a folder in which a file is in the way that no export to this target wrote."""
    if folder.exists() and not folder.is_dir():
        raise BadFile(folder, "--out", "a folder", "a file")
    kept = folder / RECORD
    before = read_json(kept, "what an export wrote") if kept.is_file() else {}
    own = before.get("files", []) if before.get("target") == target else []
    there = [name for name in [*names, RECORD] if (folder / name).exists()]
    others = [name for name in there if name not in own and not (name == RECORD and own)]
    if others:
        rule = f"a new folder, or one of an earlier export to {target}"
        raise BadFile(folder, "--out", rule, f"one with {others[0]} of another")
