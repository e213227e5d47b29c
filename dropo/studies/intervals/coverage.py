"""How often 95 % intervals hold the truth.

Under noise of many kinds, under parameters that differ from run to run, and with friction left out
of the model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.records.fits.fit import Fit
from dropo.core.services.validation import Array, known, require
from dropo.estimators.dropo import DROPO
from dropo.estimators.epopt import EPOpt
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.posterior import Posterior
from dropo.estimators.random_effects import RandomEffects
from dropo.optimizers.samplers.emcee import Emcee
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.intervals.data_sets import CORRELATION, DRY, SPREAD, data_set

EVALUATION = 1127  # in the seeds of the data sets
FEW = (2, 500)
"""Trajectories, and control steps of each: few long ones."""
MANY = (25, 40)
"""Trajectories, and control steps of each: many short ones."""

SPREADS = (50, 20)
"""The same, where each trajectory has parameters of its own."""

METHODS: dict[str, Callable[[], Estimator]] = {
    "least squares": LeastSquares,
    "dropo": lambda: DROPO(likelihood="emulated", family="point", epsilon="learn"),
    "as it comes": DROPO,
    "dropo, full": lambda: DROPO(family="full"),
    "random effects": RandomEffects,
    "random effects, full": lambda: RandomEffects(family="full"),
    "posterior": lambda: Posterior(sampler=Emcee(steps=200, burn_in=100)),
    "epopt": EPOpt,
}
ONE_VALUE = ("posterior", "epopt")
"""Methods to which all data have one value of the parameters."""

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
    ("block", "ends t3", "dropo", MANY),
    ("block", "ends with outliers", "dropo", MANY),
    ("block", "Student t 3", "as it comes", MANY),
    ("block", "outliers", "as it comes", MANY),
    ("block", "quantised", "as it comes", MANY),
    ("block", "jitter", "as it comes", MANY),
    ("block", "spread", "as it comes", SPREADS),
    ("block", "spread", "random effects", SPREADS),
    ("block", "correlated spread", "dropo, full", SPREADS),
    ("block", "correlated spread", "random effects, full", SPREADS),
    ("block", "independent", "posterior", MANY),
    ("block", "dry friction", "posterior", MANY),
    ("block", "spread", "posterior", SPREADS),
    ("block", "independent", "epopt", MANY),
    ("block", "dry friction", "epopt", MANY),
    ("block", "spread", "epopt", SPREADS),
)
"""The cases; "dry friction" is independent noise, and friction that the model does not have."""


@dataclass(frozen=True)
class CoverageSettings:
    """How large the study is, and which coverage is accepted.

    Attributes
    ----------
    replications : int
        Data sets of each case; of the hopper, whose fits have four means for the block's two, half
        as many.
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
    problems: Sequence[str] = (),
    cases: tuple[Case, ...] = CASES,
    settings: CoverageSettings = DEFAULT,
) -> Study:
    """How often 95 % intervals hold the truth, and how often a fit says that its model is wrong.

    Parameters
    ----------
    work : Work
        Runs the replications.
    seeds : int or None
        Data sets of each case, half as many of the hopper; None for the settings' number.
    problems : sequence of str
        Cases of these robots and kinds of noise alone, as in "block, quantised"; all if empty.
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
    UnknownName
        If no case is of one of the problems.
    """
    if problems:
        labels = dict.fromkeys(_label(case) for case in cases)
        chosen = [known("problem", name, labels) for name in problems]
        cases = tuple(case for case in cases if _label(case) in chosen)
    count = settings.replications if seeds is None else seeds
    require(count >= 2, "seeds", "at least 2", count, "coverage")
    sets = {"block": count, "hopper": max(2, count // 2)}
    items = []
    for robot, noise, method, shape in cases:
        items += [[robot, noise, method, list(shape), seed] for seed in range(sets[robot])]
    answers = iter(work.map(replication, items))
    rows = []
    data = {}
    remarks = []
    low, high = settings.accepted
    for case in cases:
        robot, noise, method, (trajectories, steps) = case
        own = list(islice(answers, sets[robot]))
        inside = np.array([answer["inside"] for answer in own])
        flagged = float(np.mean([answer["flagged"] for answer in own]))
        each = inside.mean(axis=0)
        shown = _listed(each, len(own))
        of_spread = np.array([answer["spread"] for answer in own], dtype=float)
        spread = _listed(of_spread.mean(axis=0), len(own))
        extent = f"{trajectories} x {steps}"
        whole = f"{inside.mean():.1%}"
        label = _label(case)
        rows.append((label, f"{len(own)}", extent, method, shown, whole, spread, f"{flagged:.0%}"))
        name = f"{robot}, {noise}, {method}, {extent}"
        sentences = {sentence for answer in own for sentence in answer["sentences"]}
        data[name] = {
            "coverage": each,
            "coverage_of_spread": of_spread.mean(axis=0),
            "flagged": flagged,
            "sentences": sorted(sentences),
        }
        if not _is_wrong(noise, method) and not low <= inside.mean() <= high:
            remarks.append(f"{name}: {inside.mean():.1%} is not within {low:.0%} to {high:.0%}.")
        if of_spread.size and not low <= of_spread.mean() <= high:
            share = f"{of_spread.mean():.1%}"
            remarks.append(f"{name}, spread: {share} is not within {low:.0%} to {high:.0%}.")
    if any(_is_wrong(noise, method) for _, noise, method, _ in cases):
        remarks.append(
            f"With a dry friction of {DRY} N left out the intervals cannot hold, nor can those of a"
            " posterior of one value where each run has its own; the last column is how often the"
            " fit says so."
        )
    if any("spread" in noise for _, noise, _, _ in cases):
        remarks.append(
            "An interval that a fit does not give, as of a correlation on its bound, counts as one"
            " that does not hold the truth."
        )
    header = (
        "data",
        "sets",
        "trajectories",
        "method",
        "coverage of each mean",
        "of all",
        "of each sd, and correlation",
        "said to be wrong",
    )
    return Study(
        "coverage",
        "Coverage of 95 % intervals",
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
        inside: whether each mean's interval holds the truth; spread: the same of standard
        deviations, and of correlations where there are intervals of these, where parameters differ
        from run to run; flagged: whether the fit does not
        trust its model; sentences: what it says of that.
    """
    robot, noise, method, (count, steps), seed = item
    # Other data than those at hand while the methods were written.
    rng = np.random.default_rng([seed, count, EVALUATION])
    problem, truth = data_set(robot, noise, count, steps, rng)
    fit = METHODS[method]().fit(problem, rng=seed)
    low, high = fit.interval().T
    wrong = ("the model is wrong", "the intervals are too narrow")
    sentences = [text for text in fit.warnings if text.startswith(wrong)]
    return {
        "inside": ((low <= truth) & (truth <= high)).tolist(),
        "spread": _spread_held(fit) if "spread" in noise and method not in ONE_VALUE else [],
        "flagged": fit.trusted is False,
        "sentences": sentences,
    }


def _label(case: Case) -> str:
    """A case's robot and noise, as they are listed."""
    robot, noise, _, _ = case
    return f"{robot}, {noise}"


def _is_wrong(noise: str, method: str) -> bool:
    """Whether the method's model cannot explain the data."""
    return noise == "dry friction" or ("spread" in noise and method in ONE_VALUE)


def _listed(shares: Array, count: int) -> str:
    """Shares with their standard errors."""
    errors = np.sqrt(shares * (1 - shares) / count)
    return ", ".join(f"{c:.0%} ± {e:.0%}" for c, e in zip(shares, errors, strict=True))


def _spread_held(fit: Fit) -> list[bool]:
    """Whether the intervals of standard deviations hold the truth, and of the correlation."""
    low, high = fit.sd_interval().T
    held = ((low <= SPREAD) & (high >= SPREAD)).tolist()
    if fit.correlation_se is not None:
        ends = fit.correlation_interval()[0, 1]
        held.append(bool(ends[0] <= CORRELATION <= ends[1]))
    return held
