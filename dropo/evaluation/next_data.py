"""Which data to add next: trajectories, or commands to try, by what they would tell about chosen
parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.linear_gaussian import scores_and_information
from dropo.core.records.fit import Fit
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.validation import Array, float_array, known, require
from dropo.evaluation.open_loop import open_loop

Candidate = Trajectories | tuple[Array, Array]
"""Given trajectories; or a start observation (p,) and the actions (T, q) to try from there."""

PRIOR = 12.0  # 1 / variance of a uniform law on [0, 1]: what the search interval itself tells


@dataclass(frozen=True)
class Ranked:
    """A candidate, by its place in the list that was given. gain: how much it lowers the entropy of
    the chosen parameters [nats], half the fall of the logarithm of their covariance's
    determinant; standard_errors: (d,) that the means would have with it.
    """

    index: int
    gain: float
    standard_errors: Array


def rank_next(
    problem: Problem, fit: Fit, candidates: Sequence[Candidate], about: Sequence[str] | None = None
) -> list[Ranked]:
    """The candidates, the most informative first (D-optimal, Fedorov 1972), given what the
    problem's data tell already.

    about: names of the parameters that matter, all by default; the others count as unknown too.
    Commands are simulated open loop at the fitted means. By the linear-Gaussian model at the fit,
    with its noise and the parameters' spread.
    """
    require(len(candidates) >= 1, "candidates", "at least one", 0, "rank_next")
    names = problem.space.names
    chosen = [
        names.index(known("parameter", name, names)) for name in (names if about is None else about)
    ]
    require(len(chosen) >= 1, "about", "at least one parameter", about, "rank_next")
    width = problem.space.high - problem.space.low
    before = np.diag(PRIOR / width**2) + _information(problem, fit, problem.segments)
    out = []
    for index, candidate in enumerate(candidates):
        data = (
            candidate
            if isinstance(candidate, Trajectories)
            else simulated(problem, fit, *candidate)
        )
        after = before + _information(problem, fit, problem.cut(data))
        errors = np.sqrt(np.diagonal(_inverse(after, width)))
        out.append(
            Ranked(index, _entropy(before, width, chosen) - _entropy(after, width, chosen), errors)
        )
    return sorted(out, key=lambda ranked: -ranked.gain)


def simulated(problem: Problem, fit: Fit, start: Array, actions: Array) -> Trajectories:
    """The trajectory that the fitted means predict, from a start observation (p,) under actions (T,
    q).
    """
    seen = problem.trajectories
    p = seen.observations.shape[1]
    q = seen.actions.shape[1]
    start = float_array("start", start, (p,), "rank_next")
    actions = float_array("actions", actions, (None, q), "rank_next")
    states = open_loop(problem.simulator, fit.mean, start[None], actions[None])[0]
    return Trajectories(
        states[:-1], actions, states[1:], np.arange(len(actions)) == len(actions) - 1
    )


def _information(problem: Problem, fit: Fit, segments: Segments) -> Array:
    """(d, d) of the means."""
    _, jacobian = problem.simulator.linearize(fit.mean, segments)
    spread = fit.correlation * np.outer(fit.sd, fit.sd)
    d = len(fit.mean)
    return scores_and_information(np.zeros(jacobian.shape[:2]), jacobian, spread, fit.epsilon)[1][
        :d, :d
    ]


def _inverse(information: Array, width: Array) -> Array:
    return np.linalg.inv(information * np.outer(width, width)) * np.outer(width, width)


def _entropy(information: Array, width: Array, chosen: list[int]) -> float:
    """Of the chosen parameters in units of their intervals, up to a constant [nats]."""
    covariance = (_inverse(information, width) / np.outer(width, width))[np.ix_(chosen, chosen)]
    return 0.5 * float(np.linalg.slogdet(covariance)[1])
