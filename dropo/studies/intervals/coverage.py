"""How often 95 % intervals hold the truth.

Under independent, autocorrelated and start-state noise, and with friction left out of the model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array, require
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

RHO = 0.9  # autocorrelation of the autocorrelated noise from one control step to the next
NOISE = 5e-3  # standard deviation, in each signal's unit
DRY = 0.3  # [N] the friction that the model leaves out
BLOCK = np.array([1.5, 0.8])  # [kg], [N s/m]
FEW = (2, 500)
"""Trajectories, and control steps of each: few long ones."""
MANY = (25, 40)
"""Trajectories, and control steps of each: many short ones."""

METHODS: dict[str, Callable[[], Estimator]] = {
    "least squares": LeastSquares,
    "dropo": lambda: DROPO(likelihood="emulated", family="point", epsilon="learn"),
}
Case = tuple[str, str, str, tuple[int, int]]
"""Robot, noise, method, and the data's size."""
CASES: tuple[Case, ...] = (
    ("block", "independent", "least squares", MANY),
    ("block", "independent", "least squares", FEW),
    ("block", "independent", "dropo", MANY),
    ("block", "autocorrelated", "least squares", MANY),
    ("block", "autocorrelated", "least squares", FEW),
    ("block", "autocorrelated", "dropo", MANY),
    ("block", "start", "dropo", MANY),
    ("block", "start", "dropo", FEW),
    ("hopper", "independent", "dropo", MANY),
    ("hopper", "autocorrelated", "dropo", MANY),
    ("block", "dry friction", "least squares", MANY),
    ("block", "dry friction", "least squares", FEW),
    ("block", "dry friction", "dropo", MANY),
)
"""The cases; "dry friction" is independent noise, and friction that the model does not have."""


@dataclass(frozen=True)
class CoverageSettings:
    """How large the study is, and which coverage is accepted.

    Attributes
    ----------
    replications : int
        Data sets of each case.
    accepted : (float, float)
        Bounds of the coverage of 95 % intervals, outside of which a remark says so.
    """

    replications: int = 100
    accepted: tuple[float, float] = (0.90, 0.98)


DEFAULT = CoverageSettings()


def coverage(
    work: Work,
    seeds: int | None = None,
    *,
    cases: tuple[Case, ...] = CASES,
    settings: CoverageSettings = DEFAULT,
) -> Study:
    """How often 95 % intervals hold the truth, and how often a fit says that its model is wrong.

    Parameters
    ----------
    work : Work
        Runs the replications.
    seeds : int or None
        Data sets of each case; None for the settings' number.
    cases : tuple of Case
        Robot, noise, method, and the data's size.
    settings : CoverageSettings
        The number of data sets, and which coverage is accepted.

    Returns
    -------
    Study
        The coverage of each case.

    Raises
    ------
    BadArgument
        If `seeds` is below 2, or there is no such noise.
    """
    count = settings.replications if seeds is None else seeds
    require(count >= 2, "seeds", "at least 2", count, "coverage")
    items = []
    for robot, noise, method, shape in cases:
        items += [[robot, noise, method, list(shape), seed] for seed in range(count)]
    answers = work.map(replication, items)
    rows = []
    data = {}
    remarks = []
    low, high = settings.accepted
    for i, (robot, noise, method, (trajectories, steps)) in enumerate(cases):
        own = answers[i * count : (i + 1) * count]
        inside = np.array([answer["inside"] for answer in own])
        flagged = float(np.mean([answer["flagged"] for answer in own]))
        each = inside.mean(axis=0)
        errors = np.sqrt(each * (1 - each) / count)
        shown = ", ".join(f"{c:.0%} ± {e:.0%}" for c, e in zip(each, errors, strict=True))
        extent = f"{trajectories} x {steps}"
        rows.append(
            (f"{robot}, {noise}", extent, method, shown, f"{inside.mean():.1%}", f"{flagged:.0%}")
        )
        name = f"{robot}, {noise}, {method}, {extent}"
        sentences = {sentence for answer in own for sentence in answer["sentences"]}
        data[name] = {"coverage": each, "flagged": flagged, "sentences": sorted(sentences)}
        if noise != "dry friction" and not low <= inside.mean() <= high:
            remarks.append(f"{name}: {inside.mean():.1%} is not within {low:.0%} to {high:.0%}.")
    remarks.append(
        f"With a dry friction of {DRY} N left out the intervals cannot hold; the last "
        "column is how often the fit says so."
    )
    header = (
        "data",
        "trajectories",
        "method",
        "coverage of each mean",
        "of all",
        "said to be wrong",
    )
    return Study(
        "coverage",
        f"Coverage of 95 % intervals, {count} data sets each",
        (Table("Intervals of 95 %", header, tuple(rows)),),
        tuple(remarks),
        data,
    )


def replication(item: list[Any]) -> dict[str, Any]:
    """One data set and its fit.

    Parameters
    ----------
    item : list
        Robot, noise, method, the data's size, and the seed.

    Returns
    -------
    dict
        inside: whether each mean's interval holds the truth; flagged: whether the fit does not
        trust its model; sentences: what it says of that.
    """
    robot, noise, method, (count, steps), seed = item
    problem, truth = data_set(robot, noise, count, steps, np.random.default_rng([seed, count]))
    fit = METHODS[method]().fit(problem, rng=seed)
    low, high = fit.interval().T
    sentences = [text for text in fit.warnings if text.startswith("the model is wrong")]
    return {
        "inside": ((low <= truth) & (truth <= high)).tolist(),
        "flagged": fit.trusted is False,
        "sentences": sentences,
    }
