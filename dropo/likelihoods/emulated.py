"""The Gaussian likelihood with exact moments of a polynomial emulator: no draws, with gradient and
Fisher information.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.support.gaussian_rows import Columns, GaussianRows, Parts, parts_of_matrices
from dropo.likelihoods.support.polynomials import Emulator, build, orders_for, products


@dataclass(frozen=True)
class Emulated(LocalLikelihood):
    """Polynomials in place of the simulator near the estimate; their moments under a member of the
    family are exact.

    y ~ N(E f, Cov f + R + diag(epsilon)), R the covariance of what the polynomials leave. One
    design of 1.7 M + 6 simulations of each segment, M polynomials, is shared by all rows and serves
    every member near by. order: None, by the width, or one order for all.
    """

    order: int | None = None

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
                f"The family {type(family).__name__} names no standard law, so its moments "
                "are not known. Use likelihood 'monte-carlo'."
            )
        orders = orders_for(width, simulator.space, self.order, rough)
        logarithmic = family.logarithmic
        c, h = (np.log(centre), width / centre) if logarithmic else (centre, width)
        emulator = build(simulator, segments, c, h, orders, rng, logarithmic=logarithmic)
        return EmulatedRows(emulator, simulator, segments, family, epsilon, centre, width)


class EmulatedRows(GaussianRows):
    """Moments from the polynomials expanded in the orthonormal ones of the member."""

    def __init__(
        self,
        emulator: Emulator,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
    ):
        assert family.standard is not None
        terms = len(emulator.indices)
        p = len(simulator.signals)
        m = len(family.unknowns) + len(simulator.signals)
        super().__init__(
            simulator, segments, family, epsilon, centre, width, 3 * m * p * p + 4 * terms * p
        )
        self.emulator = emulator
        base = qmc.Sobol(len(centre), rng=np.random.default_rng(0)).random_base2(
            int(np.ceil(np.log2(2 * terms))) + 1
        )
        self._base = np.clip(base, 1e-6, 1 - 1e-6)
        self._inverse = np.linalg.pinv(
            products(family.standard.quantile(self._base), emulator.indices, family.standard)
        )

    def predict(self, values: Array) -> Array:
        return self.emulator.predict(values)

    def _member(self, own: Any) -> Any:
        """A (M, M): the emulator's polynomials in the orthonormal ones of the member, psi_j(x) =
        sum_k A_kj phi_k.
        """
        return constant(self._inverse, own) @ self.emulator.basis(
            self.family.map(own, constant(self._base, own))
        )

    def _member_slopes(self, own: Array) -> Array:
        """DA / dphi (n, M, M), by central differences: A is a polynomial of a low order in phi."""
        step = (
            1e-5
            * np.maximum(np.abs(own), 1e-3 * (self.family.unknowns.high - self.family.unknowns.low))
            * np.eye(len(own))
        )
        return np.stack(
            [(self._member(own + s) - self._member(own - s)) / (2 * s.sum()) for s in step]
        )

    def _expanded(self, member: Any, rows: slice) -> tuple[Any, Any]:
        """Mean (r, p) and factor F (r, p, M - 1) of the predictions: their covariance is F F'."""
        c = constant(self.emulator.coefficients[:, rows], member)
        expanded = (member @ c.reshape(len(c), -1)).reshape(c.shape)
        return expanded[0], namespace(expanded).permute_dims(expanded[1:], (1, 2, 0))

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        mean, factor = self._expanded(member, rows)
        return mean, factor @ namespace(factor).matrix_transpose(factor) + constant(
            self.emulator.residual[rows], mean
        )

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: Columns
    ) -> Parts:
        white_factor = (whiten @ self._expanded(member, rows)[1]).swapaxes(1, 2)
        by_mean = []
        by_spread = []
        for slope in slopes:
            mean, factor = self._expanded(slope, rows)
            by_mean.append((whiten @ mean[:, :, None])[:, :, 0])
            half = whiten @ factor @ white_factor
            by_spread.append(half + half.swapaxes(1, 2))
        own_mean, own_spread = noise.whole()
        return parts_of_matrices(
            z, np.concatenate([by_mean, own_mean]), np.concatenate([by_spread, own_spread])
        )
