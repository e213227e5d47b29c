"""The profile likelihood of one or two parameters: these are held, all else is at its best."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon, Noise
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.numerics.tails import chi2_quantile
from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require
from dropo.evaluation.held_unknowns import HeldUnknowns


@dataclass(frozen=True)
class ProfileSettings:
    """How far a profile goes where its caller does not say.

    Attributes
    ----------
    width : float
        It covers so many standard errors to either side of the estimate.
    points : int
        It is computed at so many values of each parameter.
    """

    width: float = 3.5
    points: int = 21


SETTINGS = ProfileSettings()


@dataclass(frozen=True)
class Profile:
    """The highest log-likelihood at given values of one or two parameters' means.

    Rows count as independent: where they are not, compare with `Fit.interval`.

    Attributes
    ----------
    names : tuple of str
        The one or two parameters.
    grid : tuple of (n,) array
        The values of each, in its unit.
    values : (n,) or (n, n) array
        The highest log-likelihood there, all else at its best [nats].
    best : float
        The highest of all, at no held value [nats].
    """

    names: tuple[str, ...]
    grid: tuple[Array, ...]
    values: Array
    best: float

    def region(self, level: float = 0.95) -> Array:
        """Return where the likelihood-ratio test does not reject.

        Parameters
        ----------
        level : float
            Between 0 and 1.

        Returns
        -------
        (n,) or (n, n) bool array
            Where 2 (best - value) is at most the chi-square quantile.

        Raises
        ------
        BadArgument
            If the level is not between 0 and 1.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Profile.region")
        quantile = chi2_quantile(level, len(self.names))
        return np.asarray(2 * (self.best - self.values) <= quantile)

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the ends of one parameter's region, linear between grid points.

        Parameters
        ----------
        level : float
            Between 0 and 1.

        Returns
        -------
        tuple of float
            In the parameter's unit; infinite where the region goes on beyond the grid.

        Raises
        ------
        BadArgument
            If the profile is one of two parameters, or the level is not between 0 and 1.
        """
        one = len(self.names) == 1
        require(one, "parameters", "one, for an interval", self.names, "Profile.interval")
        inside = self.region(level)
        (grid,) = self.grid
        if not inside.any():
            return float("nan"), float("nan")
        first, last = (int(i) for i in np.flatnonzero(inside)[[0, -1]])
        height = self.best - chi2_quantile(level, 1) / 2
        low = -np.inf if first == 0 else self._crossing(height, first - 1, first)
        high = np.inf if last == len(grid) - 1 else self._crossing(height, last + 1, last)
        return low, high

    def _crossing(self, height: float, outside: int, inside: int) -> float:
        """Where the line between two neighbours of the grid has that height."""
        (grid,) = self.grid
        rise = self.values[inside] - self.values[outside]
        fraction = (height - self.values[outside]) / rise
        return float(grid[outside] + fraction * (grid[inside] - grid[outside]))


def profile(
    problem: Problem,
    fit: Fit,
    parameters: tuple[str, ...],
    *,
    points: int = SETTINGS.points,
    likelihood: LocalLikelihood | None = None,
    epsilon: Epsilon | None = None,
    rng: np.random.Generator | int | None = 0,
    width: float = SETTINGS.width,
) -> Profile:
    """Compute the profile log-likelihood of the means of one or two parameters.

    Parameters
    ----------
    problem : Problem
        That was fitted.
    fit : Fit
        Around which the profile is taken.
    parameters : tuple of str
        One or two names.
    points : int
        Values of each parameter.
    likelihood : LocalLikelihood, optional
        Built around the fit; by default that of the fit, else the emulated.
    epsilon : Epsilon, optional
        Its noise; by default the problem's where it states one, else learned with the rest.
    rng : numpy.random.Generator, int or None
        A generator or a seed.
    width : float
        Standard errors to either side of the estimate.

    Returns
    -------
    Profile

    Raises
    ------
    BadArgument
        If there are not one or two different parameters, or fewer than five points.
    UnknownName
        If there is no such parameter.
    Incompatible
        If the likelihood is not a local one.
    """
    different = len(parameters) in (1, 2) and len(set(parameters)) == len(parameters)
    require(different, "parameters", "one or two names", parameters, "profile")
    require(points >= 5, "points", "at least 5", points, "profile")
    for name in parameters:
        known("parameter", name, problem.space.names)

    # The maximum, and a grid around it.
    generator = np.random.default_rng(rng)
    objective = _local_likelihood(problem, fit, likelihood, epsilon, generator, width)
    unknowns = objective.unknowns
    start = unknowns.clip(_start(objective, fit))
    top = maximize_locally(objective, start)
    means = [f"mean.{name}" for name in parameters]
    places = [unknowns.names.index(mean) for mean in means]
    grids = [_grid(objective, top.phi, place, points, width) for place in places]

    # At each point of the grid, everything else at its best.
    values = np.full([points] * len(places), -np.inf)
    for index in np.ndindex(*values.shape):
        point = [float(grid[i]) for grid, i in zip(grids, index, strict=True)]
        held = HeldUnknowns(objective, dict(zip(means, point, strict=True)))
        if held.free.any():
            values[index] = maximize_locally(held, top.phi[held.free]).value
        else:
            values[index] = held.value_score_information(np.empty(0))[0]
    best = max(top.value, float(values.max()))
    return Profile(tuple(parameters), tuple(grids), values, best)


def _local_likelihood(
    problem: Problem,
    fit: Fit,
    likelihood: LocalLikelihood | None,
    epsilon: Epsilon | None,
    rng: np.random.Generator,
    width: float,
) -> LocalLogLikelihood:
    """The local log-likelihood around a fit, as far as the profile goes."""
    if likelihood is None:
        own = fit.likelihood or "emulated"
        likelihood = find("likelihoods", own)()
    if not isinstance(likelihood, LocalLikelihood):
        raise Incompatible(
            f"A profile needs a local likelihood, and {type(likelihood).__name__} is none. "
            "Give likelihood=Emulated()."
        )
    if epsilon is None:
        stated = problem.epsilon is not None and fit.method != "least-squares"
        epsilon = Noise(
            fit.epsilon,
            None if stated else "each",
            start=problem.start_noise,
            degrees=problem.noise_degrees,
        )
    box = problem.space.high - problem.space.low
    error = np.where(np.isfinite(fit.mean_se), fit.mean_se, box / 6)
    half = np.clip(np.maximum(fit.sd, (width + 1) / 2 * error), 1e-6 * box, box / 6)
    family = find("families", fit.family)(problem.space)
    return likelihood.linearize_at(
        problem.simulator, problem.segments, family, epsilon, fit.mean, half, rng
    )


def _start(objective: LocalLogLikelihood, fit: Fit) -> Array:
    """The fit's own member, and noise as it was found."""
    own = np.ones(len(objective.unknowns) - len(fit.phi))
    return np.concatenate([fit.phi, own])


def _grid(
    objective: LocalLogLikelihood, phi: Array, place: int, points: int, width: float
) -> Array:
    """Values within some standard errors of the maximum, by the information, and within bounds."""
    information = objective.value_score_information(phi)[2]
    error = float(np.sqrt(np.linalg.pinv(information, hermitian=True)[place, place]))
    low = max(objective.unknowns.low[place], phi[place] - width * error)
    high = min(objective.unknowns.high[place], phi[place] + width * error)
    return np.linspace(low, high, points)
