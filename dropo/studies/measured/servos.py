"""Machines on servos, from their makers' models: whole motions replayed by commands alone.

No run that is replayed was fitted to, or decided anything.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo import Diagnose, Diagnosis
from dropo.core.services.tables import number
from dropo.core.services.validation import known
from dropo.diagnosis.findings.accuracy.replay import overall_error
from dropo.problems.loading import load
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

MACHINES = {
    "so101": (
        "qpos.shoulder_pan",
        "qpos.shoulder_lift",
        "qpos.elbow_flex",
        "qpos.wrist_flex",
        "qpos.wrist_roll",
    ),
    "go2": (),
}
"""Problem -> the signals whose errors count; all angles if none is named."""
Result = dict[str, Any]
"""What `run` gives."""


def servos(
    work: Work, seeds: int | None = None, *, problems: Sequence[str] = tuple(MACHINES)
) -> Study:
    """Diagnoses machines whose models are far off.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    seeds : int or None
        Number of seeds of the diagnosis; None for one.
    problems : sequence of str
        Names of the problems.

    Returns
    -------
    Study
        Errors of whole motions held out, by motion, and causes.

    Raises
    ------
    UnknownName
        If there is no such problem.
    BadFile
        If the external data are not found.
    """
    chosen = [known("machine on servos", name, MACHINES) for name in problems]
    items = [[name, seed] for name in chosen for seed in range(seeds or 1)]
    runs = work.map(run, items)
    tables = (
        Table(
            "Whole motions held out, RMS error over angles by commands alone [mrad]",
            ("machine", "motions", "as it came", "extended", "odd", "as it came, rest", "rest"),
            tuple(_overall(result) for result in runs),
        ),
        Table(
            "By motion [mrad]",
            ("machine", "seconds", "as it came", "extended", "worst angle", "its error"),
            tuple(row for result in runs for row in _motions(result)),
        ),
        Table(
            "Causes",
            ("machine", "cause"),
            tuple((r["problem"], sentence) for r in runs for sentence in r["sentences"]),
        ),
        Table(
            "Cost",
            ("machine", "verdict", "simulator steps", "s"),
            tuple(
                (r["problem"], r["verdict"], f"{r['steps']:,}", number(r["seconds"], 3))
                for r in runs
            ),
        ),
    )
    remarks = (
        "Odd: motions in which an angle is off by five times the motions' median. Rest: without"
        " them.",
    )
    title = "Machines on servos, from their makers' models"
    return Study("servos", title, tables, remarks, data={"runs": runs})


def run(item: list[Any]) -> Result:
    """One diagnosis, as plain numbers and texts.

    Parameters
    ----------
    item : list
        Name of the problem, and seed.

    Returns
    -------
    dict
    """
    name = str(item[0])
    seed = int(item[1])
    found: Diagnosis = Diagnose().run(load(name, threads=1), rng=seed)
    replayed = found.to_json()["replay"]
    counted = _angles(name, replayed["runs"])
    odd = {one["run"] for one in replayed["odd"] if one["signal"] in counted}
    return {
        "problem": name,
        "seed": seed,
        "verdict": found.verdict,
        "steps": found.simulator_steps,
        "seconds": found.wall_time_s,
        "sentences": [cause.sentence for cause in found.causes],
        "motions": replayed["runs"],
        "odd": sorted(odd),
    }


def _angles(name: str, motions: Sequence[dict[str, Any]]) -> list[str]:
    """The signals whose errors count."""
    every = [signal for signal in motions[0]["nominal"] if signal.startswith("qpos")]
    return list(MACHINES[name]) or every


def _errors(result: Result, side: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n, p) the errors of each angle in each motion [mrad]."""
    signals = _angles(result["problem"], result["motions"])
    return np.array([[1e3 * motion[side][one] for one in signals] for motion in result["motions"]])


def _overall(result: Result) -> tuple[str, ...]:
    """A machine's errors over all motions, and over those that are not odd."""
    seconds = np.array([motion["seconds"] for motion in result["motions"]])
    rest = np.ones(len(seconds), dtype=bool)
    rest[result["odd"]] = False
    cells = []
    for kept in (np.ones_like(rest), rest):
        for side in ("nominal", "extended"):
            error = overall_error(_errors(result, side)[kept], seconds[kept])
            cells.append(number(error, 3))
    odd = ", ".join(str(one + 1) for one in result["odd"]) or "-"
    return (result["problem"], str(len(seconds)), *cells[:2], odd, *cells[2:])


def _motions(result: Result) -> list[tuple[str, ...]]:
    """A row for each motion."""
    signals = _angles(result["problem"], result["motions"])
    before = _errors(result, "nominal")
    after = _errors(result, "extended")
    rows = []
    for i, motion in enumerate(result["motions"]):
        worst = int(np.argmax(after[i]))
        errors = [np.sqrt(np.mean(side[i] ** 2)) for side in (before, after)]
        rows.append(
            (
                result["problem"],
                number(motion["seconds"], 3),
                *(number(float(error), 3) for error in errors),
                signals[worst],
                number(float(after[i, worst]), 3),
            )
        )
    return rows
