"""The contract of distributions over parameters: drawn by mapping fixed base points, so that
objectives are deterministic.
"""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from dropo.core.numerics.array_api import checked, constant, namespace
from dropo.core.numerics.standard_distributions import StandardDistribution
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array, require


class Family(ABC):
    """A family of distributions over the parameters of `space`; phi (m,) names a member.

    phi as a NumPy array gives arrays; as a torch tensor in float64, tensors with their history
    (`dropo.core.numerics.array_api`). A plug-in sets `unknowns` (the box of phi) and writes
    `_draw`, `mean` and `sd`. The unknowns called "mean.<parameter>" and "scale.<parameter>" are
    what a fit prints as the family's own mean and scale.
    """

    unknowns: ParameterSpace
    standard: StandardDistribution | None = (
        None  # where a draw is an affine map of independent components of one law: that law
    )
    logarithmic = False  # whether it is the draw's logarithm that is such a map
    # thesis, section 5.3: an infeasible draw is made again so many times, then put on the bound
    redraws = 20

    def __init__(self, space: ParameterSpace):
        self.space = space

    def base(self, draws: int, rng: np.random.Generator, *, independent: bool = False) -> Array:
        """Base points (1 + redraws, K, d) in (0, 1): a scrambled Sobol set, or independent ones,
        and the further attempts behind.
        """
        require(draws >= 2, "K", "at least 2 draws", draws, type(self).__name__)
        sobol, again = rng.spawn(2)
        points = again.random((1 + self.redraws, draws, len(self.space)))
        if not independent:
            points[0] = qmc.Sobol(len(self.space), rng=sobol).random_base2(
                int(np.ceil(np.log2(draws)))
            )[:draws]
        return _inside(points)

    def draw(self, phi: ArrayLike, base: Array) -> Array:
        """K parameter vectors (K, d) of member phi (m,), from base points (1 + redraws, K, d); all
        physically possible.

        An entry that is put on a bound has no slope in phi.
        """
        member = checked("phi", phi, (len(self.unknowns),), type(self).__name__)
        values = self._draw(member, base[0])
        for attempt in base[1:]:
            bad = self._infeasible(values)
            if not bad.any():
                return values
            values = namespace(values).where(bad, self._draw(member, attempt), values)
        return self.space.feasible(values)

    def map(self, phi: Array, base: Array) -> Array:
        """Draws (K, d) of member phi at base points (K, d), infeasible ones as they come."""
        return self._draw(phi, base)

    def sample(self, phi: ArrayLike, draws: int, rng: np.random.Generator) -> Array:
        """Independent draws (K, d), for training under the member."""
        return self.draw(phi, _inside(rng.random((1 + self.redraws, draws, len(self.space)))))

    def _infeasible(self, values: Array) -> NDArray[np.bool_]:
        """(K, d) bool, which entries are made again; families with correlations make whole rows
        again.
        """
        return (values < constant(self.space.lower, values)) | (
            values > constant(self.space.upper, values)
        )

    @abstractmethod
    def _draw(self, phi: Array, base: Array) -> Array:
        """Maps base points (K, d) in (0, 1), uniform under the law, to draws (K, d) of member phi."""

    @abstractmethod
    def mean(self, phi: Array) -> Array:
        """(d,) the member's mean, before infeasible draws are made again."""

    @abstractmethod
    def sd(self, phi: Array) -> Array:
        """(d,) the member's standard deviation, likewise; under truncation it is below the scale."""

    def scale(self, phi: Array) -> Array:
        """(d,) the family's own scale parameter (the sigma of a truncated Gaussian)."""
        return phi[self._scales]

    @cached_property
    def _scales(self) -> list[int]:
        """Where the scales are in phi; found once, as searching d names d times costs more than a
        fit's algebra at d = 100.
        """
        place = {name: i for i, name in enumerate(self.unknowns.names)}
        return [place[f"scale.{name}"] for name in self.space.names]

    def correlation(self, phi: Array) -> Array:
        """(d, d) the member's correlation matrix."""
        return constant(np.eye(len(self.space)), phi)

    def phi(self, mean: ArrayLike, scale: ArrayLike | None = None) -> Array:
        """The member of that mean and scale (d,) each, moved into the bounds of phi; what is not
        given is in its middle.
        """
        phi = self.unknowns.from_unit(np.full(len(self.unknowns), 0.5))
        given = {"mean": mean} if scale is None else {"mean": mean, "scale": scale}
        for kind, values in given.items():
            for name, value in zip(self.space.names, np.asarray(values), strict=True):
                phi[self.unknowns.names.index(f"{kind}.{name}")] = value
        return np.clip(phi, self.unknowns.low, self.unknowns.high)


def _inside(points: Array) -> Array:
    """Points of [0, 1] moved off its ends, where quantiles are infinite."""
    tiny = np.finfo(float).eps
    return np.clip(points, tiny, 1 - tiny)


def means_and_scales(
    space: ParameterSpace, scale_low: float = 1e-5, scale_high: float = 0.5
) -> ParameterSpace:
    """The thesis' box of phi: means in the search interval (each parameter's own way), scales in
    logarithms (section 6.2.1).

    scale_low: the least scale, in the parameter's unit, or that share of an interval narrower than
    1;
    scale_high: the largest, as a share of the interval.
    """
    means = [Parameter(f"mean.{p.name}", p.low, p.high, p.unit, scale=p.scale) for p in space]
    scales = [
        Parameter(
            f"scale.{p.name}",
            scale_low * min(1.0, p.width),
            scale_high * p.width,
            p.unit,
            scale="log",
        )
        for p in space
    ]
    return ParameterSpace((*means, *scales))
