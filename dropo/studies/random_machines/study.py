"""What a quick diagnosis finds of machines of random shape that lack none, one or two things."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import require
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.random_machines.design import DRIVES, STEP, random_design
from dropo.studies.random_machines.hidden import COUNTS, NUMBERS, random_machine
from dropo.studies.random_machines.logs import Lost, random_log

SEEDS = 200
FIRST_SEED = 1000
"""Rules and thresholds were chosen on seeds below it."""
WITHIN = 3.0
"""Standard errors within which a number is right."""
SAME = {"body_mass": "payload"}
"""A body that is heavier carries something: the names that count as others."""


def random_machines(work: Work, seeds: int | None = None) -> Study:
    """Count what is found of machines that no rule was chosen on.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    seeds : int or None
        How many machines; None for the study's own number.

    Returns
    -------
    Study

    Raises
    ------
    BadArgument
        If `seeds` is below 1.
    """
    count = SEEDS if seeds is None else seeds
    require(count >= 1, "seeds", "at least 1", count, "random_machines")
    items = [FIRST_SEED + seed for seed in range(count)]
    answers = work.map(diagnosed, items)
    by_thing = [
        (name, [one for one in answers if name in [effect for effect, _ in one["hidden"]]])
        for name in NUMBERS
    ]
    by_drives = [(kind, [one for one in answers if one["drives"] == kind]) for kind in DRIVES]
    by_count = [
        (("nothing", "one thing", "two things")[size], _of_size(answers, size))
        for size in range(len(COUNTS))
    ]
    parts = {"missing": [*by_count, *by_thing], "drives": by_drives, "": [("all", answers)]}
    rows = [
        (kind, name, *_cells(own)) for kind, groups in parts.items() for name, own in groups if own
    ]
    header = ("", "", "machines", "right", "false names", "missed", "of them listed", "within 3 se")
    title = f"{count} machines, seeds from {FIRST_SEED} on"
    return Study(
        "random-machines",
        "Machines of random shape, by regression alone (--quick)",
        (Table(title, (*header, "RMS z", "CPU s"), tuple(rows)),),
        (
            "Right: what is missing is named with its place, nothing else is, and each size is "
            "within 3 standard errors. A payload may be called a heavier body.",
            "Of them listed: missed, but among what a named cause cannot be told from.",
        ),
        {"machines": [[seed, answer] for seed, answer in zip(items, answers, strict=True)]},
    )


def _of_size(answers: Sequence[dict[str, Any]], size: int) -> list[dict[str, Any]]:
    """The answers of machines that lack so many things."""
    return [one for one in answers if len(one["hidden"]) == size]


def _cells(own: Sequence[dict[str, Any]]) -> list[str]:
    """What a row says of its machines."""
    z = np.array([value for one in own for value in one["z"]])
    return [
        str(len(own)),
        f"{sum(one['right'] for one in own)}",
        str(sum(len(one["false"]) for one in own)),
        str(sum(len(one["missed"]) for one in own)),
        str(sum(len(one["listed"]) for one in own)),
        f"{np.mean(np.abs(z) < WITHIN):.0%} of {len(z)}" if len(z) else "-",
        f"{np.sqrt(np.mean(z**2)):.2f}" if len(z) else "-",
        f"{np.median([one['seconds'] for one in own]):.1f}",
    ]


def diagnosed(seed: int) -> dict[str, Any]:
    """One machine and its quick diagnosis.

    Parameters
    ----------
    seed : int
        Decides everything.

    Returns
    -------
    dict
        The kind of drives; what is hidden; right; false and missed names, the missed ones that are
        listed; z of the numbers that were named; verdict; seconds.
    """
    problem, drives, truth = drawn(seed)
    found = QuickDiagnose().run(problem)
    compared = compare(found.causes, truth)
    told = {"verdict": found.verdict, "seconds": found.wall_time_s}
    return {"drives": drives, "hidden": [list(key) for key in truth], **compared, **told}


def drawn(seed: int) -> tuple[Problem, str, dict[tuple[str, str | None], float]]:
    """Draw machines until one can be moved.

    Parameters
    ----------
    seed : int
        Decides everything.

    Returns
    -------
    problem : Problem
        Positions alone.
    drives : str
        Their kind.
    truth : dict
        By effect and place the size of what is missing.
    """
    rng = np.random.default_rng(seed)
    while True:
        design = random_design(rng)
        machine = random_machine(design, rng)
        try:
            data, control = random_log(design, machine, rng)
        except Lost:
            continue
        simulator = MujocoSimulator(
            design.spec, [], observation=["qpos"], frame_skip=round(control / STEP), threads=1
        )
        return Problem(f"machine-{seed}", simulator, data), design.drives, machine.truth


def compare(causes: Sequence[Cause], truth: dict[tuple[str, str | None], float]) -> dict[str, Any]:
    """Compare what is named with what is missing.

    Parameters
    ----------
    causes : sequence of Cause
        What is named.
    truth : dict
        By effect and place the size of what is missing.

    Returns
    -------
    dict
        right; false and missed names, and those of the missed ones that are listed as what a cause
        cannot be told from; z of the numbers that are named.
    """
    named = {}
    listed = set()
    for cause in causes:
        effect = SAME.get(cause.effect, cause.effect)
        named[effect, cause.target] = cause.estimate
        listed |= {(other.effect, other.target) for other in cause.confused_with}
    missed = [key for key in truth if key not in named]
    z = []
    for key, size in truth.items():
        if key in named:
            estimate = named[key][NUMBERS[key[0]]]
            z.append((estimate.value - size) / estimate.se)
    false = [key for key in named if key not in truth]
    return {
        "right": not false and not missed and all(abs(value) < WITHIN for value in z),
        "false": [list(key) for key in false],
        "missed": [list(key) for key in missed],
        "listed": [list(key) for key in missed if key in listed],
        "z": z,
    }
