"""Which data to add next: trajectories, or commands to try, by their information on parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.linear_gaussian import scores_and_information
from dropo.core.records.fits.fit import Fit
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.validation import Array, float_array, known, require
from dropo.evaluation.open_loop import open_loop

Candidate = Trajectories | tuple[Array, Array]
"""Given trajectories; or a start observation (p,) and the actions (T, q) to try from there."""

PRIOR = 12.0
"""1 / variance of a uniform distribution on [0, 1]: what the search interval itself says."""


@dataclass(frozen=True)
class Ranked:
    """A candidate and what it would add.

    Attributes
    ----------
    index : int
        Its place in the list that was given.
    gain : float
        How much it lowers the entropy of the chosen parameters [nats]: half the fall of the
        logarithm of their covariance's determinant.
    standard_errors : (d,) array
        That the means would have with it.
    """

    index: int
    gain: float
    standard_errors: Array


def rank_next(
    problem: Problem, fit: Fit, candidates: Sequence[Candidate], about: Sequence[str] | None = None
) -> list[Ranked]:
    """Order candidate data by the information that they add to the problem's own.

    Commands are simulated open loop at the fitted means. The information is that of the
    linear-Gaussian model at the fit, with its noise and the parameters' spread.

    Parameters
    ----------
    problem : Problem
        With d parameters.
    fit : Fit
        Of the problem.
    candidates : sequence of Trajectories, or of (start, actions)
        Data, or a start observation (p,) and the actions (T, q) to try from there.
    about : sequence of str, optional
        Names of the parameters that matter, all by default; the others count as unknown too.

    Returns
    -------
    list of Ranked
        The most informative first (D-optimal [1]_).

    Raises
    ------
    BadArgument
        If there is no candidate, no parameter, or an array of another shape.
    UnknownName
        If there is no such parameter.
    Incompatible
        If commands are given, and predictions are no observations.

    References
    ----------
    .. [1] Fedorov, Theory of optimal experiments, 1972.
    """
    require(len(candidates) >= 1, "candidates", "at least one", 0, "rank_next")
    names = problem.space.names
    chosen = []
    for name in names if about is None else about:
        chosen.append(names.index(known("parameter", name, names)))
    require(len(chosen) >= 1, "about", "at least one parameter", about, "rank_next")
    width = problem.space.high - problem.space.low
    before = np.diag(PRIOR / width**2) + _information(problem, fit, problem.segments)
    entropy = _entropy(before, width, chosen)
    ranked = []
    for index, candidate in enumerate(candidates):
        if isinstance(candidate, Trajectories):
            data = candidate
        else:
            start, actions = candidate
            data = simulated(problem, fit, start, actions)
        after = before + _information(problem, fit, problem.cut(data))
        gain = entropy - _entropy(after, width, chosen)
        errors = np.sqrt(np.diagonal(_inverse(after, width)))
        ranked.append(Ranked(index, gain, errors))
    return sorted(ranked, key=lambda one: -one.gain)


def simulated(problem: Problem, fit: Fit, start: Array, actions: Array) -> Trajectories:
    """Simulate commands at the fitted means.

    Parameters
    ----------
    problem : Problem
        With p observations and q actions.
    fit : Fit
        Of the problem.
    start : (p,) array
        A start observation.
    actions : (T, q) array
        Commands.

    Returns
    -------
    Trajectories
        One of T transitions.

    Raises
    ------
    BadArgument
        If an array has another shape.
    Incompatible
        If predictions are no observations.
    """
    measured = problem.trajectories
    p = measured.observations.shape[1]
    q = measured.actions.shape[1]
    start = float_array("start", start, (p,), "rank_next")
    actions = float_array("actions", actions, (None, q), "rank_next")
    states = open_loop(problem.simulator, fit.mean, start[None], actions[None])[0]
    ends = np.arange(len(actions)) == len(actions) - 1
    return Trajectories(states[:-1], actions, states[1:], ends)


def _information(problem: Problem, fit: Fit, segments: Segments) -> Array:
    """(d, d) the Fisher information of the means."""
    _, jacobian = problem.simulator.linearize(fit.mean, segments)
    spread = fit.correlation * np.outer(fit.sd, fit.sd)
    d = len(fit.mean)
    residuals = np.zeros(jacobian.shape[:2])
    _, information = scores_and_information(residuals, jacobian, spread, fit.epsilon)
    return information[:d, :d]


def _inverse(information: Array, width: Array) -> Array:
    """(d, d) the covariance, computed in units of the search intervals."""
    return np.linalg.inv(information * np.outer(width, width)) * np.outer(width, width)


def _entropy(information: Array, width: Array, chosen: list[int]) -> float:
    """Of the chosen parameters in units of their intervals, up to a constant [nats]."""
    covariance = (_inverse(information, width) / np.outer(width, width))[np.ix_(chosen, chosen)]
    return 0.5 * float(np.linalg.slogdet(covariance)[1])
