"""The Gaussian likelihood that integrates over a draw shared by all segments of a group."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.checks import Array
from dropo.core.data import Segments
from dropo.core.errors import Incompatible
from dropo.core.family import Family
from dropo.core.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.noise import Epsilon, NoiseModel
from dropo.core.parameters import ParameterSpace
from dropo.core.simulator import Simulator
from dropo.likelihoods.emulated import trusted
from dropo.likelihoods.polynomials import Emulator, build, orders_for

MODE_STEPS = 3  # Gauss-Newton steps to the groups' modes, each time from the last ones


@dataclass(frozen=True)
class RandomEffects(LocalLikelihood):
    """xi_g ~ N(mean, S) for each group g, y_g | xi_g ~ N(f(xi_g), R + diag(epsilon)), with xi_g integrated out.

    f is the polynomial emulator of the emulated likelihood, linear around each group's own mode (Lindstrom and Bates 1990;
    exact for a linear simulator). Groups are the data's, else trajectories. The family enters by its mean and covariance.
    """

    order: int | None = None

    def around(
        self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, centre: Array, width: Array,
        rng: np.random.Generator, *, rough: bool = False,
    ) -> LocalLogLikelihood:  # fmt: skip
        if family.logarithmic:
            raise Incompatible(f"{type(family).__name__} is no Gaussian, as random effects are. Use 'truncated_gaussian' or 'full'.")
        emulator = build(simulator, segments, centre, width, orders_for(width, simulator.space, self.order, rough), rng)
        return GroupedLogLikelihood(emulator, simulator, segments, family, epsilon, width)


class GroupedLogLikelihood(LocalLogLikelihood):
    """log p(y_g | phi) = sum_t log N(rho_t; 0, N_t) - (log|I + G S| - e' S (I + G S)^-1 e) / 2, for each group.

    rho: residuals of the linear model at the population's mean; N_t = R_t + diag(epsilon); G = sum J' N^-1 J (d, d);
    e = sum J' N^-1 rho. `rows` are the G groups.
    """

    def __init__(self, emulator: Emulator, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, width: Array):
        self.emulator, self.family = emulator, family
        self.targets = simulator.targets(segments)
        self.groups, self.of_row = np.unique(segments.group[segments.rows[0]], return_inverse=True)
        self.noise = NoiseModel(epsilon, len(simulator.signals)).positive("RandomEffects")
        self.unknowns = ParameterSpace((*trusted(family, emulator.centre, width), *self.noise.unknowns))
        self.modes = np.repeat(emulator.centre[None], len(self.groups), axis=0)  # (G, d)

    def _rows(self, phi: Array) -> Array:
        return self._integrate(phi)[0]

    def mean(self, phi: Array) -> Array:
        """(R, p) the prediction at each group's own mode: what the population explains, the noise left out."""
        self._integrate(phi)
        return self._linear()[0]

    def epsilon(self, phi: Array) -> Array:
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def predict(self, values: Array) -> Array:
        return self.emulator.predict(values)

    def group_estimates(self, phi: Array) -> tuple[Array, Array]:
        """Each group's mode (G, d) and posterior covariance (G, d, d)."""
        _, precision, _, spread, _ = self._integrate(phi)
        return self.modes, spread @ np.linalg.inv(np.eye(spread.shape[0]) + precision @ spread)

    def _population(self, phi: Array) -> tuple[Array, Array]:
        own = phi[: len(self.family.unknowns)]
        sd = self.family.sd(own)
        return self.family.mean(own), self.family.correlation(own) * np.outer(sd, sd)

    def _linear(self) -> tuple[Array, Array]:
        """Predictions (R, p) and slopes (R, p, d) of every row at its group's mode."""
        basis, slopes = self.emulator.basis(self.modes), self.emulator.slopes(self.modes)
        coefficients = self.emulator.coefficients
        predicted = np.einsum("rm,mrp->rp", basis[self.of_row], coefficients, optimize=True)
        return predicted, np.einsum("rmd,mrp->rpd", slopes[self.of_row], coefficients, optimize=True)

    def _integrate(self, phi: Array) -> tuple[Array, Array, Array, Array, tuple[Array, ...]]:
        """Values (G,), G (G, d, d), e (G, d), S (d, d), and (whitened rho, whitened J, whitener) of the rows, at the modes."""
        mean, spread = self._population(phi)
        noise = self.emulator.residual + np.diag(self.epsilon(phi))
        whiten = np.linalg.inv(np.linalg.cholesky(noise))  # (R, p, p)
        for step in range(MODE_STEPS + 1):
            predicted, slopes = self._linear()
            jacobian = whiten @ slopes
            away = np.einsum("rpd,rd->rp", slopes, (self.modes - mean)[self.of_row])
            rho = np.einsum("rpq,rq->rp", whiten, self.targets - predicted + away)
            precision = self._sum(jacobian.swapaxes(1, 2) @ jacobian)
            e = self._sum(np.einsum("rpd,rp->rd", jacobian, rho))
            inner = np.eye(len(mean)) + precision @ spread
            offset = np.einsum("de,gef,gf->gd", spread, np.linalg.inv(inner), e)
            if step < MODE_STEPS:
                self.modes = self._trusted(mean + offset)
        log_noise = -np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum(axis=1)
        alone = self._sum(-0.5 * (rho.shape[1] * np.log(2 * np.pi) + (rho**2).sum(axis=1)) - log_noise)
        values = alone - 0.5 * (np.linalg.slogdet(inner)[1] - np.einsum("gd,gd->g", e, offset))
        return values, precision, e, spread, (rho, jacobian, whiten)

    def _sum(self, rows: Array) -> Array:
        out = np.zeros((len(self.groups), *rows.shape[1:]))
        np.add.at(out, self.of_row, rows)
        return out

    def _trusted(self, modes: Array) -> Array:
        return np.clip(modes, self.emulator.centre - 4 * self.emulator.width, self.emulator.centre + 4 * self.emulator.width)

    def expand(self, phi: Array) -> tuple[float, Array, Array]:
        values, precision, e, spread, (rho, jacobian, whiten) = self._integrate(phi)
        inner = np.linalg.inv(np.eye(len(spread)) + precision @ spread)  # (I + G S)^-1
        q, matrix = np.einsum("gde,ge->gd", inner, e), inner @ precision  # q = M (xi_hat - mean), M = (S + G^-1)^-1
        scores, halves = [], []
        for by_mean, by_spread in zip(*self._population_slopes(phi), strict=True):
            moved = matrix @ by_spread
            scores.append(q @ by_mean + 0.5 * (np.einsum("gd,de,ge->g", q, by_spread, q) - np.einsum("gdd->g", moved)))
            halves.append((np.einsum("gde,e->gd", matrix, by_mean), by_mean, moved))
        n, own = len(halves), self.noise.slopes()
        information = np.zeros((n + len(own), n + len(own)))
        for i, (mean_i, _, moved_i) in enumerate(halves):
            for j, (_, by_mean_j, moved_j) in enumerate(halves):
                information[i, j] = np.sum(mean_i @ by_mean_j) + 0.5 * np.einsum("gde,ged->", moved_i, moved_j)
        if len(own):
            by_noise, information[n:, n:] = self._noise_scores(own, rho, jacobian, whiten, inner, e, spread)
            scores += list(by_noise)
        return float(values.sum()), np.stack(scores, axis=1), information

    def _population_slopes(self, phi: Array) -> tuple[list[Array], list[Array]]:
        """d mean (d,) and d S (d, d) for each of the family's unknowns, by central differences."""
        n = len(self.family.unknowns)
        step = 1e-6 * np.maximum(np.abs(phi[:n]), 1e-6 * (self.family.unknowns.high - self.family.unknowns.low)) * np.eye(n)
        sides = [(self._population(phi[:n] + s), self._population(phi[:n] - s), 2 * s.sum()) for s in step]
        return [(up[0] - down[0]) / h for up, down, h in sides], [(up[1] - down[1]) / h for up, down, h in sides]

    def _noise_scores(
        self, own: Array, rho: Array, jacobian: Array, whiten: Array, inner: NDArray[np.floating[Any]], e: Array, spread: Array
    ) -> tuple[list[Array], Array]:
        """Scores (G,) of each noise unknown, and their information with the draws taken as known."""
        posterior = np.einsum("de,gef->gdf", spread, inner)  # (S^-1 + G)^-1
        left = rho - np.einsum("rpd,rd->rp", jacobian, np.einsum("gde,ge->gd", posterior, e)[self.of_row])
        explained = jacobian @ posterior[self.of_row] @ jacobian.swapaxes(1, 2)
        scores, moved = [], []
        for slope in own:
            white = whiten * slope @ whiten.swapaxes(1, 2)
            quadratic = np.einsum("rp,rpq,rq->r", left, white, left)
            scores.append(self._sum(0.5 * (quadratic - np.einsum("rpp->r", white) + np.einsum("rpq,rqp->r", white, explained))))
            moved.append(white.ravel())
        flat = np.stack(moved)
        return scores, 0.5 * flat @ flat.T
