"""What likelihoods share whose rows are Gaussian given phi, or Student t: noise, blocks, scores and
information.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import gammaln

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, is_tensor, namespace, plain
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import along_starts
from dropo.likelihoods.support.blocks import row_blocks


@dataclass(frozen=True, eq=False)
class Columns:
    """Slopes of a block of r rows as sums over columns, m unknowns.

    d mean / d theta_i = sum_k by_mean[i, k] mean_k; d Sigma / d theta_i = sum_k by_spread[i, k]
    (a_k b_k' + b_k a_k') / 2.
    mean: (r, p, k); by_mean: (m, k); a, b: (r, p, l), one object where they are equal; by_spread:
    (m, l).
    """

    mean: Array
    by_mean: Array
    a: Array
    b: Array
    by_spread: Array

    def whitened(self, whiten: Array) -> "Columns":
        """The same in coordinates in which Sigma is 1; whiten: L^-1 (r, p, p), Sigma = L L'."""
        a = whiten @ self.a
        return Columns(
            whiten @ self.mean,
            self.by_mean,
            a,
            a if self.b is self.a else whiten @ self.b,
            self.by_spread,
        )

    def beside(self, other: "Columns") -> "Columns":
        """The slopes in the unknowns of both."""
        a = np.concatenate([self.a, other.a], axis=2)
        b = (
            a
            if self.b is self.a and other.b is other.a
            else np.concatenate([self.b, other.b], axis=2)
        )
        mean = np.concatenate([self.mean, other.mean], axis=2)
        return Columns(
            mean,
            block_diag(self.by_mean, other.by_mean),
            a,
            b,
            block_diag(self.by_spread, other.by_spread),
        )

    def whole(self) -> tuple[Array, Array]:
        """D mean (m, r, p) and d Sigma (m, r, p, p), where a and b are equal."""
        return np.einsum("rpk,ik->irp", self.mean, self.by_mean), (
            self.a * self.by_spread[:, None, None]
        ) @ self.a.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class Parts:
    """What scores and information are made of, for r rows and m unknowns, with z = L^-1 residual
    and V = L^-1 d Sigma L^-T.

    location: z' L^-1 d mean (r, m); quadratic: z' V z (r, m); trace: tr V (r, m); by_mean: the sum
    over rows of d mean' Sigma^-1 d mean (m, m); by_spread: the sum over rows of tr(V V) / 2 (m, m).
    """

    location: Array
    quadratic: Array
    trace: Array
    by_mean: Array
    by_spread: Array


def parts_of_columns(z: Array, c: Columns) -> Parts:
    """From whitened columns; no matrix (p, p) is made for any unknown."""
    flat = c.mean.reshape(-1, c.mean.shape[2])
    aa = c.a.swapaxes(1, 2) @ c.a
    if c.b is c.a:
        inner = 0.5 * np.einsum("rkl,rkl->kl", aa, aa)
    else:
        ab = c.a.swapaxes(1, 2) @ c.b
        inner = 0.25 * (
            np.einsum("rkl,rkl->kl", aa, c.b.swapaxes(1, 2) @ c.b)
            + np.einsum("rkl,rlk->kl", ab, ab)
        )
    toward_mean, toward_a, toward_b = (
        (z[:, None] @ columns)[:, 0] for columns in (c.mean, c.a, c.b)
    )
    return Parts(
        toward_mean @ c.by_mean.T,
        (toward_a * toward_b) @ c.by_spread.T,
        np.einsum("rpk,rpk->rk", c.a, c.b) @ c.by_spread.T,
        c.by_mean @ (flat.T @ flat) @ c.by_mean.T,
        c.by_spread @ inner @ c.by_spread.T,
    )


def parts_of_matrices(z: Array, by_mean: Array, by_spread: Array) -> Parts:
    """From L^-1 d mean (m, r, p) and L^-1 d Sigma L^-T (m, r, p, p)."""
    m = len(by_mean)
    flat_mean = by_mean.reshape(m, -1)
    flat_spread = by_spread.reshape(m, -1)
    return Parts(
        np.einsum("rp,mrp->rm", z, by_mean),
        np.einsum("mrpq,rp,rq->rm", by_spread, z, z, optimize=True),
        np.einsum("mrpp->rm", by_spread),
        flat_mean @ flat_mean.T,
        0.5 * flat_spread @ flat_spread.T,
    )


class GaussianRows(LocalLogLikelihood):
    """y ~ N(mean, Sigma) row by row, Sigma = the member's spread + noise, or the Student t of that
    scale matrix.

    A plug-in writes what a member gives: `_member`, `_spread`, `_member_slopes` and `_parts`. Noise
    of the start states goes through f's slopes J and curvatures H in them: mean + H epsilon / 2,
    Sigma + J diag(epsilon) J' + H diag(epsilon^2) H' / 2.
    """

    has_gradients = True

    def __init__(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        row_floats: int,
    ):
        """centre, width: (d,) the region in the parameters' units; row_floats: numbers that
        `expand` holds at once for a row.
        """
        self.family = family
        self.targets = simulator.targets(segments)
        self.noise = NoiseModel(epsilon, len(simulator.signals)).positive(type(self).__name__)
        self.unknowns = ParameterSpace((*trusted(family, centre, width), *self.noise.unknowns))
        self.blocks = row_blocks(len(self.targets), 8 * row_floats)
        self.starts = (
            along_starts(simulator, segments, centre, self.noise)
            if self.noise.noise.start
            else None
        )

    @abstractmethod
    def _member(self, own: Any) -> Any:
        """What the family's unknowns (n,), array or tensor, mean for all rows; made once for all
        blocks.
        """

    @abstractmethod
    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        """Mean (r, p) and covariance (r, p, p) of the block's rows without noise, arrays or
        tensors.
        """

    @abstractmethod
    def _member_slopes(self, own: Array) -> Any:
        """The slopes of the member in the family's unknowns; made once for all blocks."""

    @abstractmethod
    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: Columns
    ) -> Parts:
        """Of the family's n unknowns, then of those of the noise, whose whitened columns are given."""

    def _own(self, phi: Any) -> Any:
        return phi[: len(self.family.unknowns)]

    def epsilon(self, phi: Array) -> Array:
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def _moments(self, member: Any, epsilon: Any, rows: slice) -> tuple[Any, Any]:
        mean, sigma = self._spread(member, rows)
        xp = namespace(mean, epsilon)
        epsilon = constant(epsilon, mean)
        sigma = sigma + constant(np.eye(len(self.noise.shape)), mean) * epsilon
        if self.noise.noise.rows is not None:
            sigma = sigma + constant(self.noise.noise.rows[rows], mean)
        if self.starts is None:
            return mean, sigma
        slope, curvature = (
            constant(x[rows], mean) for x in (self.starts.slope, self.starts.curvature)
        )
        sigma = (
            sigma
            + (slope * epsilon) @ xp.matrix_transpose(slope)
            + 0.5 * (curvature * epsilon**2) @ xp.matrix_transpose(curvature)
        )
        return mean + 0.5 * curvature @ epsilon, sigma

    def moments(self, phi: Array) -> tuple[Array, Array]:
        """Mean (R, p) and Sigma (R, p, p) of the measurements under phi."""
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        means, sigmas = zip(
            *(self._moments(member, epsilon, rows) for rows in self.blocks), strict=True
        )
        return np.concatenate(means), np.concatenate(sigmas)

    def mean(self, phi: Array) -> Array:
        return self.moments(phi)[0]

    def _rows(self, phi: Array) -> Array:
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        out = [
            self._density(*self._moments(member, epsilon, rows), rows)[0] for rows in self.blocks
        ]
        return namespace(*out).concat(out)

    def _density(self, mean: Any, sigma: Any, rows: slice) -> tuple[Any, Any, Any, Any]:
        """Log density (r,), L^-1 (r, p, p), z = L^-1 residual (r, p) and z' z (r,)."""
        xp = namespace(sigma)
        p = sigma.shape[-1]
        nu = self.noise.noise.degrees
        whiten = xp.linalg.inv(self._root(sigma, rows))
        z = (whiten @ (constant(self.targets[rows], mean) - mean)[:, :, None])[:, :, 0]
        distance = xp.sum(z**2, axis=1)
        log_root = -xp.sum(xp.log(xp.linalg.diagonal(whiten)), axis=1)
        if nu is None:
            return -0.5 * (p * np.log(2 * np.pi) + distance) - log_root, whiten, z, distance
        scale = float(gammaln((nu + p) / 2) - gammaln(nu / 2)) - 0.5 * p * np.log(np.pi * nu)
        return scale - log_root - 0.5 * (nu + p) * xp.log1p(distance / nu), whiten, z, distance

    def _root(self, sigma: Any, rows: slice) -> Any:
        try:
            return namespace(sigma).linalg.cholesky(sigma)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            if is_tensor(sigma) and "cholesky" not in str(error):
                raise
            least = np.linalg.eigvalsh(plain(sigma))[:, 0]
            row = int(least.argmin())
            raise BadArgument(
                f"The covariance of row {rows.start + row} is not positive definite: its "
                f"least eigenvalue is {least[row]:.3g}, its largest"
                f" entry {np.abs(plain(sigma)[row]).max():.3g}. Give a larger epsilon, or "
                "narrower bounds of the scales."
            ) from None

    def gradient(self, phi: ArrayLike) -> Array:
        return self.value_score_information(np.asarray(phi, dtype=float))[1].sum(axis=0)

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        own = self._own(phi)
        epsilon = self.epsilon(phi)
        p = self.targets.shape[1]
        member = self._member(own)
        slopes = self._member_slopes(own)
        nu = self.noise.noise.degrees
        values = []
        scores = []
        information = np.zeros((len(phi), len(phi)))
        for rows in self.blocks:
            density, whiten, z, distance = self._density(
                *self._moments(member, epsilon, rows), rows
            )
            parts = self._parts(
                member, slopes, rows, whiten, z, self._noise_columns(epsilon, rows).whitened(whiten)
            )
            values.append(density)
            if nu is None:
                scores.append(parts.location + 0.5 * (parts.quadratic - parts.trace))
                information += parts.by_mean + parts.by_spread
                continue
            pull = ((nu + p) / (nu + distance))[
                :, None
            ]  # Lange, Little, Taylor (1989), section 3 and appendix B
            scores.append(pull * parts.location + 0.5 * (pull * parts.quadratic - parts.trace))
            information += (
                (nu + p) * (parts.by_mean + parts.by_spread) - 0.5 * parts.trace.T @ parts.trace
            ) / (nu + p + 2)
        return float(np.concatenate(values).sum()), np.concatenate(scores), information

    def _noise_columns(self, epsilon: Array, rows: slice) -> Columns:
        own = self.noise.slopes()
        p = len(epsilon)
        count = rows.stop - rows.start
        columns = [np.broadcast_to(np.eye(p), (count, p, p))]
        weights = [own]
        if self.starts is None:
            mean = np.empty((count, p, 0))
            by_mean = np.empty((len(own), 0))
        else:
            mean = 0.5 * self.starts.curvature[rows]
            by_mean = own
            columns += [self.starts.slope[rows], self.starts.curvature[rows]]
            weights += [own, own * epsilon]
        a = np.concatenate(columns, axis=2)
        return Columns(mean, by_mean, a, a, np.concatenate(weights, axis=1))


def trusted(family: Family, centre: Array, width: Array) -> list[Parameter]:
    """The family's unknowns, means kept within two widths of the centre and scales within two
    widths.
    """
    relative = width / centre if family.logarithmic else width
    bounds = {}
    for name, c, h, s in zip(family.space.names, centre, width, relative, strict=True):
        bounds[f"mean.{name}"] = (c - 2 * h, c + 2 * h)
        bounds[f"scale.{name}"] = (0.0, 2 * s)
    out = []
    for p in family.unknowns:
        low, high = bounds.get(p.name, (p.low, p.high))
        low = max(p.low, low)
        high = min(p.high, high)
        if not low < high:  # the whole trusted interval lies beyond a bound: stay on it
            low, high = (
                (p.low, p.low + 1e-9 * p.width)
                if high <= p.low
                else (p.high - 1e-9 * p.width, p.high)
            )
        out.append(
            Parameter(
                p.name, low, high, p.unit, lower=min(p.lower, low), upper=p.upper, scale=p.scale
            )
        )
    return out
