"""What the data cannot determine, in words: from the Fisher information of the means."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.kept_rows import KeptRows, row_blocks
from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """When a direction of the parameters is not determined.

    Attributes
    ----------
    unknown_sd : float
        A direction that is known no better is not determined, as a fraction of the search
        intervals: the standard deviation of a uniform distribution on [0, 1].
    rounding : float
        Fraction of the largest eigenvalue below which information is rounding of the differences.
    component : float
        Fraction of a direction's largest component below which others are left out of its name.
    on_bound : float
        Distance to a bound at which a mean lies on it, as a fraction of the search interval.
    """

    unknown_sd: float = 0.29
    rounding: float = 1e-10
    component: float = 0.05
    on_bound: float = 1e-3


SETTINGS = IdentifiabilitySettings()


def identify(problem: Problem, fit: Fit, settings: IdentifiabilitySettings = SETTINGS) -> list[str]:
    """Say what the data do not determine.

    Parameters
    ----------
    problem : Problem
        With d parameters.
    fit : Fit
        Of the problem.
    settings : IdentifiabilitySettings
        When something is not determined.

    Returns
    -------
    list of str
        Sentences on parameters and combinations of them that the data do not determine, on
        parameters on a bound, on signals that do not move or carry no information, and on actions
        that never change; none where all is well.
    """
    _, jacobian = problem.simulator.linearize(fit.mean, problem.segments)
    directions = null_directions(problem.space, jacobian, fit.epsilon, settings)
    sentences = describe_not_identifiable(problem, fit.mean, jacobian, directions, settings)
    return [*sentences, *_bounds(problem.space, fit.mean, settings)]


def describe_not_identifiable(
    problem: Problem,
    mean: Array,
    jacobian: KeptRows,
    directions: Sequence[Array],
    settings: IdentifiabilitySettings = SETTINGS,
) -> list[str]:
    """Say what the data do not determine, bounds left out.

    Parameters
    ----------
    problem : Problem
        With d parameters and R compared rows of p signals.
    mean : (d,) array
        Where.
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions there.
    directions : sequence of (d,) array
        Its null directions.
    settings : IdentifiabilitySettings
        When something is not determined.

    Returns
    -------
    list of str
        As of `identify`.
    """
    return [
        *describe_directions(problem.space, mean, directions, settings),
        *_signals(problem, jacobian),
        *_actions(problem),
    ]


def describe_directions(
    space: ParameterSpace,
    mean: Array,
    directions: Sequence[Array],
    settings: IdentifiabilitySettings = SETTINGS,
) -> list[str]:
    """Name the parameters, and combinations of them, along null directions.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    mean : (d,) array
        Where.
    directions : sequence of (d,) array
        Null directions.
    settings : IdentifiabilitySettings
        Which components count.

    Returns
    -------
    list of str
        A sentence each.
    """
    return [_sentence(space, mean, direction, settings.component) for direction in directions]


def determined(
    space: ParameterSpace,
    directions: Sequence[Array],
    settings: IdentifiabilitySettings = SETTINGS,
) -> NDArray[np.bool_]:
    """Return which parameters the data determine.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    directions : sequence of (d,) array
        Null directions.
    settings : IdentifiabilitySettings
        Which components count.

    Returns
    -------
    (d,) bool array
        Those that no null direction changes.
    """
    out = np.ones(len(space), dtype=bool)
    for direction in directions:
        out[_changed(space, direction, settings.component)] = False
    return out


def null_directions(
    space: ParameterSpace,
    jacobian: KeptRows,
    epsilon: Array,
    settings: IdentifiabilitySettings = SETTINGS,
    *,
    known: Array | None = None,
) -> list[Array]:
    """Return directions of the parameters along which no prediction changes.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions.
    epsilon : (p,) array
        Noise variances.
    settings : IdentifiabilitySettings
        Which information counts as none.
    known : (d,) array, optional
        Information on each parameter beside the data, as of a prior [1 / unit^2].

    Returns
    -------
    list of (d,) array
        Each of few parameters.
    """
    # The information on the means, in units of their search intervals.
    width = space.high - space.low
    sd = np.sqrt(np.maximum(epsilon, 1e-300))[:, None]
    rows, p, d = jacobian.shape
    information = np.zeros((d, d))
    for block in row_blocks(rows, 16 * p * d):
        white = (jacobian[block] * width / sd).reshape(-1, d)
        information += white.T @ white
    if known is not None:
        information += np.diag(known * width**2)
    of_prior = 1 / settings.unknown_sd**2

    # Single parameters without information.
    size = np.diagonal(information)
    has_information = size > max(of_prior, settings.rounding * float(size.max(initial=0.0)))
    directions = list(np.eye(len(space))[~has_information])

    # Combinations of the others.
    rest = np.flatnonzero(has_information)
    if len(rest) < 2:
        return directions
    values, vectors = np.linalg.eigh(information[np.ix_(rest, rest)])
    null = vectors[:, values < np.maximum(of_prior, settings.rounding * values[-1])]
    for direction in _sparse(null.T):
        whole = np.zeros(len(space))
        whole[rest] = direction * width[rest]
        directions.append(whole)
    return directions


def _changed(space: ParameterSpace, direction: Array, component: float) -> Ints:
    """The parameters that a direction changes, in units of their intervals."""
    scaled = np.abs(direction) / (space.high - space.low)
    return np.flatnonzero(scaled > component * scaled.max())


def _sparse(rows: Array) -> list[Array]:
    """A basis of the rows' span with few components each, by elimination from the largest pivot."""
    rows = rows.copy()
    free = list(range(len(rows)))
    for _ in range(len(rows)):
        left = rows[free]
        i, j = np.unravel_index(np.abs(left).argmax(), left.shape)
        pivot = free.pop(int(i))
        rows[pivot] /= rows[pivot, j]
        others = [k for k in range(len(rows)) if k != pivot]
        rows[others] -= rows[others, j][:, None] * rows[pivot]
    return list(rows)


def _sentence(space: ParameterSpace, mean: Array, direction: Array, component: float) -> str:
    """What a step along a null direction (d,) leaves as it is.

    Of two positive parameters, equal steps of their logarithms leave the ratio, opposite ones the
    product; else equal steps leave the difference and opposite ones the sum.
    """
    which = _changed(space, direction, component)
    names = [space.names[i] for i in which]
    steps = direction[which]
    if len(which) == 1:
        return f"the data do not determine {names[0]}"
    if len(which) == 2:
        determined_by = None
        if (space.low[which] > 0).all():
            determined_by = _operator(steps / mean[which], "/", "*", component)
        if determined_by is None:
            determined_by = _operator(steps, "-", "+", component)
        if determined_by is not None:
            combined = f"{names[0]} {determined_by} {names[1]}"
            return f"only {combined} is determined by the data, not each of them"
    joined = f"{', '.join(names[:-1])} and {names[-1]}"
    proportion = " : ".join(f"{step:.2g}" for step in steps / np.abs(steps).max())
    return (
        f"the data determine {joined} only together: steps in the proportion {proportion} change no"
        " prediction"
    )


def _operator(steps: Array, equal: str, opposite: str, component: float) -> str | None:
    """The sign of the combination that two steps leave as it is; None where they are not equal."""
    first, second = steps
    if abs(abs(first) - abs(second)) >= component * max(abs(first), abs(second)):
        return None
    return equal if first * second > 0 else opposite


def _signals(problem: Problem, jacobian: KeptRows) -> list[str]:
    """Sentences on signals that do not move, and on those without information."""
    targets = problem.segments.targets
    still = np.zeros(jacobian.shape[1], dtype=bool)
    # A rotation has fewer compared numbers than observed ones; then none is called still.
    if targets.shape[1] == len(still):
        size = np.maximum(np.abs(targets).max(axis=0), 1e-300)
        still = np.ptp(targets, axis=0) <= 1e-12 * size
    silent = ~still
    for block in row_blocks(jacobian.shape[0], 16 * len(still) * jacobian.shape[2]):
        silent &= np.abs(jacobian[block]).max(axis=(0, 2)) == 0
    names = np.array([signal.name for signal in problem.simulator.signals], dtype=object)
    return [
        *(f"{name} does not move" for name in names[still]),
        *(f"{name} carries no information on any parameter" for name in names[silent]),
    ]


def _actions(problem: Problem) -> list[str]:
    """Sentences on actions that never change."""
    spread = np.ptp(problem.trajectories.actions, axis=0)
    return [f"action[{i}] never changes" for i in np.flatnonzero(spread == 0)]


def _bounds(space: ParameterSpace, mean: Array, settings: IdentifiabilitySettings) -> list[str]:
    """Sentences on parameters on a bound."""
    unit = space.to_unit(mean)
    lower = (unit < settings.on_bound, "lower", space.low)
    upper = (unit > 1 - settings.on_bound, "upper", space.high)
    sentences = []
    for mask, side, bound in (lower, upper):
        for i in np.flatnonzero(mask):
            value = f"{bound[i]:.6g}"
            on_bound = f"{space.names[i]} is on its {side} bound {value}"
            sentences.append(f"{on_bound}, and has no interval there")
    return sentences
