"""The contract of families: sets of distributions over a simulator's parameters.

A member is drawn by mapping fixed base points, so that objectives are deterministic.
"""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.numerics.array_api import checked, constant, is_tensor, namespace
from dropo.core.numerics.sobol import sobol_points
from dropo.core.numerics.standard_distributions import StandardDistribution
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, require


class Family(ABC):
    """A family of distributions over d parameters; a vector phi (m,) names one member.

    A plug-in sets `unknowns` and writes `_draw`, `mean` and `sd`. With phi as a NumPy array its
    methods return arrays. Those of a family that computes with `dropo.core.numerics.array_api`,
    as the built-in ones, return tensors with their autograd history where phi is a float64 torch
    tensor; one that does not gives no gradients, and says so where its draws are asked for them.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.

    Attributes
    ----------
    space : ParameterSpace
        The d parameters.
    unknowns : ParameterSpace
        The box of phi (m,). A fit prints the unknowns called "mean.<parameter>" and
        "scale.<parameter>" as the family's own mean and scale.
    standard : StandardDistribution or None
        The distribution of each component, where a draw is an affine map of independent
        components of one distribution.
    logarithmic : bool
        Whether it is the logarithm of a draw that is such an affine map.
    redraws : int
        An infeasible draw is repeated this many times, then put on the bound.

    References
    ----------
    Tiboni (2021), section 5.3, for the repeated draws.
    """

    unknowns: ParameterSpace
    standard: StandardDistribution | None = None
    logarithmic = False
    redraws = 20

    def __init__(self, space: ParameterSpace):
        self.space = space

    def base(self, draws: int, rng: np.random.Generator, *, independent: bool = False) -> Array:
        """Make the base points that `draw` maps.

        Parameters
        ----------
        draws : int
            K, the number of parameter vectors to draw.
        rng : numpy.random.Generator
            For the scrambling and the independent points.
        independent : bool
            Whether all points are independent; by default the first attempt is a scrambled Sobol
            set.

        Returns
        -------
        (1 + redraws, K, d) array
            Points inside (0, 1): the first attempt, then those for repeated draws.

        Raises
        ------
        BadArgument
            If there are fewer than 2 draws.
        """
        require(draws >= 2, "K", "at least 2 draws", draws, type(self).__name__)
        sobol_rng, redraw_rng = rng.spawn(2)
        points = redraw_rng.random((1 + self.redraws, draws, len(self.space)))
        if not independent:
            exponent = int(np.ceil(np.log2(draws)))
            points[0] = sobol_points(len(self.space), exponent, sobol_rng)[:draws]
        return clip_to_open_interval(points)

    def draw(self, phi: ArrayLike, base: Array) -> Array:
        """Draw parameter vectors of one member, all of them physically possible.

        Parameters
        ----------
        phi : (m,) array_like
            The member.
        base : (1 + redraws, K, d) array
            Base points, as `base` makes them.

        Returns
        -------
        (K, d) array
            In the parameters' units. An entry that is put on a bound has gradient 0 in phi.

        Raises
        ------
        BadArgument
            If phi has another shape or is not finite.
        Incompatible
            If phi is a tensor, and the family does not work on tensors.
        """
        member = checked("phi", phi, (len(self.unknowns),), type(self).__name__)
        values = self.map(member, base[0])
        for attempt in base[1:]:
            bad = self._infeasible(values)
            if not bad.any():
                return values
            values = namespace(values).where(bad, self.map(member, attempt), values)
        return self.space.feasible(values)

    def map(self, phi: Array, base: Array) -> Array:
        """Draw parameter vectors of one member without a repetition of infeasible ones.

        Parameters
        ----------
        phi : (m,) array
            The member.
        base : (K, d) array
            Base points in (0, 1).

        Returns
        -------
        (K, d) array
            In the parameters' units.

        Raises
        ------
        Incompatible
            If phi is a tensor, and the family does not work on tensors.
        """
        if not is_tensor(phi):
            return self._draw(phi, base)
        member: Any = phi
        failed: Exception | None = None
        try:
            drawn: Any = self._draw(phi, base)
            if is_tensor(drawn) and drawn.requires_grad >= member.requires_grad:
                return drawn
        except (
            RuntimeError,
            TypeError,
        ) as error:  # what torch raises where NumPy is given a tensor
            failed = error
        raise Incompatible(
            f"{type(self).__name__} gives no gradients, since its `_draw` does not work on torch"
            " tensors: put its constants in `dropo.core.numerics.array_api.constant(..., phi)`, or"
            " use an optimizer without gradients, such as 'cma-es'."
        ) from failed

    def sample(self, phi: ArrayLike, draws: int, rng: np.random.Generator) -> Array:
        """Draw independent parameter vectors, such as for training.

        Parameters
        ----------
        phi : (m,) array_like
            The member.
        draws : int
            K, how many.
        rng : numpy.random.Generator
            For the draws.

        Returns
        -------
        (K, d) array
            All physically possible, in the parameters' units.

        Raises
        ------
        BadArgument
            If phi has another shape or is not finite.
        """
        points = rng.random((1 + self.redraws, draws, len(self.space)))
        return self.draw(phi, clip_to_open_interval(points))

    def _infeasible(self, values: Array) -> NDArray[np.bool_]:
        """Which entries (K, d) are drawn again; with correlations, whole rows are."""
        too_low = values < constant(self.space.lower, values)
        too_high = values > constant(self.space.upper, values)
        return too_low | too_high

    @abstractmethod
    def _draw(self, phi: Array, base: Array) -> Array:
        """Map base points (K, d), uniform in (0, 1), to draws (K, d) of the member phi (m,)."""

    @abstractmethod
    def mean(self, phi: Array) -> Array:
        """Give the mean of a member, before infeasible draws are repeated.

        Parameters
        ----------
        phi : (m,) array
            Numbers that name the member, in the order of `unknowns`.

        Returns
        -------
        (d,) array
            In the parameters' units.
        """

    @abstractmethod
    def sd(self, phi: Array) -> Array:
        """Give the standard deviation of a member; under truncation it is less than the scale.

        Parameters
        ----------
        phi : (m,) array
            Numbers that name the member, in the order of `unknowns`.

        Returns
        -------
        (d,) array
            In the parameters' units, before infeasible draws are repeated.
        """

    def scale(self, phi: Array) -> Array:
        """Give the scale of a member, such as the sigma of a truncated Gaussian.

        Parameters
        ----------
        phi : (m,) array
            Numbers that name the member, in the order of `unknowns`.

        Returns
        -------
        (d,) array
            The scale parameters themselves; in the parameters' units unless the family is in
            logarithms.
        """
        return phi[self._scale_columns]

    @cached_property
    def _scale_columns(self) -> list[int]:
        """Where the scales are in phi; kept, since the search costs much at d = 100."""
        column = {name: i for i, name in enumerate(self.unknowns.names)}
        return [column[f"scale.{name}"] for name in self.space.names]

    def correlation(self, phi: Array) -> Array:
        """Give the correlation matrix of a member; the identity unless overridden.

        Parameters
        ----------
        phi : (m,) array
            Numbers that name the member, in the order of `unknowns`.

        Returns
        -------
        (d, d) array
            Array or tensor as `phi`.
        """
        return constant(np.eye(len(self.space)), phi)

    def phi(self, mean: ArrayLike, scale: ArrayLike | None = None) -> Array:
        """Find the member with a given mean and scale.

        Parameters
        ----------
        mean : (d,) array_like
            Its mean, in the parameters' units.
        scale : (d,) array_like, optional
            Its scale, in the parameters' units.

        Returns
        -------
        (m,) array
            The member, clipped to the bounds of phi; unknowns that are not given are in the
            middle of theirs.
        """
        phi = self.unknowns.from_unit(np.full(len(self.unknowns), 0.5))
        given = {"mean": mean} if scale is None else {"mean": mean, "scale": scale}
        for kind, values in given.items():
            for name, value in zip(self.space.names, np.asarray(values), strict=True):
                phi[self.unknowns.names.index(f"{kind}.{name}")] = value
        return self.unknowns.clip(phi)


def clip_to_open_interval(points: Array) -> Array:
    """Move points off the ends of [0, 1], where quantiles are infinite.

    Parameters
    ----------
    points : array
        Of [0, 1].

    Returns
    -------
    array
        Inside (0, 1).
    """
    eps = np.finfo(float).eps
    return np.clip(points, eps, 1 - eps)


def means_and_scales(
    space: ParameterSpace, scale_low: float = 1e-5, scale_high: float = 0.5
) -> ParameterSpace:
    """Make the box of phi for a mean and a scale of each parameter.

    Means are in the parameter's search interval, on the parameter's own search scale; scales are
    searched in logarithms.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    scale_low : float
        Smallest scale in the parameter's unit; for an interval narrower than 1, this fraction of
        it.
    scale_high : float
        Largest scale, as a fraction of the parameter's interval.

    Returns
    -------
    ParameterSpace
        "mean.<parameter>" of each parameter, then "scale.<parameter>" of each.

    References
    ----------
    Tiboni (2021), section 6.2.1.
    """
    means = [Parameter(f"mean.{p.name}", p.low, p.high, p.unit, scale=p.scale) for p in space]
    scales = []
    for p in space:
        low = scale_low * min(1.0, p.width)
        high = scale_high * p.width
        scales.append(Parameter(f"scale.{p.name}", low, high, p.unit, scale="log"))
    return ParameterSpace((*means, *scales))
