"""What a diagnosis by regression finds of machines whose first models lack much at once."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import require
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.far_off.model import GAIN
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.diagnosis.search.library import robot_of
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.first_models.machines import (
    DESIGNS,
    Numbers,
    built,
    first_model,
    nothing_missing,
    problem_of,
    random_machine,
    recorded,
)
from dropo.studies.first_models.strangers import stranger

SEEDS = 20
"""Machines of each design."""
SIMULATED = 4
"""One machine of so many is diagnosed by simulation too."""
STEPS = 20
"""Control steps of 10 ms after which errors are compared."""
FIRST_SEED = 61000
"""Rules and thresholds were chosen on seeds below it."""
WITHIN = 3.0
"""Standard errors within which a number is right."""
AFTER = 0.2
"""Seconds after which errors of machines with other control steps are compared."""
COUNTED = ("right", "false names", "missed", f"within {WITHIN:g} errors", "RMS z")
"""What is counted of the numbers of each row's machines."""
STRANGERS = "Small servo machines drawn at random, by the whole diagnosis"
KINDS = ("missing", "nothing missing")


def first_models(work: Work, seeds: int | None = None) -> Study:
    """Count what is found of machines that no rule was chosen on.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    seeds : int or None
        Machines of each design; None for the study's own number.

    Returns
    -------
    Study

    Raises
    ------
    BadArgument
        If `seeds` is below 1.
    """
    count = SEEDS if seeds is None else seeds
    require(count >= 1, "seeds", "at least 1", count, "first_models")
    items = []
    for design in DESIGNS:
        for kind in KINDS:
            items += [[design, kind, FIRST_SEED + seed] for seed in range(count)]
    answers = work.map(diagnosed, items)
    rows = []
    for i, design in enumerate(DESIGNS):
        for j, kind in enumerate(KINDS):
            first = (i * len(KINDS) + j) * count
            rows.append((design, kind, *_cells(answers[first : first + count])))
    header = ("machine", "the model lacks", *COUNTED, "force left", "CPU s")
    fewer = max(1, count // SIMULATED)
    simulated = [[design, FIRST_SEED + seed] for design in DESIGNS for seed in range(fewer)]
    fits = work.map(diagnosed_by_simulation, simulated)
    fit_rows = []
    for i, design in enumerate(DESIGNS):
        own = fits[i * fewer : (i + 1) * fewer]
        fit_rows.append((design, *_cells(own)))
    alone = [[seed + FIRST_SEED, KINDS[0]] for seed in range(count)]
    alone += [[seed + FIRST_SEED, KINDS[1]] for seed in range(fewer)]
    brought = work.map(diagnosed_stranger, alone)
    by_regression = f"By regression alone (--quick), {count} machines of each design"
    by_simulation = f"By simulation, begun with the regression, {fewer} of each"
    fit_header = ("machine", *COUNTED, "error after 0.2 s", "CPU s")
    return Study(
        "first-models",
        "First models",
        (
            Table(by_regression, header, tuple(rows)),
            Table(by_simulation, fit_header, tuple(fit_rows)),
            table_of_strangers(alone, brought),
        ),
        (
            "Right: every number that is missing is named, or by the whole diagnosis told only "
            "together with others; nothing else is, and each is within its errors.",
            "Force left: the median over machines of what remains at the worst joint on data held "
            "out, as a fraction of the drive's force.",
            "Error after 0.2 s: the median over machines, on data held out, as a fraction of the "
            "motion.",
        ),
        {
            "regression": [[*item, answer] for item, answer in zip(items, answers, strict=True)],
            "simulation": [[*item, answer] for item, answer in zip(simulated, fits, strict=True)],
            "strangers": [[*item, answer] for item, answer in zip(alone, brought, strict=True)],
        },
    )


def table_of_strangers(items: Sequence[list[Any]], answers: Sequence[dict[str, Any]]) -> Table:
    """Count what is found of small servo machines.

    Parameters
    ----------
    items : sequence of list
        The seed and the kind of each run.
    answers : sequence of dict
        Of `diagnosed_stranger`.

    Returns
    -------
    Table
        A row for each kind.
    """
    rows = []
    for kind in KINDS:
        own = [answer for item, answer in zip(items, answers, strict=True) if item[1] == kind]
        told = str(sum(len(answer["together"]) for answer in own))
        cells = _cells(own)
        rows.append((kind, str(len(own)), *cells[:3], told, *cells[3:]))
    told_of = (*COUNTED[:3], "only together", *COUNTED[3:])
    header = ("the model lacks", "machines", *told_of, "error after 0.2 s", "CPU s")
    return Table(STRANGERS, header, tuple(rows))


def _cells(own: list[dict[str, Any]]) -> list[str]:
    """What a row says of its runs."""
    z = np.array([value for answer in own for value in answer["z"]])
    named = f"{np.mean(np.abs(z) < WITHIN):.0%} of {len(z)}" if len(z) else "-"
    size = f"{np.sqrt(np.mean(z**2)):.2f}" if len(z) else "-"
    return [
        f"{sum(answer['right'] for answer in own)}/{len(own)}",
        str(sum(len(answer["false"]) for answer in own)),
        str(sum(len(answer["missed"]) for answer in own)),
        named,
        size,
        f"{np.median([answer['left'] for answer in own]):.1%}",
        f"{np.median([answer['seconds'] for answer in own]):.1f}",
    ]


def diagnosed(item: list[Any]) -> dict[str, Any]:
    """One machine and its diagnosis.

    Parameters
    ----------
    item : list
        The design, the kind of run, and the seed.

    Returns
    -------
    dict
        right; false and missed names; z of the numbers that were named; the largest force that is
        left, as a fraction of the drive's; seconds.
    """
    problem, truth = _drawn(*item)
    found = QuickDiagnose().run(problem)
    left = max(joint.after / max(joint.drive, 1e-300) for joint in found.forces)
    return {**_compared(found.causes, truth, left, found.verdict), "seconds": found.wall_time_s}


def diagnosed_by_simulation(item: list[Any]) -> dict[str, Any]:
    """One machine whose first model lacks much, and its diagnosis by simulation.

    Parameters
    ----------
    item : list
        The design and the seed.

    Returns
    -------
    dict
        As of `diagnosed`, with the error on held-out data in the place of the force that is left.
    """
    name, seed = item
    return _whole(*_drawn(name, KINDS[0], seed), STEPS)


def diagnosed_stranger(item: list[Any]) -> dict[str, Any]:
    """One small servo machine as somebody would bring it, and its whole diagnosis.

    Parameters
    ----------
    item : list
        The seed and the kind of run.

    Returns
    -------
    dict
        As of `diagnosed_by_simulation`.
    """
    seed, kind = item
    problem, truth = stranger(seed, missing=kind == KINDS[0])
    return _whole(problem, truth, round(AFTER / robot_of(problem).control_step))


def _whole(problem: Problem, truth: Numbers, steps: int) -> dict[str, Any]:
    """The whole diagnosis of a log of positions, compared; the error left is after some steps."""
    begun = time.process_time()
    found = Diagnose().run(with_velocities(problem))
    seconds = time.process_time() - begun
    # Where no error is printed after just as many steps, the next one counts.
    horizons = found.extended.horizons
    left = next((at.rmse for at in horizons if at.steps >= steps), horizons[-1].rmse)
    compared = _compared(found.causes, truth, left, found.verdict, found.undetermined)
    return {**compared, "seconds": seconds}


def _drawn(name: str, kind: str, seed: int) -> tuple[Problem, Numbers]:
    """A machine's log with a model, and what the model lacks."""
    design = DESIGNS[name]
    rng = np.random.default_rng([seed, len(design.axes), KINDS.index(kind)])
    spec = first_model(design)
    machine = random_machine(design, rng)
    if kind == "nothing missing":
        machine = nothing_missing(machine)
    made = built(spec, machine)
    data = recorded(made, design.servos, machine.delay, rng)
    truth = machine.numbers()
    if kind == "nothing missing":
        spec = made.copy()
        spec.option.timestep = first_model(design).option.timestep
        truth = {}
    return problem_of(name, spec, data), truth


def _compared(
    causes: Sequence[Cause],
    truth: Numbers,
    left: float,
    verdict: str,
    told: Sequence[str] = (),
) -> dict[str, Any]:
    """What is right in a diagnosis.

    told: sentences that name what is identifiable only together; a number in one is not missed.
    """
    estimates = {
        (cause.effect, cause.target, quantity): estimate
        for cause in causes
        for quantity, estimate in cause.estimate.items()
        if not (cause.effect == "payload" and quantity != "mass")
    }
    # The gain of all drives is said of each, and the other way around.
    everyone = (GAIN, None, "gain")
    joints = sum(key[0] == "joint_armature" for key in truth)
    of_each = [(GAIN, f"drive{i}", "gain") for i in range(joints)]
    apart = any(key in of_each for key in {*truth, *estimates})
    if everyone in truth and apart:
        common = truth[everyone]
        truth = {key: value for key, value in truth.items() if key != everyone}
        truth |= dict.fromkeys(of_each, common)
    elif everyone in estimates and apart:
        estimates |= dict.fromkeys(of_each, estimates.pop(everyone))
    false = sorted(str(key) for key in set(estimates) - set(truth))
    absent = sorted(set(truth) - set(estimates), key=str)
    together = [key for key in absent if any(_label(key) in text for text in told)]
    missed = [str(key) for key in absent if key not in together]
    z = {
        key: (estimate.value - truth[key]) / estimate.se
        for key, estimate in estimates.items()
        if key in truth
    }
    right = not false and not missed and all(abs(value) < WITHIN for value in z.values())
    return {
        "right": right,
        "false": false,
        "missed": missed,
        "together": [str(key) for key in together],
        "z": list(z.values()),
        "left": left,
        "verdict": verdict,
    }


def _label(key: tuple[str, str | None, str]) -> str:
    """How a diagnosis calls a number's effect."""
    return key[0] if key[1] is None else f"{key[0]}:{key[1]}"
