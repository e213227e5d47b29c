"""The Gaussian likelihood with exact moments of a polynomial emulator, with Fisher information."""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings
from dropo.core.numerics.sobol import sobol_points
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.support.gaussian_rows import (
    GaussianRows,
    MomentJacobian,
    Parts,
    parts_of_matrices,
)
from dropo.likelihoods.support.polynomials import Emulator, build, orders_for, products


@dataclass(frozen=True)
class Emulated(LocalLikelihood):
    """A Gaussian for each row, with the exact moments of polynomials in the simulator's place.

    One design of 1.7 M + 6 simulations of each segment, for M polynomials, is shared by all rows
    and serves every member near by. Nothing is drawn.

    Attributes
    ----------
    order : int, optional
        One order for all polynomials; None: by the width.
    memory : MemorySettings
        How much the polynomials of all rows may take, beyond which they are kept in a file.

    Notes
    -----
    y ~ N(E f, Cov f + R + diag(epsilon)), with f the polynomials and R the covariance of what they
    leave.
    """

    order: int | None = None
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
            If the family's moments are not known.
        SimulationFailed
            If too many simulations of the design diverge.
        """
        if family.standard is None:
            raise Incompatible(
                f"The family {type(family).__name__} names no standard distribution, so its moments"
                " are not known. Use likelihood 'monte-carlo'."
            )
        orders = orders_for(width, simulator.space, self.order, rough)
        logarithmic = family.logarithmic
        own_centre = np.log(centre) if logarithmic else centre
        own_width = width / centre if logarithmic else width
        emulator = build(
            simulator,
            segments,
            own_centre,
            own_width,
            orders,
            rng,
            logarithmic=logarithmic,
            memory=self.memory,
        )
        return EmulatedRows(
            emulator, simulator, segments, family, epsilon, centre, width, self.memory
        )


class EmulatedRows(GaussianRows):
    """Rows of polynomials, whose moments come from the orthonormal polynomials of the member.

    Parameters
    ----------
    emulator : Emulator
        The polynomials.
    simulator, segments, family, epsilon, centre, width, memory
        As those of `GaussianRows`.
    """

    def __init__(
        self,
        emulator: Emulator,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        memory: MemorySettings = MEMORY,
    ):
        assert family.standard is not None
        terms = len(emulator.indices)
        p = len(simulator.signals)
        m = len(family.unknowns) + p
        row_floats = 3 * m * p * p + 4 * terms * p
        super().__init__(simulator, segments, family, epsilon, centre, width, row_floats, memory)
        self.emulator = emulator

        # Points of the unit box that determine the polynomials of any member.
        exponent = int(np.ceil(np.log2(2 * terms))) + 1
        base = sobol_points(len(centre), exponent, np.random.default_rng(0))
        self._base = np.clip(base, 1e-6, 1 - 1e-6)
        standard = family.standard.quantile(self._base)
        self._inverse = np.linalg.pinv(products(standard, emulator.indices, family.standard))

    def predict(self, values: Array) -> Array:
        """Return the polynomials' predictions (K, R, p) at values (K, d)."""
        return self.emulator.predict(values)

    def predict_rows(self, values: Array, rows: slice | Ints) -> Array:
        """Return the polynomials' predictions (K, r, p) of some rows."""
        return self.emulator.predict(values, rows)

    def anchored(self, value: Array, predictions: Array) -> "EmulatedRows":
        """Return the likelihood with the polynomials' constants shifted to be right at a value."""
        moved = predictions - self.predict(value[None])[0]
        for rows in self.blocks:
            moved[rows] += self.emulator.of_rows(rows)[0]
        out = copy.copy(self)
        out.emulator = replace(self.emulator, constant=moved)
        return out

    def _member(self, own: Any) -> Any:
        """A (M, M): polynomials in the member's orthonormal ones, psi_j(x) = sum_k A_kj phi_k."""
        values = self.family.map(own, constant(self._base, own))
        return constant(self._inverse, own) @ self.emulator.basis(values)

    def _member_slopes(self, own: Array) -> Array:
        """dA / dphi (n, M, M), by central differences: A is a polynomial of a low order in phi."""
        box = self.family.unknowns.high - self.family.unknowns.low
        steps = 1e-5 * np.maximum(np.abs(own), 1e-3 * box) * np.eye(len(own))
        around = np.concatenate([own + steps, own - steps])
        values = np.concatenate([self.family.map(one, self._base) for one in around])
        basis = self.emulator.basis(values).reshape(len(around), len(self._base), -1)
        above, below = np.split(self._inverse @ basis, 2)
        return np.asarray((above - below) / (2 * steps.sum(axis=1))[:, None, None])

    def _expanded(self, member: Any, rows: slice) -> tuple[Any, Any]:
        """Mean (r, p) and factor F (r, p, M - 1) of the predictions: their covariance is F F'."""
        c = constant(self.emulator.of_rows(rows), member)
        expanded = (member @ c.reshape(len(c), -1)).reshape(c.shape)
        return expanded[0], namespace(expanded).permute_dims(expanded[1:], (1, 2, 0))

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        mean, factor = self._expanded(member, rows)
        residual = constant(self.emulator.residual[rows], mean)
        return mean, factor @ namespace(factor).matrix_transpose(factor) + residual

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: MomentJacobian
    ) -> Parts:
        white_factor = (whiten @ self._expanded(member, rows)[1]).swapaxes(1, 2)
        by_mean = []
        by_spread = []
        for slope in slopes:
            mean, factor = self._expanded(slope, rows)
            by_mean.append((whiten @ mean[:, :, None])[:, :, 0])
            half = whiten @ factor @ white_factor
            by_spread.append(half + half.swapaxes(1, 2))
        noise_mean, noise_spread = noise.whole()
        return parts_of_matrices(
            z, np.concatenate([by_mean, noise_mean]), np.concatenate([by_spread, noise_spread])
        )
