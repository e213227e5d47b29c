"""What a diagnosis by regression finds of machines whose first models lack much at once."""

from typing import Any

import numpy as np

from dropo.core.services.validation import require
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.diagnosis.regression.result import QuickDiagnosis
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.first_models.machines import (
    DESIGNS,
    built,
    first_model,
    nothing_missing,
    problem_of,
    random_machine,
    recorded,
)

SEEDS = 20
"""Machines of each design."""
FIRST_SEED = 2000
"""Rules and thresholds were chosen on seeds below it."""
WITHIN = 3.0
"""Standard errors within which a number is right."""
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
    header = (
        "machine",
        "the model lacks",
        "right",
        "false names",
        "missed",
        f"within {WITHIN:g} errors",
        "RMS z",
        "force left",
        "CPU s",
    )
    title = f"First models by regression alone, {count} machines of each design"
    return Study(
        "first-models",
        title,
        (Table("", header, tuple(rows)),),
        (
            "Right: every number that is missing is named, nothing else is, and each is within its "
            "errors.",
            "Force left: the median over machines of what remains at the worst joint on data held "
            "out, as a fraction of the drive's force.",
        ),
        {"runs": [[*item, answer] for item, answer in zip(items, answers, strict=True)]},
    )


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
    name, kind, seed = item
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
    found = QuickDiagnose().run(problem_of(name, spec, data))
    return {**_compared(found, truth), "seconds": found.wall_time_s}


def _compared(
    found: QuickDiagnosis, truth: dict[tuple[str, str | None, str], float]
) -> dict[str, Any]:
    """What is right in a diagnosis."""
    estimates = {
        (cause.effect, cause.target, quantity): estimate
        for cause in found.causes
        for quantity, estimate in cause.estimate.items()
        if not (cause.effect == "payload" and quantity != "mass")
    }
    false = sorted(str(key) for key in set(estimates) - set(truth))
    missed = sorted(str(key) for key in set(truth) - set(estimates))
    z = {
        key: (estimate.value - truth[key]) / estimate.se
        for key, estimate in estimates.items()
        if key in truth
    }
    left = max(joint.after / max(joint.drive, 1e-300) for joint in found.forces)
    right = not false and not missed and all(abs(value) < WITHIN for value in z.values())
    return {
        "right": right,
        "false": false,
        "missed": missed,
        "z": list(z.values()),
        "left": left,
        "verdict": found.verdict,
    }
