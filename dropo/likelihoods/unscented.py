"""The linear likelihood with the curvature along each axis, from the same 2 d + 1 simulations."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import Axial
from dropo.likelihoods.support.gaussian_rows import MomentJacobian, Parts, parts_of_columns
from dropo.likelihoods.support.linear_rows import LinearRows, along
from dropo.likelihoods.support.member_moments import coordinates


@dataclass(frozen=True)
class Unscented(LocalLikelihood):
    """A Gaussian for each row, with the moments of a model that is quadratic along each axis.

    The measurement's mean and covariance under the member are exact for this model, to the member's
    fourth moments; those of two correlated components are taken as a Gaussian's. Crossed curvatures
    are left out: 'emulated' has them, for more simulations. A good first choice for many
    parameters.

    Attributes
    ----------
    memory : MemorySettings
        How much slopes and curvatures of all rows may take, beyond which they are kept in files.

    Notes
    -----
    f(x) = f(c) + J u + sum_i H_i u_i^2 / 2 with u = x - c, from simulations one width to either
    side on each axis.
    """

    memory: MemorySettings = MEMORY

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
        """Return the log-likelihood of members with means near the centre (d,).

        Raises
        ------
        Incompatible
            If the family's fourth moments are not known.
        """
        if family.standard is None:
            raise Incompatible(
                f"The family {type(family).__name__} names no standard distribution, so its fourth"
                " moments are not known. Use likelihood 'linear'."
            )
        axial = along(simulator, segments, family, centre, width, self.memory)
        return UnscentedRows(
            axial, simulator, segments, family, epsilon, centre, width, self.memory
        )


class UnscentedRows(LinearRows):
    """Rows of a model that is quadratic along each axis.

    Parameters
    ----------
    axial : Axial
        Values, slopes and curvatures.
    simulator, segments, family, epsilon, centre, width, memory
        As those of `GaussianRows`.

    Attributes
    ----------
    fourth : (d, d) array
        Cov(u_i^2, u_j^2) / S_ij^2.

    Notes
    -----
    With the slopes J + H (mean - c) at the member's mean in J's place, the mean is that of the
    model there + H diag(S) / 2 and the spread J S J' + H Q H' / 4, with Q = Cov(u_i^2, u_j^2).
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
        memory: MemorySettings = MEMORY,
    ):
        super().__init__(axial, simulator, segments, family, epsilon, centre, width, memory)
        assert family.standard is not None
        square = family.standard.weights @ family.standard.nodes**2
        excess = float(family.standard.weights @ family.standard.nodes**4 / square**2 - 1)
        self.fourth = np.full((len(centre), len(centre)), 2.0)
        np.fill_diagonal(self.fourth, excess)

    def predict_rows(self, values: Array, rows: slice | Ints) -> Array:
        """Return the quadratic model's predictions (K, r, p) of some rows."""
        away = coordinates(self.family, values) - self.centre
        bend = np.moveaxis(self.axial.curvature[rows] @ (away**2).T, -1, 0)
        return super().predict_rows(values, rows) + 0.5 * bend

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        away, covariance = member
        value = constant(self.axial.value[rows], away)
        slope = constant(self.axial.slope[rows], away)
        curvature = constant(self.axial.curvature[rows], away)
        xp = namespace(slope)
        squares = constant(self.fourth, away) * covariance**2
        mean = value + slope @ away + 0.5 * curvature @ (away**2 + xp.linalg.diagonal(covariance))
        at_mean = slope + curvature * away
        by_slope = at_mean @ covariance @ xp.matrix_transpose(at_mean)
        by_curvature = 0.25 * curvature @ squares @ xp.matrix_transpose(curvature)
        return mean, by_slope + by_curvature

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: MomentJacobian
    ) -> Parts:
        away, covariance = member
        by_mean, entries = slopes
        curvature = whiten @ self.axial.curvature[rows]
        at_mean = whiten @ self.axial.slope[rows] + curvature * away

        # d mean: by the member's mean, and by the variances through the curvatures.
        diagonal = entries.first == entries.second
        by_variance = np.zeros_like(by_mean)
        by_variance[:, entries.first[diagonal]] = entries.slopes[:, diagonal]

        # d Sigma: by the covariance's entries through slopes and curvatures, and by the mean, on
        # which the slopes depend.
        a, b = entries.pairs(at_mean)
        c, e = entries.pairs(curvature)
        fourth = (self.fourth * covariance)[entries.first, entries.second]
        by_squares = 0.5 * entries.weights * fourth
        own = MomentJacobian(
            np.concatenate([at_mean, 0.5 * curvature], axis=2),
            np.concatenate([by_mean, by_variance], axis=1),
            np.concatenate([a, c, curvature], axis=2),
            np.concatenate([b, e, at_mean @ covariance], axis=2),
            np.concatenate([entries.weights, by_squares, 2 * by_mean], axis=1),
        )
        return parts_of_columns(z, own.beside(noise))
