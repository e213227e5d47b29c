"""The profile likelihood of one or two parameters: how well the data are explained where these are
held, all else at its best.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from dropo.core.contracts.fisher_scoring import maximize_locally
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon, Noise
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require

REACH = 3.5  # standard errors to either side of the estimate


@dataclass(frozen=True)
class Profile:
    """grid: the n values of each of the one or two parameters' means; values: (n,) or (n, n), the
    highest log-likelihood there [nats]; best: the highest of all, at no held value. Rows count
    as independent: where they are not, compare with `Fit.interval`.
    """

    names: tuple[str, ...]
    grid: tuple[Array, ...]
    values: Array
    best: float

    def region(self, level: float = 0.95) -> Array:
        """Where the likelihood-ratio test does not reject, a mask like `values`: 2 (best - value)
        <= the chi-square quantile.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Profile.region")
        return np.asarray(2 * (self.best - self.values) <= stats.chi2.ppf(level, len(self.names)))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """The ends of one parameter's region, between grid points by straight lines; infinite where
        the grid does not reach it.
        """
        require(
            len(self.names) == 1,
            "parameters",
            "one, for an interval",
            self.names,
            "Profile.interval",
        )
        inside = self.region(level)
        (grid,) = self.grid
        if not inside.any():
            return float("nan"), float("nan")
        first, last = (int(i) for i in np.flatnonzero(inside)[[0, -1]])
        height = self.best - stats.chi2.ppf(level, 1) / 2
        low = -np.inf if first == 0 else self._crossing(height, first - 1, first)
        high = np.inf if last == len(grid) - 1 else self._crossing(height, last + 1, last)
        return low, high

    def _crossing(self, height: float, outside: int, inside: int) -> float:
        """Where the line between two neighbours of the grid has that height."""
        share = (height - self.values[outside]) / (self.values[inside] - self.values[outside])
        return float(self.grid[0][outside] + share * (self.grid[0][inside] - self.grid[0][outside]))


def profile(
    problem: Problem,
    fit: Fit,
    parameters: tuple[str, ...],
    *,
    points: int = 21,
    likelihood: LocalLikelihood | None = None,
    epsilon: Epsilon | None = None,
    rng: np.random.Generator | int | None = 0,
) -> Profile:
    """The profile log-likelihood of the means of one or two parameters, on `points` values each
    around a fit.

    likelihood: a local one, built around the fit; by default that of the fit, else the emulated.
    epsilon: its noise; by default the problem's where it states one, else learned with the rest.
    """
    require(
        len(parameters) in (1, 2) and len(set(parameters)) == len(parameters),
        "parameters",
        "one or two names",
        parameters,
        "profile",
    )
    require(points >= 5, "points", "at least 5", points, "profile")
    for name in parameters:
        known("parameter", name, problem.space.names)
    objective = _around(problem, fit, likelihood, epsilon, np.random.default_rng(rng))
    start = np.clip(_start(objective, fit), objective.unknowns.low, objective.unknowns.high)
    top = maximize_locally(objective, start)
    places = [objective.unknowns.names.index(f"mean.{name}") for name in parameters]
    grids = [_grid(objective, top.phi, place, points) for place in places]
    values = np.full([points] * len(places), -np.inf)
    for index in np.ndindex(*values.shape):
        held = _Held(
            objective,
            top.phi,
            places,
            np.array([grid[i] for grid, i in zip(grids, index, strict=True)]),
        )
        values[index] = (
            maximize_locally(held, top.phi[held.free]).value
            if held.free.any()
            else held.value_score_information(np.empty(0))[0]
        )
    return Profile(tuple(parameters), tuple(grids), values, max(top.value, float(values.max())))


class _Held(LocalLogLikelihood):
    """A local log-likelihood with some of its unknowns held."""

    def __init__(self, objective: LocalLogLikelihood, phi: Array, places: list[int], values: Array):
        self.objective = objective
        self.whole = phi.copy()
        self.whole[places] = values
        self.free = ~np.isin(np.arange(len(phi)), places)
        self.unknowns = ParameterSpace(
            tuple(p for p, free in zip(objective.unknowns, self.free, strict=True) if free)
        )

    def _at(self, phi: Array) -> Array:
        full = self.whole.copy()
        full[self.free] = phi
        return full

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        value, scores, information = self.objective.value_score_information(self._at(phi))
        return value, scores[:, self.free], information[np.ix_(self.free, self.free)]

    def predict(self, values: Array) -> Array:
        return self.objective.predict(values)

    def _rows(self, phi: Array) -> Array:
        return self.objective.rows(self._at(phi))

    def epsilon(self, phi: Array) -> Array:
        return self.objective.epsilon(self._at(phi))

    def mean(self, phi: Array) -> Array:
        return self.objective.mean(self._at(phi))


def _around(
    problem: Problem,
    fit: Fit,
    likelihood: LocalLikelihood | None,
    epsilon: Epsilon | None,
    rng: np.random.Generator,
) -> LocalLogLikelihood:
    if likelihood is None:
        own = fit.likelihood or "emulated"
        likelihood = find("likelihoods", own)()
    if not isinstance(likelihood, LocalLikelihood):
        raise Incompatible(
            f"A profile needs a local likelihood, and {type(likelihood).__name__} is none. "
            "Give likelihood=Emulated()."
        )
    if epsilon is None:
        learned = None if problem.epsilon is not None and fit.method != "least-squares" else "each"
        epsilon = Noise(
            fit.epsilon, learned, start=problem.start_noise, degrees=problem.noise_degrees
        )  # type: ignore[arg-type]
    box = problem.space.high - problem.space.low
    error = np.where(np.isfinite(fit.mean_se), fit.mean_se, box / 6)
    width = np.clip(np.maximum(fit.sd, (REACH + 1) / 2 * error), 1e-6 * box, box / 6)
    family = find("families", fit.family)(problem.space)
    return likelihood.linearize_at(
        problem.simulator, problem.segments, family, epsilon, fit.mean, width, rng
    )


def _start(objective: LocalLogLikelihood, fit: Fit) -> Array:
    """The fit's own member, and noise as it was found."""
    own = np.ones(len(objective.unknowns) - len(fit.phi))
    return np.concatenate([fit.phi, own])


def _grid(objective: LocalLogLikelihood, phi: Array, place: int, points: int) -> Array:
    """Values within `REACH` standard errors of the maximum, by the information, and within the
    local likelihood's bounds.
    """
    information = objective.value_score_information(phi)[2]
    error = float(np.sqrt(np.linalg.pinv(information, hermitian=True)[place, place]))
    low = objective.unknowns.low[place]
    high = objective.unknowns.high[place]
    return np.linspace(
        max(low, phi[place] - REACH * error), min(high, phi[place] + REACH * error), points
    )
