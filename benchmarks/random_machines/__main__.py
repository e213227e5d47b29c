"""What a diagnosis finds of machines of random shape that lack none, one or two things.

`python benchmarks/random_machines COUNT FIRST_SEED [--whole] [--equations | --known]` draws
machines, which plain MuJoCo steps finer and otherwise than their models, and prints a line each and
a table: of the regression, or of the search by simulation that follows it. A machine is right if
what is missing is named with its place, nothing else is, and each size is within 3 standard errors;
a payload may be called a heavier body, with its centre and inertia. Listed is what is missed but
stands among what a named cause cannot be told from; a machine is in the set if it would be right
with what is listed in place of that cause. Both are counted a second time without what is missed
and of which the log says less than 100 nats, by simulations with and without it. Rules and
thresholds are chosen on seeds below 1000.

With `--equations` the machines are hanging arms that no simulator steps, but equations of their own
(`equations.py`), with servos; their models lack rotor, damping and friction at every joint, and
often a payload and a delay. With `--known` these are arms with servos or motors, whose models lack
none, one or two things of a longer list. All of it counts as told.
"""

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from arms import NUMBERS_OF_ARMS, Drawn, first_model, known_model, logged
from design import DRIVES
from drawing import Numbers, Place, Told, drawn

from dropo.core.services.tables import Table
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.diagnosis.regression.result import QuickDiagnosis
from dropo.diagnosis.result import Diagnosis
from dropo.problems.file.estimated_velocities import with_velocities

WITHIN = 3.0
"""Standard errors within which a number is right."""
TOLD = 100.0
"""What a log must at least say of what is missing, for a diagnosis to have to find it [nats]."""
HEADER = (
    "the model lacks",
    "machines",
    "right",
    "in the set",
    "right, told",
    "in the set, told",
    "false names",
    "missed",
    "of them told",
    "listed",
    "within 3 se",
    "RMS z",
    "seconds",
)
OPTIONS = ("--whole", "--equations", "--known")
SAME = {"body_mass": "payload"}
"""A body that is heavier carries something: the names that count as others."""
OF_A_PAYLOAD = ("body_com", "body_inertia")
"""What a body that carries something has otherwise, too: these beside its mass are no other cause.
"""


def main(count: int, first: int, whole: bool, equations: bool, known: bool) -> None:
    """Diagnose machines, a line each, and print what is right of those that lack as much."""
    draw = known_model if known else first_model if equations else None
    answers = []
    for seed in range(first, first + count):
        answers.append(diagnosed(seed, whole, draw))
        print(seed, answers[-1], flush=True)
    sizes = ("nothing", "one thing", "two things")
    groups = [(size, _of_size(answers, number)) for number, size in enumerate(sizes)]
    groups += [(effect, _with_effect(answers, effect)) for effect in NUMBERS_OF_ARMS]
    groups += [(drives, [one for one in answers if one["drives"] == drives]) for drives in DRIVES]
    rows = [(name, *_cells(own)) for name, own in [*groups, ("all", answers)] if own]
    print(Table(f"{count} machines, seeds from {first} on", HEADER, tuple(rows)))


def _with_effect(answers: Sequence[dict[str, Any]], effect: str) -> list[dict[str, Any]]:
    """The answers of machines that lack an effect."""
    return [one for one in answers if effect in [hidden for hidden, _ in one["hidden"]]]


def _of_size(answers: Sequence[dict[str, Any]], size: int) -> list[dict[str, Any]]:
    """The answers of machines that lack so many things."""
    return [one for one in answers if len(one["hidden"]) == size]


def _cells(own: Sequence[dict[str, Any]]) -> list[str]:
    """What a row says of its machines."""
    z = np.array([value for one in own for value in one["z"]])
    return [
        str(len(own)),
        f"{sum(one['right'] for one in own)}",
        f"{sum(one['in the set'] for one in own)}",
        f"{sum(one['right, told'] for one in own)}",
        f"{sum(one['in the set, told'] for one in own)}",
        str(sum(len(one["false"]) for one in own)),
        str(sum(len(one["missed"]) for one in own)),
        str(sum(nats >= TOLD for one in own for nats in one["worth of missed"])),
        str(sum(len(one["listed"]) for one in own)),
        f"{np.mean(np.abs(z) < WITHIN):.0%} of {len(z)}" if len(z) else "-",
        f"{np.sqrt(np.mean(z**2)):.2f}" if len(z) else "-",
        f"{np.median([one['seconds'] for one in own]):.1f}",
    ]


def diagnosed(seed: int, whole: bool, draw: Drawn | None = None) -> dict[str, Any]:
    """One machine and its diagnosis.

    Parameters
    ----------
    seed : int
        Decides everything.
    whole : bool
        Whether the search by simulation follows the regression.
    draw : function, optional
        What draws an arm that is stepped by equations of its own.

    Returns
    -------
    dict
        The kind of drives; what is hidden; what `compare` says; verdict; seconds of processor time.
    """
    if draw is not None:
        problem, drives, truth = logged(seed, draw)
        told: Told = _all_is_told
    else:
        problem, drives, truth, told = drawn(seed)
    begun = time.process_time()
    found: Diagnosis | QuickDiagnosis
    if whole:
        found = Diagnose().run(with_velocities(problem))
    else:
        found = QuickDiagnose().run(problem)
    seconds = time.process_time() - begun
    return {
        "drives": drives,
        "hidden": [list(key) for key in truth],
        **compare(found.causes, truth, told),
        "verdict": found.verdict,
        "seconds": seconds,
    }


def _all_is_told(missed: Sequence[Place]) -> Numbers:
    """A log that says everything of what is missed."""
    return dict.fromkeys(missed, np.inf)


def compare(causes: Sequence[Cause], truth: Numbers, told: Told) -> dict[str, Any]:
    """Compare what is named with what is missing.

    Parameters
    ----------
    causes : sequence of Cause
        What is named.
    truth : dict
        By effect and place the size of what is missing.
    told : function
        What the log says of what is missed [nats].

    Returns
    -------
    dict
        right; in the set; both without what the log says too little of; false and missed names,
        what the log says of the missed ones, and those of them that are listed as what a cause
        cannot be told from; z of the numbers that are named.
    """
    named = {}
    alike = {}
    heavier = {cause.target for cause in causes if cause.effect == "body_mass"}
    for cause in causes:
        if cause.effect in OF_A_PAYLOAD and cause.target in heavier:
            continue
        key = (SAME.get(cause.effect, cause.effect), cause.target)
        named[key] = cause.estimate
        others = [(SAME.get(one.effect, one.effect), one.target) for one in cause.confused_with]
        alike[key] = set(others)
    missed = [key for key in truth if key not in named]
    false = [key for key in named if key not in truth]
    listed = [key for key in missed if any(key in others for others in alike.values())]
    z = []
    for key, size in truth.items():
        if key in named:
            estimate = named[key][NUMBERS_OF_ARMS[key[0]]]
            z.append((estimate.value - size) / estimate.se)
    near = all(abs(value) < WITHIN for value in z)
    stands_for_one = all(alike[key].intersection(missed) for key in false)
    nats = told(missed)
    due = [key for key in missed if nats[key] >= TOLD]
    return {
        "right": not false and not missed and near,
        "in the set": stands_for_one and len(listed) == len(missed) and near,
        "right, told": not false and not due and near,
        "in the set, told": stands_for_one and set(due) <= set(listed) and near,
        "false": [list(key) for key in false],
        "missed": [list(key) for key in missed],
        "worth of missed": list(nats.values()),
        "listed": [list(key) for key in listed],
        "z": z,
    }


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *(word in sys.argv[3:] for word in OPTIONS))
