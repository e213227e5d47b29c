"""What the data cannot tell, in words: from the Fisher information of the means."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

# the standard deviation of a uniform law on [0, 1]: a direction known no better is not known
IGNORANT = 0.29
NOTHING = 1e-10  # of the largest eigenvalue: information below it is rounding of the differences
SHARE = 0.05  # of a direction's largest component: smaller ones are left out of its name


def identify(problem: Problem, fit: Fit) -> list[str]:
    """Sentences on parameters and combinations of them that the data do not determine, parameters
    on a bound, signals that do not move or carry no information, and actions that never change;
    none where all is well.
    """
    _, jacobian = problem.simulator.linearize(fit.mean, problem.segments)
    directions = null_directions(problem.space, jacobian, fit.epsilon)
    return [
        *blind_spots(problem, fit.mean, jacobian, directions),
        *_bounds(problem.space, fit.mean),
    ]


def blind_spots(
    problem: Problem, mean: Array, jacobian: Array, directions: Sequence[Array]
) -> list[str]:
    """As `identify`, bounds left out, from the Jacobian (R, p, d) at the mean (d,) and their null
    directions (d,).
    """
    return [
        *undetermined(problem.space, mean, directions),
        *_signals(problem, jacobian),
        *_actions(problem),
    ]


def undetermined(space: ParameterSpace, mean: Array, directions: Sequence[Array]) -> list[str]:
    """Sentences on the parameters (d,), and on combinations of them, that null directions move."""
    return [_name(space, mean, direction) for direction in directions]


def determined(space: ParameterSpace, directions: Sequence[Array]) -> NDArray[np.bool_]:
    """(d,) the parameters that the data tell: those that no null direction moves."""
    out = np.ones(len(space), dtype=bool)
    for direction in directions:
        out[_moved(space, direction)] = False
    return out


def null_directions(space: ParameterSpace, jacobian: Array, epsilon: Array) -> list[Array]:
    """Directions (d,) of the parameters, each of few, that no prediction notices: by the Jacobian
    (R, p, d) under noise variances (p,).
    """
    width = space.high - space.low
    white = (jacobian * width / np.sqrt(np.maximum(epsilon, 1e-300))[:, None]).reshape(
        -1, len(space)
    )
    information = white.T @ white  # of the means, in units of their search intervals
    size = np.diagonal(information)
    told = size > max(1 / IGNORANT**2, NOTHING * float(size.max(initial=0.0)))
    out = list(np.eye(len(space))[~told])
    rest = np.flatnonzero(told)
    if len(rest) < 2:
        return out
    values, vectors = np.linalg.eigh(information[np.ix_(rest, rest)])
    null = vectors[:, values < np.maximum(1 / IGNORANT**2, NOTHING * values[-1])]
    for direction in _sparse(null.T):
        own = np.zeros(len(space))
        own[rest] = direction * width[rest]
        out.append(own)
    return out


def _moved(space: ParameterSpace, direction: Array) -> Ints:
    """The parameters that a direction moves, as shares of their intervals."""
    scaled = np.abs(direction) / (space.high - space.low)
    return np.flatnonzero(scaled > SHARE * scaled.max())


def _sparse(rows: Array) -> list[Array]:
    """A basis of the rows' span with few components each, by elimination from the largest pivots."""
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


def _name(space: ParameterSpace, mean: Array, direction: Array) -> str:
    """What a step along the direction (d,), which no prediction notices, leaves as it is.

    Of two positive parameters, equal steps of their logarithms leave the ratio, opposite ones the
    product; else equal steps leave the difference and opposite ones the sum.
    """
    which = _moved(space, direction)
    names = [space.names[i] for i in which]
    if len(which) == 1:
        return f"the data do not determine {names[0]}"
    if len(which) == 2:
        one, two = names
        relative = (
            direction[which] / mean[which] if (space.low[which] > 0).all() else np.array([1.0, 0.0])
        )
        for (a, b), like, unlike in ((relative, "/", "*"), (direction[which], "-", "+")):
            if abs(abs(a) - abs(b)) < SHARE * max(abs(a), abs(b)):
                return (
                    f"only {one} {like if a * b > 0 else unlike} {two} is determined by the "
                    "data, not each of them"
                )
    joined = f"{', '.join(names[:-1])} and {names[-1]}"
    steps = " : ".join(f"{d:.2g}" for d in direction[which] / np.abs(direction[which]).max())
    return (
        f"the data determine {joined} only together: steps in the proportion {steps} change no "
        "prediction"
    )


def _signals(problem: Problem, jacobian: Array) -> list[str]:
    targets = problem.segments.targets
    still = np.zeros(jacobian.shape[1], dtype=bool)
    if targets.shape[1] == len(still):  # a rotation has fewer compared numbers than observed ones
        still = np.ptp(targets, axis=0) <= 1e-12 * np.maximum(np.abs(targets).max(axis=0), 1e-300)
    silent = ~still & (np.abs(jacobian).max(axis=(0, 2)) == 0)
    told = ((still, "does not move"), (silent, "carries no information on any parameter"))
    names = [signal.name for signal in problem.simulator.signals]
    return [f"{name} {what}" for mask, what in told for name in _chosen(names, mask)]


def _actions(problem: Problem) -> list[str]:
    actions = problem.trajectories.actions
    return [f"action[{i}] never changes" for i in np.flatnonzero(np.ptp(actions, axis=0) == 0)]


def _bounds(space: ParameterSpace, mean: Array) -> list[str]:
    unit = space.to_unit(mean)
    ends = ((unit < 1e-3, "lower", space.low), (unit > 1 - 1e-3, "upper", space.high))
    return [
        f"{space.names[i]} is on its {side} bound {bound[i]:.6g}, and has no interval there"
        for mask, side, bound in ends
        for i in np.flatnonzero(mask)
    ]


def _chosen(names: list[str], mask: NDArray[np.bool_]) -> list[str]:
    return [name for name, kept in zip(names, mask, strict=True) if kept]
