"""The distribution that draws come from, as numbers that a file of another tool can hold.

`FittedDistribution` is written into such files as it stands here; it needs NumPy alone.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.numerics.standard_distributions import NORMAL, TRUNCATED_NORMAL, UNIFORM
from dropo.core.records.fits.fit import Fit
from dropo.core.services.registry import find
from dropo.core.services.validation import Array

REDRAWS = 20
"""An impossible draw is repeated this many times, then put on the bound."""
CUT = 2.0
"""Where a truncated normal distribution ends, in standard deviations before truncation."""
PROBE = 0.75
"""The base point at which a family's scale is read."""
KINDS = {id(NORMAL): "normal", id(TRUNCATED_NORMAL): "truncated normal", id(UNIFORM): "uniform"}
"""What the standard distributions of families are called here."""


@dataclass(frozen=True, eq=False)
class FittedDistribution:
    """A distribution of d parameters: an affine map of standard components, or its exponential.

    Attributes
    ----------
    names : tuple of str
        The parameters.
    kind : {"normal", "truncated normal", "uniform"}
        Of the components: uniform on [-1, 1], normal, or that cut at two standard deviations.
    logarithmic : bool
        Whether the logarithm of a draw is the affine map.
    centre : (d,) array
        Where all components are 0.
    factor : (d, d) array
        What the components are times.
    error : (d,) array
        Standard errors of the means, which are added to the spread.
    lower, upper : (d,) array
        What is physically possible.
    """

    names: tuple[str, ...]
    kind: str
    logarithmic: bool
    centre: Array
    factor: Array
    error: Array
    lower: Array
    upper: Array

    @property
    def together(self) -> bool:
        """Whether parameters depend on each other; an impossible draw is then repeated whole."""
        return bool(np.count_nonzero(self.factor - np.diag(np.diag(self.factor))))

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """Draw parameter vectors.

        A draw outside of what is physically possible is repeated up to `REDRAWS` times, then put on
        the bound. Standard errors of the means are added to it.

        Parameters
        ----------
        count : int
            How many vectors to draw.
        rng : numpy.random.Generator
            What random numbers come from.

        Returns
        -------
        (count, d) array
            The draws, in the parameters' units.
        """
        values = self._attempt(count, rng)
        for _ in range(REDRAWS):
            bad = (values < self.lower) | (values > self.upper)
            if self.together:
                bad = np.broadcast_to(bad.any(axis=1, keepdims=True), bad.shape)
            if not bad.any():
                break
            values = np.where(bad, self._attempt(count, rng), values)
        values = np.clip(values, self.lower, self.upper)
        values = values + self.error * rng.standard_normal(values.shape)
        return np.clip(values, self.lower, self.upper)

    def _attempt(self, count: int, rng: np.random.Generator) -> Array:
        """Draws (count, d) that may be impossible."""
        shape = (count, len(self.names))
        if self.kind == "uniform":
            parts = rng.uniform(-1, 1, shape)
        else:
            parts = rng.standard_normal(shape)
        while self.kind == "truncated normal" and np.any(np.abs(parts) > CUT):
            again = rng.standard_normal(shape)
            parts = np.where(np.abs(parts) > CUT, again, parts)
        values = self.centre + parts @ self.factor.T
        return np.exp(values) if self.logarithmic else values


def distribution_of(fit: Fit) -> tuple[FittedDistribution, tuple[str, ...]]:
    """Find the distribution that policies are trained under.

    It is the fit's, and what is not known of its means.

    Parameters
    ----------
    fit : Fit
        The fit, of d parameters. Of a posterior of constant parameters, the spread is what is not
        known.

    Returns
    -------
    distribution : FittedDistribution
        Of the d parameters, in their units.
    approximated : tuple of str
        What is not as in the fit, a sentence each.

    Raises
    ------
    UnknownName
        If the fit's family is not registered here, as where it is a plug-in's.
    """
    family = find("families", fit.family)(fit.space)
    bounds = (fit.space.lower, fit.space.upper)
    error = np.nan_to_num(fit.mean_se)
    if fit.parameters_are_constant:
        error = np.zeros(len(error))
    names = fit.space.names
    if id(family.standard) not in KINDS:
        factor = fit.sd[:, None] * np.linalg.cholesky(fit.correlation)
        distribution = FittedDistribution(names, "normal", False, fit.mean, factor, error, *bounds)
        return distribution, (
            f"The family {fit.family!r} is drawn as a normal one of the same moments.",
        )
    d = len(names)
    base = np.full((d + 1, d), 0.5)
    base[1:][np.diag_indices(d)] = PROBE
    points = np.asarray(family.map(fit.phi, base), dtype=float)
    if family.logarithmic:
        points = np.log(points)
    scale = float(np.asarray(family.standard.quantile(np.array([PROBE])))[0])
    factor = (points[1:] - points[0]).T / scale
    kind = KINDS[id(family.standard)]
    return FittedDistribution(
        names, kind, family.logarithmic, points[0], factor, error, *bounds
    ), ()
