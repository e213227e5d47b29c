"""The Gaussian likelihood that integrates over a draw shared by all segments of a group."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import GroupedLogLikelihood, Groups, LocalLikelihood
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, is_tensor, namespace, plain
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import along_starts
from dropo.likelihoods.support.blocks import row_blocks
from dropo.likelihoods.support.gaussian_rows import trusted
from dropo.likelihoods.support.polynomials import Emulator, build, orders_for

MODE_STEPS = 20  # Gauss-Newton steps to the groups' modes at most
AT_MODE = 1e-9  # of the width: a step so short ends them


@dataclass(frozen=True)
class RandomEffects(LocalLikelihood):
    """xi_g ~ N(mean, S) for each group g, y_g | xi_g ~ N(f(xi_g), R + diag(epsilon)), with xi_g
    integrated out.

    f is the polynomial emulator of the emulated likelihood and R what it leaves, linear around each
    group's own mode (Lindstrom and Bates 1990; exact for a linear simulator). Groups are the
    data's, else trajectories. The family enters by its mean and covariance. Noise of the start
    states adds D diag(epsilon) D' to its row, D the slopes of f in them.
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
    ) -> GroupedLogLikelihood:
        if family.logarithmic:
            raise Incompatible(
                f"{type(family).__name__} is no Gaussian, as random effects are. Use "
                "'truncated_gaussian' or 'full'."
            )
        noise = NoiseModel(epsilon, len(simulator.signals)).positive("RandomEffects")
        if noise.noise.rows is not None:
            raise Incompatible(
                "RandomEffects takes no filtered starts. Use starts='measured', or 'emulated'."
            )
        if noise.noise.degrees is not None:
            raise Incompatible(
                "RandomEffects knows no Student t: its integral is Gaussian. Leave degrees "
                "out, or use 'emulated'."
            )
        emulator = build(
            simulator,
            segments,
            centre,
            width,
            orders_for(width, simulator.space, self.order, rough),
            rng,
        )
        columns = [np.broadcast_to(np.eye(len(noise.shape)), emulator.residual.shape)]
        if noise.noise.start:
            columns.append(along_starts(simulator, segments, centre, noise).slope)
        return _RandomEffects(
            emulator, simulator, segments, family, noise, width, np.concatenate(columns, axis=2)
        )


@dataclass(frozen=True, eq=False)
class _Integrals:
    """Of the rows rho = L^-1 r (R, p), J = L^-1 slopes (R, p, d) and L^-1 (R, p, p), N = L L' the
    noise and r the residuals at the population's mean; of the groups their values (G,), G = sum
    J'J (G, d, d), e = sum J'rho (G, d), (I + G S)^-1, and S (I + G S)^-1 e (G, d), by which
    their parameters stand off the mean.
    """

    rho: Array
    jacobian: Array
    whiten: Array
    values: Array
    precision: Array
    e: Array
    inner: Array
    offset: Array


class _RandomEffects(GroupedLogLikelihood):
    """log p(y_g | phi) = sum_t log N(rho_t; 0, N_t) - (log|I + G S| - e' S (I + G S)^-1 e) / 2, for
    each group.

    All rows are linear around the modes of their groups, which are found anew for every phi.
    """

    has_gradients = True

    def __init__(
        self,
        emulator: Emulator,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        noise: NoiseModel,
        width: Array,
        columns: Array,
    ):
        """columns: (R, p, k) the noise of a row is R + sum_k epsilon_k c_k c_k', the p epsilons
        over and over.
        """
        self.emulator = emulator
        self.family = family
        self.noise = noise
        self.columns = columns
        self.copies = columns.shape[2] // columns.shape[1]
        self.targets = simulator.targets(segments)
        self.label, self.of_row = np.unique(segments.group[segments.rows[0]], return_inverse=True)
        self._order = np.argsort(self.of_row, kind="stable")
        self._first = np.searchsorted(self.of_row[self._order], np.arange(len(self.label)))
        self.blocks = row_blocks(
            len(self.of_row), 8 * len(emulator.indices) * (1 + len(emulator.centre))
        )
        self.unknowns = ParameterSpace((*trusted(family, emulator.centre, width), *noise.unknowns))
        self._known = None if noise.unknowns else self._whitener(noise.epsilon(np.zeros(0)))

    def _rows(self, phi: Array) -> Array:
        return self._integrate(phi, self._modes(plain(phi))).values

    def gradient(self, phi: Any) -> Array:
        return self.value_score_information(np.asarray(phi, dtype=float))[1].sum(axis=0)

    def mean(self, phi: Array) -> Array:
        """(R, p) the prediction at each group's own mode: what the population explains, the noise
        left out.
        """
        return self._linear(self._modes(phi))[0]

    def epsilon(self, phi: Array) -> Array:
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def predict(self, values: Array) -> Array:
        return self.emulator.predict(values)

    def groups(self, phi: Array) -> Groups:
        modes = self._modes(phi)
        return Groups(
            self.label, np.bincount(self.of_row), modes, self._integrate(phi, modes).precision
        )

    def _population(self, phi: Array) -> tuple[Array, Array]:
        own = phi[: len(self.family.unknowns)]
        sd = self.family.sd(own)
        return self.family.mean(own), self.family.correlation(own) * sd[:, None] * sd

    def _linear(self, modes: Array) -> tuple[Array, Array]:
        """Predictions (R, p) and slopes (R, p, d) of every row at its group's mode (G, d)."""
        terms = np.concatenate(
            [self.emulator.basis(modes)[:, None], self.emulator.slopes(modes).swapaxes(1, 2)],
            axis=1,
        )
        c = self.emulator.coefficients
        out = np.concatenate(
            [terms[self.of_row[rows]] @ c[:, rows].swapaxes(0, 1) for rows in self.blocks]
        )  # (R, 1 + d, M) (R, M, p)
        return out[:, 0], out[:, 1:].swapaxes(1, 2)

    def _whitener(self, epsilon: Array) -> Array:
        """L^-1 (R, p, p) of the noise N = L L' of every row."""
        xp = namespace(epsilon)
        columns = constant(self.columns, epsilon)
        noise = constant(self.emulator.residual, epsilon) + (
            columns * xp.concat([epsilon] * self.copies)
        ) @ xp.matrix_transpose(columns)
        whiten: Array = xp.linalg.inv(xp.linalg.cholesky(noise))
        return whiten

    def _modes(self, phi: Array) -> Array:
        """(G, d) by Gauss-Newton from the population's mean, kept where the emulator is to be
        trusted.
        """
        mean = self._population(phi)[0]
        reach = 4 * self.emulator.width
        modes = np.repeat(mean[None], len(self.label), axis=0)
        for _ in range(MODE_STEPS):
            following = mean + self._integrate(phi, modes).offset
            following = np.clip(
                following, self.emulator.centre - reach, self.emulator.centre + reach
            )
            step = np.abs(following - modes)
            modes = following
            if (step <= AT_MODE * self.emulator.width).all():
                break
        return modes

    def _integrate(self, phi: Array, modes: Array) -> _Integrals:
        """The rows linear at given modes (G, d); arrays or tensors, as phi is."""
        xp = namespace(phi)
        (mean, spread) = self._population(phi)
        whiten = (
            self._whitener(self.epsilon(phi)) if self._known is None else constant(self._known, phi)
        )
        predicted, slopes = (constant(part, phi) for part in self._linear(modes))
        away = xp.einsum("rpd,rd->rp", slopes, (constant(modes, phi) - mean)[self.of_row])
        rho = xp.einsum("rpq,rq->rp", whiten, constant(self.targets, phi) - predicted + away)
        jacobian = whiten @ slopes
        precision = self._sum(jacobian.swapaxes(1, 2) @ jacobian)
        e = self._sum(xp.einsum("rpd,rp->rd", jacobian, rho))
        factor = constant(np.eye(len(mean)), phi) + precision @ spread
        inner = xp.linalg.inv(factor)
        offset = xp.einsum("gef,gf->ge", inner, e) @ spread
        log_noise = -xp.sum(xp.log(xp.linalg.diagonal(whiten)), axis=1)
        alone = self._sum(
            -0.5 * (rho.shape[1] * np.log(2 * np.pi) + xp.sum(rho**2, axis=1)) - log_noise
        )
        values = alone - 0.5 * (xp.linalg.slogdet(factor)[1] - xp.sum(e * offset, axis=1))
        return _Integrals(rho, jacobian, whiten, values, precision, e, inner, offset)

    def _sum(self, rows: Array) -> Array:
        """The sum of the rows of each group (G, ...)."""
        if is_tensor(rows):
            xp = namespace(rows)
            return xp.zeros((len(self.label), *rows.shape[1:]), dtype=rows.dtype).index_add(
                0, xp.asarray(self.of_row), rows
            )
        total: Array = np.add.reduceat(rows[self._order], self._first, axis=0)
        return total

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        at = self._integrate(phi, self._modes(phi))
        (_, spread) = self._population(phi)
        # M = (S + G^-1)^-1, q = M (xi_hat - mean)
        q = np.einsum("gde,ge->gd", at.inner, at.e)
        matrix = at.inner @ at.precision
        by_mean, by_spread = self._population_slopes(phi)
        moved = np.einsum("gde,nef->ngdf", matrix, by_spread, optimize=True)
        pushed = by_mean @ matrix.swapaxes(1, 2)  # (G, n, d)
        quadratic = np.einsum("gd,nde,ge->gn", q, by_spread, q, optimize=True)
        scores = q @ by_mean.T + 0.5 * (quadratic - np.einsum("ngdd->gn", moved))
        information = np.einsum("gnd,kd->nk", pushed, by_mean) + 0.5 * np.einsum(
            "ngde,kged->nk", moved, moved, optimize=True
        )
        if not self.noise.unknowns:
            return float(at.values.sum()), scores, information
        own, of_noise, pulled = self._noise_scores(at, spread)
        cross = 0.5 * np.einsum("nde,ked->nk", by_spread, pulled)
        whole = np.block([[information, cross], [cross.T, of_noise]])
        return float(at.values.sum()), np.concatenate([scores, own], axis=1), whole

    def _population_slopes(self, phi: Array) -> tuple[Array, Array]:
        """D mean (n, d) and d S (n, d, d) by each of the family's unknowns, by central differences."""
        n = len(self.family.unknowns)
        step = (
            1e-6
            * np.maximum(
                np.abs(phi[:n]), 1e-6 * (self.family.unknowns.high - self.family.unknowns.low)
            )
            * np.eye(n)
        )
        sides = [
            (self._population(phi[:n] + s), self._population(phi[:n] - s), 2 * s.sum())
            for s in step
        ]
        means, spreads = zip(
            *(((up[0] - down[0]) / h, (up[1] - down[1]) / h) for up, down, h in sides), strict=True
        )
        return np.stack(means), np.stack(spreads)

    def _noise_scores(self, at: _Integrals, spread: Array) -> tuple[Array, Array, Array]:
        """Scores (G, n) and information (n, n) of the noise's unknowns, and sum_g J' Sigma_g^-1 dN
        Sigma_g^-1 J (n, d, d).

        First by the variance of each column c_k of the noise: with B = C' N^-1 C, A = C' N^-1 J,
        P_g = (S^-1 + G)^-1 and Q = A P_g A', C' Sigma_g^-1 C is B - Q within a row, so that
        products of B, Q and A' A are all that is needed.
        """
        posterior = spread @ at.inner
        left = at.rho - np.einsum(
            "rpd,rd->rp", at.jacobian, np.einsum("gde,ge->gd", posterior, at.e)[self.of_row]
        )
        c = (at.whiten @ self.columns).swapaxes(1, 2)  # (R, k, p), white
        a = c @ at.jacobian
        b = c @ c.swapaxes(1, 2)
        q = a @ posterior[self.of_row] @ a.swapaxes(1, 2)
        by_column = self._sum(
            0.5 * ((c @ left[:, :, None])[:, :, 0] ** 2 - np.diagonal(b - q, axis1=1, axis2=2))
        )
        inside = self._sum(a[:, :, :, None] * a[:, :, None, :])  # (G, k, d, d)
        held = np.einsum("gkde,gef->gkdf", inside, posterior)
        information = np.einsum("rkl,rkl->kl", b, b - 2 * q) + np.einsum(
            "gkde,gled->kl", held, held, optimize=True
        )
        pulled = np.einsum("gde,gkef,ghf->kdh", at.inner, inside, at.inner, optimize=True)
        slopes = np.tile(self.noise.slopes(), self.copies)
        return (
            by_column @ slopes.T,
            0.5 * slopes @ information @ slopes.T,
            np.einsum("nk,kde->nde", slopes, pulled),
        )
