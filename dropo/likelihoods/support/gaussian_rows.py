"""What likelihoods share whose rows are Gaussian given phi, or Student t.

Noise, blocks of rows, scores and Fisher information.
"""

import copy
from abc import abstractmethod
from dataclasses import dataclass, replace
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
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings, row_blocks
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import Axial, along_starts
from dropo.likelihoods.support.measured_states import start_noise


@dataclass(frozen=True, eq=False)
class MomentJacobian:
    """Slopes of the moments of r rows in m unknowns, as sums over columns.

    Attributes
    ----------
    mean : (r, p, k) array
        d mean / d theta_i = sum_k by_mean[i, k] mean_k.
    by_mean : (m, k) array
    a, b : (r, p, l) array
        d Sigma / d theta_i = sum_l by_spread[i, l] (a_l b_l' + b_l a_l') / 2. One object if they
        are equal.
    by_spread : (m, l) array
    """

    mean: Array
    by_mean: Array
    a: Array
    b: Array
    by_spread: Array

    def whitened(self, whiten: Array) -> "MomentJacobian":
        """Return the same in coordinates in which the rows' covariance Sigma = L L' is 1.

        Parameters
        ----------
        whiten : (r, p, p) array
            L^-1 of each row.

        Returns
        -------
        MomentJacobian
            With a and b one object where they were one.
        """
        a = whiten @ self.a
        b = a if self.b is self.a else whiten @ self.b
        return MomentJacobian(whiten @ self.mean, self.by_mean, a, b, self.by_spread)

    def beside(self, other: "MomentJacobian") -> "MomentJacobian":
        """Return the slopes in the unknowns of both.

        Parameters
        ----------
        other : MomentJacobian
            Slopes of the same r rows in m' other unknowns.

        Returns
        -------
        MomentJacobian
            In m + m' unknowns, those of the other behind.
        """
        a = np.concatenate([self.a, other.a], axis=2)
        equal = self.b is self.a and other.b is other.a
        b = a if equal else np.concatenate([self.b, other.b], axis=2)
        mean = np.concatenate([self.mean, other.mean], axis=2)
        by_mean = block_diag(self.by_mean, other.by_mean)
        by_spread = block_diag(self.by_spread, other.by_spread)
        return MomentJacobian(mean, by_mean, a, b, by_spread)

    def whole(self) -> tuple[Array, Array]:
        """Return the derivatives of mean and covariance.

        Returns
        -------
        of_mean : (m, r, p) array
        of_covariance : (m, r, p, p) array
            Where a and b are equal.
        """
        mean = np.einsum("rpk,ik->irp", self.mean, self.by_mean)
        weighted = self.a * self.by_spread[:, None, None]
        return mean, weighted @ self.a.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class Parts:
    """What scores and information are made of, for r rows and m unknowns.

    With z = L^-1 residual and V = L^-1 d Sigma L^-T.

    Attributes
    ----------
    location : (r, m) array
        z' L^-1 d mean.
    quadratic : (r, m) array
        z' V z.
    trace : (r, m) array
        tr V.
    by_mean : (m, m) array
        The sum over rows of d mean' Sigma^-1 d mean.
    by_spread : (m, m) array
        The sum over rows of tr(V V) / 2.
    """

    location: Array
    quadratic: Array
    trace: Array
    by_mean: Array
    by_spread: Array


def parts_of_columns(z: Array, columns: MomentJacobian) -> Parts:
    """Find the parts from whitened columns, without a matrix (p, p) for any unknown.

    Parameters
    ----------
    z : (r, p) array
        Whitened residuals.
    columns : MomentJacobian

    Returns
    -------
    Parts
    """
    a = columns.a
    b = columns.b
    a_a = a.swapaxes(1, 2) @ a
    if b is a:
        inner = 0.5 * np.einsum("rkl,rkl->kl", a_a, a_a)
    else:
        a_b = a.swapaxes(1, 2) @ b
        b_b = b.swapaxes(1, 2) @ b
        straight = np.einsum("rkl,rkl->kl", a_a, b_b)
        crossed = np.einsum("rkl,rlk->kl", a_b, a_b)
        inner = 0.25 * (straight + crossed)
    z_mean = (z[:, None] @ columns.mean)[:, 0]
    z_a = (z[:, None] @ a)[:, 0]
    z_b = (z[:, None] @ b)[:, 0]
    flat = columns.mean.reshape(-1, columns.mean.shape[2])
    return Parts(
        location=z_mean @ columns.by_mean.T,
        quadratic=(z_a * z_b) @ columns.by_spread.T,
        trace=np.einsum("rpk,rpk->rk", a, b) @ columns.by_spread.T,
        by_mean=columns.by_mean @ (flat.T @ flat) @ columns.by_mean.T,
        by_spread=columns.by_spread @ inner @ columns.by_spread.T,
    )


def parts_of_matrices(z: Array, by_mean: Array, by_spread: Array) -> Parts:
    """Find the parts from whitened slopes of the moments.

    Parameters
    ----------
    z : (r, p) array
        Whitened residuals.
    by_mean : (m, r, p) array
        L^-1 d mean.
    by_spread : (m, r, p, p) array
        L^-1 d Sigma L^-T.

    Returns
    -------
    Parts
    """
    m = len(by_mean)
    flat_mean = by_mean.reshape(m, -1)
    flat_spread = by_spread.reshape(m, -1)
    return Parts(
        location=np.einsum("rp,mrp->rm", z, by_mean),
        quadratic=np.einsum("mrpq,rp,rq->rm", by_spread, z, z, optimize=True),
        trace=np.einsum("mrpp->rm", by_spread),
        by_mean=flat_mean @ flat_mean.T,
        by_spread=0.5 * flat_spread @ flat_spread.T,
    )


@dataclass(frozen=True, eq=False)
class _Density:
    """Log densities (r,), L^-1 (r, p, p), z = L^-1 residual (r, p) and z'z (r,)."""

    log: Any
    whiten: Any
    z: Any
    distance: Any


class GaussianRows(LocalLogLikelihood):
    """y ~ N(mean, Sigma) row by row, or the Student t of that scale matrix.

    Sigma is the member's spread + noise. A plug-in writes what a member gives: `_member`,
    `_spread`, `_member_slopes` and `_parts`.

    Parameters
    ----------
    simulator : Simulator
    segments : Segments
        What is compared.
    family : Family
    epsilon : Epsilon
        The noise.
    centre, width : (d,) array
        The region in which the local model is sound, in the parameters' units.
    row_floats : int
        Numbers that `value_score_information` holds at once for a row.
    memory : MemorySettings
        How much the slopes in noisy start states may take, beyond which they are kept in files.

    Raises
    ------
    BadArgument
        If an epsilon is 0.
    Incompatible
        If the start states carry noise and have other coordinates than the signals.

    Notes
    -----
    Noise of the start states goes through f's slopes J and curvatures H in them: mean +
    H epsilon / 2, Sigma + J diag(epsilon) J' + H diag(epsilon^2) H' / 2.

    References
    ----------
    Lange, Little, Taylor, "Robust statistical modeling using the t distribution", Journal of the
    American Statistical Association 84 (1989), section 3 and appendix B: scores and information of
    the Student t.
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
        memory: MemorySettings = MEMORY,
    ):
        self.family = family
        self.targets = simulator.targets(segments)
        self.noise = NoiseModel(epsilon, len(simulator.signals)).positive(type(self).__name__)
        own = trusted(family, centre, width)
        self.unknowns = ParameterSpace((*own, *self.noise.unknowns))
        self.blocks = row_blocks(len(self.targets), 8 * row_floats)
        self.memory = memory
        self.starts: Axial | None = None
        if self.noise.noise.start:
            self.starts = along_starts(simulator, segments, centre, self.noise, memory=memory)

    # --- what a plug-in writes

    @abstractmethod
    def _member(self, own: Any) -> Any:
        """What the family's unknowns (n,), array or tensor, mean for all rows.

        It is made once for all blocks.
        """

    @abstractmethod
    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        """Mean (r, p) and covariance (r, p, p) of a block without noise, arrays or tensors."""

    @abstractmethod
    def _member_slopes(self, own: Array) -> Any:
        """The slopes of the member in the family's unknowns, made once for all blocks."""

    @abstractmethod
    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: MomentJacobian
    ) -> Parts:
        """The parts of the family's n unknowns, then of those of the noise (whitened columns)."""

    # --- the moments of the measurements

    def _own(self, phi: Any) -> Any:
        """The family's unknowns (n,) of phi."""
        return phi[: len(self.family.unknowns)]

    def epsilon(self, phi: Array) -> Array:
        """Return the noise variances (p,)."""
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def moments(self, phi: Array) -> tuple[Array, Array]:
        """Find the moments of the measurements.

        Parameters
        ----------
        phi : (m,) array

        Returns
        -------
        mean : (R, p) array
        sigma : (R, p, p) array
        """
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        means = []
        sigmas = []
        for rows in self.blocks:
            mean, sigma = self._moments(member, epsilon, rows)
            means.append(mean)
            sigmas.append(sigma)
        return np.concatenate(means), np.concatenate(sigmas)

    def mean(self, phi: Array) -> Array:
        """Return the mean of the measurements (R, p) under phi."""
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        means = [self._moments(member, epsilon, rows)[0] for rows in self.blocks]
        return np.concatenate(means)

    def whitened_residuals(self, phi: Array) -> Array:
        """Return L^-1 (measured - mean), with the rows' covariance Sigma = L L'.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        (R, p) array
            Independent standard normal numbers, if the model is right.
        """
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        out = np.empty_like(self.targets)
        for rows in self.blocks:
            mean, sigma = self._moments(member, epsilon, rows)
            root = self._root(sigma, rows)
            out[rows] = np.linalg.solve(root, (self.targets[rows] - mean)[:, :, None])[:, :, 0]
        return out

    def weighed(self, phi: Array, rows: Ints, values: Array) -> Array:
        """Return L^-1 values (r, p, k), with Sigma = L L', less where a Student t's tail is."""
        mean, sigma = (moment[rows] for moment in self.moments(phi))
        residual = (self.targets[rows] - mean)[:, :, None]
        columns = np.linalg.solve(np.linalg.cholesky(sigma), np.concatenate([values, residual], 2))
        weighed: Array = columns[:, :, :-1]
        weight = self._weight(np.sum(columns[:, :, -1] ** 2, axis=1))
        return weighed * np.sqrt(weight)[:, None, None]

    def _moments(self, member: Any, epsilon: Any, rows: slice) -> tuple[Any, Any]:
        """Mean (r, p) and Sigma (r, p, p) of a block with noise."""
        mean, sigma = self._spread(member, rows)
        xp = namespace(mean, epsilon)
        epsilon = constant(epsilon, mean)
        sigma = sigma + constant(np.eye(len(self.noise.shape)), mean) * epsilon
        if self.noise.noise.rows is not None:
            sigma = sigma + constant(self.noise.noise.rows[rows], mean)
        if self.starts is None:
            return mean, sigma
        slope = constant(self.starts.slope[rows], mean)
        curvature = constant(self.starts.curvature[rows], mean)
        by_slope = (slope * epsilon) @ xp.matrix_transpose(slope)
        by_curvature = 0.5 * (curvature * epsilon**2) @ xp.matrix_transpose(curvature)
        return mean + 0.5 * curvature @ epsilon, sigma + by_slope + by_curvature

    # --- densities

    def _rows(self, phi: Array) -> Array:
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        out = []
        for rows in self.blocks:
            mean, sigma = self._moments(member, epsilon, rows)
            out.append(self._density(mean, sigma, rows).log)
        return namespace(*out).concat(out)

    def _density(self, mean: Any, sigma: Any, rows: slice) -> _Density:
        """The densities of a block's targets."""
        xp = namespace(sigma)
        p = sigma.shape[-1]
        nu = self.noise.noise.degrees
        whiten = xp.linalg.inv(self._root(sigma, rows))
        z = (whiten @ (constant(self.targets[rows], mean) - mean)[:, :, None])[:, :, 0]
        distance = xp.sum(z**2, axis=1)
        log_root = -xp.sum(xp.log(xp.linalg.diagonal(whiten)), axis=1)
        if nu is None:
            log = -0.5 * (p * np.log(2 * np.pi) + distance) - log_root
        else:
            peak = float(gammaln((nu + p) / 2) - gammaln(nu / 2)) - 0.5 * p * np.log(np.pi * nu)
            log = peak - log_root - 0.5 * (nu + p) * xp.log1p(distance / nu)
        return _Density(log, whiten, z, distance)

    def _root(self, sigma: Any, rows: slice) -> Any:
        """The lower factors of a block's Sigma; BadArgument where one is not positive definite.

        A pivot that is nothing but rounding counts as none: whether it comes out just above or
        below zero depends on the processor.
        """
        xp = namespace(sigma)
        try:
            root = xp.linalg.cholesky(sigma)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            if is_tensor(sigma) and "cholesky" not in str(error):
                raise
        else:
            pivots = plain(xp.linalg.diagonal(root)) ** 2
            rounding = sigma.shape[-1] * np.finfo(float).eps
            if not (pivots <= rounding * plain(xp.linalg.diagonal(sigma))).any():
                return root
        lowest = np.linalg.eigvalsh(plain(sigma))[:, 0]
        row = int(lowest.argmin())
        largest = np.abs(plain(sigma)[row]).max()
        raise BadArgument(
            f"The covariance of row {rows.start + row} is not positive definite: its least"
            f" eigenvalue is {lowest[row]:.3g}, its largest entry {largest:.3g}. Give a larger"
            " epsilon, or narrower bounds of the scales."
        )

    # --- scores and information

    def gradient(self, phi: ArrayLike) -> Array:
        """Return d log L / d phi (m,)."""
        return self.value_score_information(np.asarray(phi, dtype=float))[1].sum(axis=0)

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """Return the value, the scores of the rows (R, m) and the Fisher information (m, m)."""
        own = self._own(phi)
        epsilon = self.epsilon(phi)
        p = self.targets.shape[1]
        member = self._member(own)
        slopes = self._member_slopes(own)
        nu = self.noise.noise.degrees
        values = np.empty(len(self.targets))
        scores = np.empty((len(self.targets), len(phi)))
        information = np.zeros((len(phi), len(phi)))
        for rows in self.blocks:
            mean, sigma = self._moments(member, epsilon, rows)
            density = self._density(mean, sigma, rows)
            values[rows] = density.log
            noise = self._noise_columns(epsilon, rows).whitened(density.whiten)
            parts = self._parts(member, slopes, rows, density.whiten, density.z, noise)
            if nu is None:
                scores[rows] = parts.location + 0.5 * (parts.quadratic - parts.trace)
                information += parts.by_mean + parts.by_spread
            else:
                weight = self._weight(density.distance)[:, None]
                pulled = 0.5 * (weight * parts.quadratic - parts.trace)
                scores[rows] = weight * parts.location + pulled
                traces = 0.5 * parts.trace.T @ parts.trace
                gaussian = (nu + p) * (parts.by_mean + parts.by_spread)
                information += (gaussian - traces) / (nu + p + 2)
        return float(values.sum()), scores, information

    def scores_of_noisy_starts(
        self, phi: Array, simulator: Simulator, segments: Segments, step: Array
    ) -> Array | None:
        """Return half the slopes of log det Sigma in the parameters (R, d), by those of the starts'
        slopes J, which the likelihood holds fixed; None where starts carry no noise.

        With noise e on a start, E[(df/dx_j)' Sigma^-1 (y - f)] = -tr(Sigma^-1 J E[e e'] dJ'/dx_j)
        (Fuller, "Measurement Error Models", 1987, section 3.2).
        """
        if self.starts is None:
            return None
        mean = self.family.mean(self._own(phi))
        out = np.empty((len(self.targets), len(mean)))
        for j, moved in enumerate(np.diag(step)):
            above = self._log_determinants(phi, simulator, segments, mean + moved)
            below = self._log_determinants(phi, simulator, segments, mean - moved)
            out[:, j] = (above - below) / (4 * step[j])
        return out

    def _log_determinants(
        self, phi: Array, simulator: Simulator, segments: Segments, value: Array
    ) -> Array:
        """(R,) log det Sigma with the starts' slopes at other parameters (d,)."""
        there = copy.copy(self)
        there.starts = along_starts(simulator, segments, value, self.noise, memory=self.memory)
        member = self._member(self._own(phi))
        epsilon = self.epsilon(phi)
        of_blocks = [np.linalg.slogdet(there._moments(member, epsilon, b)[1]) for b in self.blocks]
        return np.concatenate([found.logabsdet for found in of_blocks])

    def scores_of_states(self, phi: Array, scores: Array, segments: Segments) -> Array:
        """Return scores (R, m) in which each measured state's noise is in the row that ends there,
        instead of in the next one, too.
        """
        if self.starts is None:
            return scores
        epsilon = self.epsilon(phi)
        own = self._own(phi)
        mean = self.mean(phi)
        found = start_noise(self.targets - mean, self.starts.slope, epsilon, segments)
        if found is None:
            return scores
        member = self._member(own)
        slopes = self._member_slopes(own)
        of_starts = np.empty_like(scores)
        for rows in self.blocks:
            density = self._density(*self._moments(member, epsilon, rows), rows)
            moved = -self.starts.slope[rows] @ found.noise[rows][:, :, None]
            z = (density.whiten @ moved)[:, :, 0]
            noise = self._noise_columns(epsilon, rows).whitened(density.whiten)
            location = self._parts(member, slopes, rows, density.whiten, z, noise).location
            of_starts[rows] = self._weight(density.distance)[:, None] * location
        of_starts[found.before < 0] = 0.0
        out = scores - of_starts
        goes_on = found.before >= 0
        np.add.at(out, found.before[goes_on], of_starts[goes_on])
        return out

    def _weight(self, distance: Array) -> Array:
        """Weights (r,) of rows, which fall with their distances under a Student t."""
        nu = self.noise.noise.degrees
        if nu is None:
            return np.ones(len(distance))
        p = self.targets.shape[1]
        weight: Array = (nu + p) / (nu + distance)
        return weight

    def curvature_factor(self, phi: Array) -> float:
        """Return the mean curvature of the rows' log-density in their location, over its
        expectation: tails are seldom those of a Student t to the letter.
        """
        nu = self.noise.noise.degrees
        if nu is None:
            return 1.0
        p = self.targets.shape[1]
        mean, sigma = self.moments(phi)
        residual = (self.targets - mean)[:, :, None]
        distance = (residual.swapaxes(1, 2) @ np.linalg.solve(sigma, residual))[:, 0, 0]
        weight = self._weight(distance)
        bent = weight * (1 - 2 / p * distance / (nu + distance))
        return float(np.mean(bent)) / ((nu + p) / (nu + p + 2))

    def _noise_columns(self, epsilon: Array, rows: slice) -> MomentJacobian:
        """The slopes of a block's moments in the unknowns of the noise."""
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
        return MomentJacobian(mean, by_mean, a, a, np.concatenate(weights, axis=1))


def trusted(family: Family, centre: Array, width: Array) -> list[Parameter]:
    """Bound a family's unknowns by the region in which a local model is sound.

    Parameters
    ----------
    family : Family
    centre, width : (d,) array
        In the parameters' units.

    Returns
    -------
    list of Parameter
        Means within two widths of the centre, scales up to two widths, the rest as they are.
    """
    relative = width / centre if family.logarithmic else width
    bounds = {}
    for name, c, w, s in zip(family.space.names, centre, width, relative, strict=True):
        bounds[f"mean.{name}"] = (c - 2 * w, c + 2 * w)
        bounds[f"scale.{name}"] = (0.0, 2 * s)
    out = []
    for unknown in family.unknowns:
        low, high = bounds.get(unknown.name, (unknown.low, unknown.high))
        low = max(unknown.low, low)
        high = min(unknown.high, high)
        if not low < high:
            # The whole trusted interval lies beyond a bound: stay on it.
            small = 1e-9 * unknown.width
            if high <= unknown.low:
                low = unknown.low
                high = unknown.low + small
            else:
                low = unknown.high - small
                high = unknown.high
        lower = min(unknown.lower, low)
        out.append(replace(unknown, low=low, high=high, lower=lower))
    return out
