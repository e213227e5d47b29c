"""How far fits are from the truth, and what diagnoses name, where no pose of the base is logged."""

import tempfile
from dataclasses import dataclass
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.validation import require
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.estimators.dropo import DROPO
from dropo.logs.starting import InitResult, init
from dropo.problems.loading import load
from dropo.problems.simulated.example_quadruped import WALK, write_quadruped
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.unlogged_base.machines import FITTED, HIDDEN, TRUTH, Hidden

FIT = "fit"
"""The case in which trunk mass and ground friction are fitted; the others are of `HIDDEN`."""
CASES = (FIT, *HIDDEN)
PARAMETERS = """
parameters:
  trunk: {field: body_mass, name: trunk, low: 2.5, high: 12, unit: kg}
  floor: {field: geom_friction, name: floor, index: 0, low: 0.2, high: 1.5}
"""


@dataclass(frozen=True)
class UnloggedBaseSettings:
    """How large the study is.

    Attributes
    ----------
    logs : int
        Of each machine; the last one is held out.
    fitted, diagnosed : float
        Length of each log [s].
    development, evaluation : int
        Number of machines of each case, of seeds at hand while the method was written, and others.
    first_evaluation : int
        The first seed of the evaluation; the development's begin at 0.
    """

    logs: int = 3
    fitted: float = 5.0
    diagnosed: float = 10.0
    development: int = 0
    evaluation: int = 10
    first_evaluation: int = 500_000


DEFAULT = UnloggedBaseSettings()


def unlogged_base(
    work: Work,
    seeds: int | None = None,
    *,
    cases: tuple[str, ...] = CASES,
    settings: UnloggedBaseSettings = DEFAULT,
) -> Study:
    """Errors and coverage of fits, and causes named, of logs of angles and an IMU.

    Parameters
    ----------
    work : Work
        Runs fits and diagnoses.
    seeds : int or None
        Machines of each case; None for the settings' numbers.
    cases : tuple of str
        "fit", and names of `HIDDEN`.
    settings : UnloggedBaseSettings

    Returns
    -------
    Study
        A table of fits, a row for each parameter, and one of diagnoses, a row for each case.

    Raises
    ------
    BadArgument
        If `seeds` is below 1.
    """
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "unlogged_base")
    first = settings.first_evaluation
    parts = [
        ("development", 0, settings.development if seeds is None else 0),
        ("evaluation", first, seeds or settings.evaluation),
    ]
    items = []
    for case in cases:
        seconds = settings.fitted if case == FIT else settings.diagnosed
        for _, begin, count in parts:
            items += [[case, begin + i, seconds, settings.logs] for i in range(count)]
    answers = iter(work.map(replication, items))
    fits = []
    diagnoses = []
    data = {}
    for case in cases:
        for name, _, count in parts:
            own = [next(answers) for _ in range(count)]
            if not own:
                continue
            data[f"{case}, {name}"] = own
            if case == FIT:
                fits += _fit_rows(name, own)
            else:
                diagnoses.append(_diagnosis_row(case, name, own))
    head = ("parameter", "seeds", "machines", "mean error", "rms error", "median se", "inside")
    named = ("hidden", "seeds", "machines", "named with its place", "other names", "median error")
    return Study(
        "unlogged-base",
        "A quadruped by joint angles and an IMU: fits and quick diagnoses",
        (
            Table("Fits of trunk mass and ground friction", (*head, "steps"), tuple(fits)),
            Table("Quick diagnoses", named, tuple(diagnoses)),
        ),
        (
            "Inside: 95 % intervals that hold the truth. Other names: causes that are not hidden,"
            " of all machines together. The median error is of sizes that were named.",
        ),
        data,
    )


def replication(item: list[Any]) -> dict[str, Any]:
    """One machine's logs, fitted or diagnosed.

    Parameters
    ----------
    item : list
        Case, seed, length of each log [s] and their number.

    Returns
    -------
    dict
        Of a fit error, se and inside by parameter, and steps; of a diagnosis named, others and
        size.
    """
    case, seed, seconds, logs = item
    hidden = FITTED if case == FIT else HIDDEN[case]
    with tempfile.TemporaryDirectory() as folder:
        started, path = _started(Path(folder), hidden, seed, seconds, logs)
        if case == FIT:
            return _fitted(path, seed)
        return _diagnosed(path, started, hidden)


def _started(
    folder: Path, hidden: Hidden, seed: int, seconds: float, logs: int
) -> tuple[InitResult, Path]:
    """What `dropo init` makes of a machine's logs, and its problem file."""
    walk = hidden.walk(replaced(WALK, seconds=seconds))
    paths = write_quadruped(folder, logs, seed, walk, machine=hidden.machine)
    return init(paths[0], paths[1:], folder / "out"), folder / "out" / "problem.yaml"


def _fitted(path: Path, seed: int) -> dict[str, Any]:
    """The fit of trunk mass and ground friction."""
    path.write_text(path.read_text() + PARAMETERS)
    found = DROPO().fit(load(path, threads=1), rng=seed)
    truth = np.array([TRUTH[name] for name in found.space.names])
    low, high = found.interval().T
    return {
        "error": (found.mean - truth).tolist(),
        "se": found.mean_se.tolist(),
        "inside": ((low <= truth) & (truth <= high)).tolist(),
        "steps": found.simulator_steps,
    }


def _diagnosed(path: Path, started: InitResult, hidden: Hidden) -> dict[str, Any]:
    """What a quick diagnosis and the import name."""
    found = QuickDiagnose().run(load(path, threads=1))
    names = []
    for cause in found.causes:
        size = next(iter(cause.estimate.values())).value
        names.append(((cause.effect, cause.target or ""), float(size)))
    for finding in started.imported.findings:
        if "mounted askew" in finding.sentence:
            angle = finding.sentence.rpartition("askew by ")[2].split()[0]
            names.append((("imu", finding.signal), float(angle)))
    right = [size for name, size in names if name == hidden.cause]
    others = [
        f"{effect}:{target}" for (effect, target), _ in names if (effect, target) != hidden.cause
    ]
    return {"named": bool(right), "others": others, "size": right[0] if right else None}


def _fit_rows(name: str, own: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """A row of the table for each parameter."""
    error = np.array([answer["error"] for answer in own])
    se = np.array([answer["se"] for answer in own])
    inside = np.array([answer["inside"] for answer in own])
    steps = float(np.mean([answer["steps"] for answer in own]))
    rows: list[tuple[str, ...]] = []
    for i, (parameter, unit) in enumerate(zip(TRUTH, ("kg", ""), strict=True)):
        rows.append(
            (
                f"{parameter} [{unit}]" if unit else parameter,
                name,
                f"{len(own)}",
                f"{error[:, i].mean():+.4f}",
                f"{np.sqrt(np.mean(error[:, i] ** 2)):.4f}",
                f"{np.nanmedian(se[:, i]):.4f}",
                f"{int(inside[:, i].sum())}",
                f"{steps:.3g}",
            )
        )
    return rows


def _diagnosis_row(case: str, name: str, own: list[dict[str, Any]]) -> tuple[str, ...]:
    """The row of a case."""
    hidden = HIDDEN[case]
    others = sum(len(answer["others"]) for answer in own)
    named = "none to name"
    error = "-"
    if hidden.cause is not None:
        named = f"{sum(answer['named'] for answer in own)}"
        sizes = [answer["size"] for answer in own if answer["named"]]
        if sizes:
            error = f"{np.median(np.abs(np.array(sizes) / hidden.size - 1)):.0%}"
    return (case, name, f"{len(own)}", named, f"{others}", error)
