"""The Gaussian likelihood of a simulator that is linear around the estimate: 2 d + 1 simulations of
a segment, for many parameters.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import Axial, along_parameters
from dropo.likelihoods.support.gaussian_rows import Columns, GaussianRows, Parts, parts_of_columns

SHARE = 0.5  # of the width: the step of the differences


@dataclass(frozen=True)
class Linear(LocalLikelihood):
    """y ~ N(f(c) + J (mean - c), J S J' + diag(epsilon)), S the covariance of the member, J by
    central differences at c.

    The differences take half the width as their step. Parameters of a logarithmic family are taken
    as their logarithms.
    Nothing stands for what the linear model leaves: with a small epsilon and a wide member,
    'emulated' is the exact one.
    """

    def linearize_at(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        rng: np.random.Generator,
        *,
        rough: bool = False,
    ) -> LocalLogLikelihood:
        axial = along(simulator, segments, family, centre, SHARE * width)
        return LinearRows(axial, simulator, segments, family, epsilon, centre, width)


class LinearRows(GaussianRows):
    """f(x) = value + slope (x - c), x the parameters or their logarithms."""

    def __init__(
        self,
        axial: Axial,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
    ):
        d = len(centre)
        p = len(simulator.signals)
        columns = 2 * max(d, len(family.unknowns) - d) + 3 * p
        super().__init__(
            simulator, segments, family, epsilon, centre, width, 3 * columns**2 + 3 * columns * p
        )
        self.axial = axial
        self.centre = coordinates(family, centre)

    def predict(self, values: Array) -> Array:
        return self.axial.value + np.moveaxis(
            self.axial.slope @ (coordinates(self.family, values) - self.centre).T, -1, 0
        )

    def _member(self, own: Any) -> Any:
        """The member's mean from the centre (d,) and covariance (d, d)."""
        mean, covariance = moments_of(self.family, own)
        return mean - constant(self.centre, mean), covariance

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        away, covariance = member
        value, slope = (constant(x[rows], away) for x in (self.axial.value, self.axial.slope))
        return value + slope @ away, slope @ covariance @ namespace(slope).matrix_transpose(slope)

    def _member_slopes(self, own: Array) -> tuple[Array, "Entries"]:
        mean, covariance = slopes_of_moments(self.family, own)
        return mean, Entries.of(covariance)

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: Columns
    ) -> Parts:
        by_mean, entries = slopes
        slope = whiten @ self.axial.slope[rows]
        a, b = entries.pairs(slope)
        return parts_of_columns(z, Columns(slope, by_mean, a, b, entries.weights).beside(noise))


@dataclass(frozen=True, eq=False)
class Entries:
    """The l entries of the members' covariance that move, first <= second: their places (l,),
    slopes (n, l), and weights (n, l).

    A weight counts an entry beside the diagonal twice, for it stands for its mirror image too.
    """

    first: Ints
    second: Ints
    slopes: Array
    weights: Array

    @staticmethod
    def of(slopes: Array) -> "Entries":
        """From d S (n, d, d)."""
        first, second = (
            places.astype(np.int64)
            for places in np.nonzero(np.triu(np.abs(slopes).max(axis=0, initial=0.0)))
        )
        moved = slopes[:, first, second]
        return Entries(first, second, moved, moved * np.where(first == second, 1, 2))

    def pairs(self, columns: Array) -> tuple[Array, Array]:
        """The columns (r, p, d) of each entry's first and second place, (r, p, l); one object where
        all are on the diagonal.
        """
        a = columns[:, :, self.first]
        return a, a if np.array_equal(self.first, self.second) else columns[:, :, self.second]


def along(
    simulator: Simulator, segments: Segments, family: Family, centre: Array, step: Array
) -> Axial:
    """The simulator along the coordinates in which the family is taken, from steps (d,) in the
    parameters' units.
    """
    relative = step / centre if family.logarithmic else step
    return along_parameters(
        simulator, segments, coordinates(family, centre), relative, logarithmic=family.logarithmic
    )


def coordinates(family: Family, values: Array) -> Array:
    """The values, or their logarithms where the family is logarithmic."""
    return np.log(values) if family.logarithmic else values


def moments_of(family: Family, own: Any) -> tuple[Any, Any]:
    """Mean (d,) and covariance (d, d) of the member, or of its logarithms where the family is
    logarithmic; arrays or tensors.
    """
    xp = namespace(own)
    mean = family.mean(own)
    sd = family.sd(own)
    covariance = constant(family.correlation(own), own) * sd[:, None] * sd[None, :]
    if not family.logarithmic:
        return mean, covariance
    covariance = xp.log1p(
        covariance / (mean[:, None] * mean[None, :])
    )  # exact for multivariate log-normals
    return xp.log(mean) - 0.5 * xp.linalg.diagonal(covariance), covariance


def slopes_of_moments(family: Family, own: Array) -> tuple[Array, Array]:
    """D mean (n, d) and d covariance (n, d, d) of `moments_of` in each of the family's unknowns, by
    central differences.
    """
    box = family.unknowns.high - family.unknowns.low
    step = 1e-6 * np.maximum(np.abs(own), 1e-6 * box) * np.eye(len(own))
    sides = [(moments_of(family, own + s), moments_of(family, own - s), 2 * s.sum()) for s in step]
    mean, covariance = zip(
        *(((up[0] - down[0]) / h, (up[1] - down[1]) / h) for up, down, h in sides), strict=True
    )
    return np.stack(mean), np.stack(covariance)
