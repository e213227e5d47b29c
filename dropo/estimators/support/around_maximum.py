"""A local likelihood around its own maximum, wide enough for the posterior."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Noise, NoiseModel
from dropo.core.contracts.problem import Problem
from dropo.core.records.draws import Draws
from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.estimators.support.posterior_targets import Local


@dataclass(frozen=True)
class WidthSettings:
    """How wide a local model is, which is trusted to twice its width.

    Attributes
    ----------
    errors : float
        A model is as wide as so many standard errors of the means.
    least : float
        Smallest width, as a fraction of the search interval.
    first : float
        Largest width of the first model, as a fraction of the search interval.
    largest : float
        Largest width of any model, as a fraction of the search interval.
    edge : float
        This fraction of a trusted interval, at either end, is its edge.
    crowded : float
        A model is too narrow where more than this fraction of the draws lies in an edge.
    """

    errors: float = 3.0
    least: float = 1e-4
    first: float = 1 / 6
    largest: float = 1 / 4
    edge: float = 0.025
    crowded: float = 0.01


@dataclass
class AroundMaximum:
    """What builds the local likelihood where DROPO finds its maximum.

    Attributes
    ----------
    problem : Problem
    run : Run
    family : Family
        The distributions to choose from, named `family_name`.
    family_name : str
    likelihood : LocalLikelihood
        What builds the local likelihoods.
    noise : Noise
    space : ParameterSpace, optional
        What the unknowns are called in, where they have no spread.
    settings : WidthSettings
    """

    problem: Problem
    run: Run
    family: Family
    family_name: str
    likelihood: LocalLikelihood
    noise: Noise
    space: ParameterSpace | None = None
    settings: WidthSettings = field(default_factory=WidthSettings)

    def __post_init__(self) -> None:
        self.box = self.problem.space.high - self.problem.space.low

    def head(self) -> Local:
        """Build the likelihood around its maximum.

        Returns
        -------
        Local
            As wide as the distribution and some standard errors of its means, by the Fisher
            information.
        """
        found = self._maximum()
        self.centre = found.mean
        self.best = np.concatenate([found.phi, self._noise_factors(found.epsilon)])
        # Once by the fit's own errors, then by those that the likelihood has there.
        self.width = self._first_width(found.sd, np.nan_to_num(found.mean_se))
        self.width = self._first_width(found.sd, self._standard_errors(self._build().bound))
        return self._build()

    def wider(self, draws: Draws, edges: list[str]) -> Local:
        """Build the likelihood around draws that met the edge of the last one.

        Parameters
        ----------
        draws : Draws
            From the last one.
        edges : list of str
            The unknowns that met it.

        Returns
        -------
        Local
            Twice as wide in the parameters of these unknowns.
        """
        flat = draws.flat()
        names = self.problem.space.names
        self.best = flat[int(draws.log_density.argmax())]
        columns = [draws.names.index(name if self.space else f"mean.{name}") for name in names]
        self.centre = flat[:, columns].mean(axis=0)
        met = [bool({name, f"mean.{name}", f"scale.{name}"}.intersection(edges)) for name in names]
        growth = np.where(met, 2, 1)
        self.width = np.minimum(growth * self.width, self.settings.largest * self.box)
        return self._build()

    def edges(self, draws: Draws, target: Local) -> list[str]:
        """Name the unknowns whose draws crowd at an end of where the model is trusted.

        Parameters
        ----------
        draws : Draws
        target : Local
            The likelihood that they were drawn from.

        Returns
        -------
        list of str
            Ends of the search itself do not count.
        """
        trusted = target.unknowns
        place = (draws.flat() - trusted.low) / (trusted.high - trusted.low)
        edge = self.settings.edge
        crowded = []
        for i, own in enumerate(self.family.unknowns):
            low = (place[:, i] < edge).mean() if trusted.low[i] > own.low else 0.0
            high = (place[:, i] > 1 - edge).mean() if trusted.high[i] < own.high else 0.0
            if low + high > self.settings.crowded:
                crowded.append(trusted.names[i])
        return crowded

    def _maximum(self) -> Fit:
        """DROPO's fit."""
        epsilon: Any = "learn"
        if not self.noise.learned:
            count = len(self.problem.simulator.signals)
            epsilon = tuple(np.broadcast_to(self.noise.variance, count).tolist())
        estimator = find("methods", "dropo")(
            likelihood=self.likelihood,
            family=self.family_name,
            epsilon=epsilon,
            start_noise=self.noise.start,
            degrees=self.noise.degrees,
        )
        # Draws have the priors; the likelihood is built where the data alone are best.
        found: Fit = estimator._fit(replace(self.problem, priors={}), self.run)
        self.run.best = None  # of another method
        return found

    def _build(self) -> Local:
        """The likelihood around the centre."""
        with self.run.counting(evaluations=1):
            bound = self.likelihood.linearize_at(
                self.problem.simulator,
                self.problem.segments,
                self.family,
                self.noise,
                self.centre,
                self.width,
                self.run.rng.spawn(1)[0],
            )
        local = Local(bound, self.best)
        if self.space:
            local.rename(self.space)
        return local

    def _standard_errors(self, bound: LocalLogLikelihood) -> Array:
        """(d,) of the means, with a flat prior's information on the box added."""
        d = len(self.box)
        best = bound.unknowns.clip(self.best)
        information = bound.value_score_information(best)[2][:d, :d] + np.diag(12 / self.box**2)
        return np.sqrt(np.abs(np.diagonal(np.linalg.inv(information))))

    def _first_width(self, sd: Array, errors: Array) -> Array:
        """(d,) the width for a distribution's standard deviations and its means' errors."""
        settings = self.settings
        wanted = np.maximum(2 * sd, settings.errors * errors)
        return np.clip(wanted, settings.least * self.box, settings.first * self.box)

    def _noise_factors(self, epsilon: Array) -> Array:
        """The likelihood's own unknowns at the noise variances (p,) that were found."""
        model = NoiseModel(self.noise, len(epsilon))
        unknowns = ParameterSpace(model.unknowns)
        factors = epsilon / model.shape
        if len(unknowns) != len(factors):
            factors = np.full(len(unknowns), np.exp(np.log(factors).mean()))
        return unknowns.clip(factors)


def unit_spread(target: Local) -> Array:
    """Find the widths of a likelihood's maximum, each with the other unknowns held fixed.

    Parameters
    ----------
    target : Local

    Returns
    -------
    (m,) array
        In the unit box, by the Fisher information.
    """
    space = target.unknowns
    with np.errstate(divide="ignore"):
        error = 1 / np.sqrt(np.diagonal(target.bound.value_score_information(target.best)[2]))
    above = space.to_unit(space.clip(target.best + error))
    below = space.to_unit(space.clip(target.best - error))
    return np.clip((above - below) / 2, 1e-9, 0.1)
