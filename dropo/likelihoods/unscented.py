"""The linear likelihood with the curvature along each axis: the same 2 d + 1 simulations of a
segment.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.linear import LinearRows, along, coordinates
from dropo.likelihoods.support.axial import Axial
from dropo.likelihoods.support.gaussian_rows import Columns, Parts, parts_of_columns


@dataclass(frozen=True)
class Unscented(LocalLikelihood):
    """f(x) = f(c) + J u + sum_i H_i u_i^2 / 2, u = x - c, from simulations one width to either side
    on each axis.

    The measurement's mean and covariance under the member are exact for this f, to the member's
    fourth moments; those of two correlated components are taken as a Gaussian's. Crossed curvatures
    are left out: 'emulated' has them, for more simulations. A good first phase for many parameters.
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
        if family.standard is None:
            raise Incompatible(
                f"The family {type(family).__name__} names no standard law, so its fourth "
                "moments are not known. Use likelihood 'linear'."
            )
        axial = along(simulator, segments, family, centre, width)
        return UnscentedRows(axial, simulator, segments, family, epsilon, centre, width)


class UnscentedRows(LinearRows):
    """With slopes J + H (mean - c) at the member's mean: mean + H diag(S) / 2, spread J S J' + H Q
    H' / 4, Q = Cov(u_i^2, u_j^2).
    """

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
        super().__init__(axial, simulator, segments, family, epsilon, centre, width)
        assert family.standard is not None
        square = family.standard.weights @ family.standard.nodes**2
        excess = float(family.standard.weights @ family.standard.nodes**4 / square**2 - 1)
        self.fourth = np.full((len(centre), len(centre)), 2.0)  # Cov(u_i^2, u_j^2) / S_ij^2
        np.fill_diagonal(self.fourth, excess)

    def predict(self, values: Array) -> Array:
        away = coordinates(self.family, values) - self.centre
        return super().predict(values) + 0.5 * np.moveaxis(
            self.axial.curvature @ (away**2).T, -1, 0
        )

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        away, covariance = member
        value, slope, curvature = (
            constant(x[rows], away)
            for x in (self.axial.value, self.axial.slope, self.axial.curvature)
        )
        xp = namespace(slope)
        squares = constant(self.fourth, away) * covariance**2
        mean = value + slope @ away + 0.5 * curvature @ (away**2 + xp.linalg.diagonal(covariance))
        there = slope + curvature * away
        return mean, there @ covariance @ xp.matrix_transpose(
            there
        ) + 0.25 * curvature @ squares @ xp.matrix_transpose(curvature)

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: Columns
    ) -> Parts:
        (away, covariance), (by_mean, entries) = member, slopes
        curvature = whiten @ self.axial.curvature[rows]
        there = whiten @ self.axial.slope[rows] + curvature * away
        by_diagonal = np.zeros_like(by_mean)
        by_diagonal[:, entries.first[entries.first == entries.second]] = entries.slopes[
            :, entries.first == entries.second
        ]
        (a, b), (c, e) = entries.pairs(there), entries.pairs(curvature)
        by_squares = (
            0.5 * entries.weights * (self.fourth * covariance)[entries.first, entries.second]
        )
        own = Columns(
            np.concatenate([there, 0.5 * curvature], axis=2),
            np.concatenate([by_mean, by_diagonal], axis=1),
            np.concatenate([a, c, curvature], axis=2),
            np.concatenate([b, e, there @ covariance], axis=2),
            np.concatenate([entries.weights, by_squares, 2 * by_mean], axis=1),
        )
        return parts_of_columns(z, own.beside(noise))
