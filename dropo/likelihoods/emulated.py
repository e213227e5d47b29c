"""The Gaussian likelihood with exact moments of a polynomial emulator: no draws, with gradient and Fisher information."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from dropo.core.checks import Array
from dropo.core.data import Segments
from dropo.core.errors import Incompatible
from dropo.core.family import Family
from dropo.core.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.noise import Epsilon, NoiseModel
from dropo.core.parameters import Parameter, ParameterSpace
from dropo.core.simulator import Simulator
from dropo.likelihoods.polynomials import Emulator, build, orders_for, products


@dataclass(frozen=True)
class Emulated(LocalLikelihood):
    """Polynomials in place of the simulator near the estimate; their moments under a member of the family are exact.

    y ~ N(E f, Cov f + R + diag(epsilon)), R the covariance of what the polynomials leave. One design of 1.7 M + 6
    simulations of each segment, M polynomials, is shared by all rows and serves every member near by. order: None, by
    the width, or one order for all.
    """

    order: int | None = None

    def around(
        self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, centre: Array, width: Array,
        rng: np.random.Generator, *, rough: bool = False,
    ) -> LocalLogLikelihood:  # fmt: skip
        if family.standard is None:
            raise Incompatible(
                f"The family {type(family).__name__} names no standard law, so its moments are not known. Use likelihood 'monte-carlo'."
            )
        orders = orders_for(width, simulator.space, self.order, rough)
        logarithmic = family.logarithmic
        c, h = (np.log(centre), width / centre) if logarithmic else (centre, width)
        emulator = build(simulator, segments, c, h, orders, rng, logarithmic=logarithmic)
        return _EmulatedLogLikelihood(emulator, simulator, segments, family, epsilon, centre, width)


class _EmulatedLogLikelihood(LocalLogLikelihood):
    has_gradients = True

    def __init__(
        self, emulator: Emulator, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, centre: Array, width: Array
    ):
        self.emulator, self.family = emulator, family
        self.targets = simulator.targets(segments)
        self.noise = NoiseModel(epsilon, len(simulator.signals)).positive("Emulated")
        self.unknowns = ParameterSpace((*trusted(family, centre, width), *self.noise.unknowns))
        assert family.standard is not None
        base = qmc.Sobol(len(centre), rng=np.random.default_rng(0)).random_base2(int(np.ceil(np.log2(2 * len(emulator.indices)))) + 1)
        self._base = np.clip(base, 1e-6, 1 - 1e-6)
        self._inverse = np.linalg.pinv(products(family.standard.quantile(self._base), emulator.indices, family.standard))

    def _expansion(self, phi: Array) -> Array:
        """A (M, M): the emulator's polynomials in the orthonormal ones of the member, psi_j(x) = sum_k A_kj phi_k."""
        return self._inverse @ self.emulator.basis(self.family.map(phi, self._base))

    def _expansion_slopes(self, phi: Array) -> Array:
        """dA / dphi (m, M, M), by central differences: A is a polynomial of a low order in phi."""
        n = len(self.family.unknowns)
        step = 1e-5 * np.maximum(np.abs(phi[:n]), 1e-3 * (self.family.unknowns.high - self.family.unknowns.low)) * np.eye(n)
        return np.stack([(self._expansion(phi[:n] + s) - self._expansion(phi[:n] - s)) / (2 * s.sum()) for s in step])

    def _moments(self, phi: Array) -> tuple[Array, Array, Array]:
        """Mean (R, p), factor F (R, p, M - 1) and covariance (R, p, p) of the measurement."""
        a, c = self._expansion(phi[: len(self.family.unknowns)]), self.emulator.coefficients
        expanded = np.tensordot(a, c, axes=1)  # (M, R, p)
        factor = np.moveaxis(expanded[1:], 0, 2)
        sigma = factor @ factor.swapaxes(1, 2) + self.emulator.residual
        diagonal = np.arange(c.shape[2])
        sigma[:, diagonal, diagonal] += self.epsilon(phi)
        return expanded[0], factor, sigma

    def _rows(self, phi: Array) -> Array:
        mean, _, sigma = self._moments(phi)
        return log_normal_density(self.targets - mean, sigma)[0]

    def mean(self, phi: Array) -> Array:
        return self._moments(phi)[0]

    def epsilon(self, phi: Array) -> Array:
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def gradient(self, phi: ArrayLike) -> Array:
        return self.expand(np.asarray(phi, dtype=float))[1].sum(axis=0)

    def predict(self, values: Array) -> Array:
        return self.emulator.predict(values)

    def expand(self, phi: Array) -> tuple[float, Array, Array]:
        mean, factor, sigma = self._moments(phi)
        rows, whiten = log_normal_density(self.targets - mean, sigma)
        left = np.einsum("rpq,rq->rp", whiten, self.targets - mean)  # L^-1 r
        white_factor = whiten @ factor
        by_mean, by_cov = [], []
        for slope in self._expansion_slopes(phi):
            moved = np.tensordot(slope, self.emulator.coefficients, axes=1)
            by_mean.append(np.einsum("rpq,rq->rp", whiten, moved[0]))
            half = whiten @ np.moveaxis(moved[1:], 0, 2) @ white_factor.swapaxes(1, 2)
            by_cov.append(half + half.swapaxes(1, 2))
        for own in self.noise.slopes():
            by_mean.append(np.zeros_like(left))
            by_cov.append(whiten * own @ whiten.swapaxes(1, 2))
        return float(rows.sum()), *_scores_and_information(left, np.stack(by_mean), np.stack(by_cov))


def trusted(family: Family, centre: Array, width: Array) -> list[Parameter]:
    """The family's unknowns, means kept within two widths of the centre and scales within two widths."""
    relative = width / centre if family.logarithmic else width
    bounds = {}
    for name, c, h, s in zip(family.space.names, centre, width, relative, strict=True):
        bounds[f"mean.{name}"] = (c - 2 * h, c + 2 * h)
        bounds[f"scale.{name}"] = (0.0, 2 * s)
    out = []
    for p in family.unknowns:
        low, high = bounds.get(p.name, (p.low, p.high))
        low, high = max(p.low, low), min(p.high, high)
        if not low < high:  # the whole trusted interval lies beyond a bound: stay on it
            low, high = (p.low, p.low + 1e-9 * p.width) if high <= p.low else (p.high - 1e-9 * p.width, p.high)
        out.append(Parameter(p.name, low, high, p.unit, p.lower if p.lower <= low else low, p.upper, p.scale))
    return out


def log_normal_density(residual: Array, sigma: Array) -> tuple[Array, Array]:
    """(R,) log N(residual; 0, sigma), and L^-1 (R, p, p)."""
    whiten = np.linalg.inv(np.linalg.cholesky(sigma))
    z = np.einsum("rpq,rq->rp", whiten, residual)
    log_root = -np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum(axis=1)
    return -0.5 * (residual.shape[1] * np.log(2 * np.pi) + (z**2).sum(axis=1)) - log_root, whiten


def _scores_and_information(left: Array, by_mean: Array, by_cov: Array) -> tuple[Array, Array]:
    """Scores (R, m) and Fisher information (m, m) of Gaussian rows, in whitened terms.

    left: L^-1 r (R, p); by_mean: L^-1 dm (m, R, p); by_cov: L^-1 dSigma L^-T (m, R, p, p).
    """
    quadratic = np.einsum("mrpq,rp,rq->rm", by_cov, left, left, optimize=True)
    scores = np.einsum("rp,mrp->rm", left, by_mean) + 0.5 * (quadratic - np.einsum("mrpp->rm", by_cov))
    m = len(by_mean)
    flat_mean, flat_cov = by_mean.reshape(m, -1), by_cov.reshape(m, -1)
    return scores, flat_mean @ flat_mean.T + 0.5 * flat_cov @ flat_cov.T
