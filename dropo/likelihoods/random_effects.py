"""The Gaussian likelihood that integrates over a draw shared by all segments of a group."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import GroupedLogLikelihood, Groups, LocalLikelihood
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, is_tensor, namespace, plain
from dropo.core.numerics.kept_rows import row_blocks
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import along_starts
from dropo.likelihoods.support.gaussian_rows import trusted
from dropo.likelihoods.support.polynomials import Emulator, build, orders_for

OWN_PARTS = ("centre", "width", "coefficients", "residual")
"""What an emulator of a group's own replaces."""


@dataclass(frozen=True)
class ModeSettings:
    """How the modes of the groups are searched.

    Attributes
    ----------
    steps : int
        Gauss-Newton steps, at most.
    tolerance : float
        They end with a step shorter than this fraction of the width.
    span : float
        Modes stay within this multiple of the width around the centre.
    reach : float
        An emulator is sound within this multiple of its width: about as far as its design reaches.
    own_width : float
        The emulator of one group alone is at least as wide as so many standard deviations of the
        group's parameters.
    followed_move : float
        It is at least as wide as this fraction of the last move of its centre.
    minimum_own_width : float
        It is at least as wide as this fraction of the population's emulator, which is the widest
        that it may be.
    settled_move : float
        Where the mode is within this fraction of the last width of its centre, the next width is at
        most half of the last.
    """

    steps: int = 20
    tolerance: float = 1e-9
    span: float = 4.0
    reach: float = 2.5
    own_width: float = 2.0
    followed_move: float = 0.7
    minimum_own_width: float = 0.01
    settled_move: float = 0.5


@dataclass(frozen=True)
class RandomEffects(LocalLikelihood):
    """A Gaussian for each group of rows, which share one draw of the parameters, integrated out.

    Groups are the data's, else trajectories. The family enters by its mean and covariance.

    Attributes
    ----------
    order : int, optional
        One order for all polynomials; None: by the width.
    modes : ModeSettings

    Notes
    -----
    xi_g ~ N(mean, S) for each group g, and y_g | xi_g ~ N(f(xi_g), R + diag(epsilon)). f is the
    polynomial emulator of the emulated likelihood and R what it leaves, linear around each group's
    own mode [1]_; this is exact for a linear simulator. Groups for which the population's emulator
    is not sound can have one of their own (`with_own_models`). Noise of the start states adds
    D diag(epsilon) D' to its row, with D the slopes of f in them.

    References
    ----------
    .. [1] Lindstrom, Bates, "Nonlinear mixed effects models for repeated measures data",
       Biometrics 46 (1990).
    """

    order: int | None = None
    modes: ModeSettings = field(default_factory=ModeSettings)

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
        """Return the log-likelihood of populations with means near the centre (d,).

        Raises
        ------
        BadArgument
            If an epsilon is 0.
        Incompatible
            If the family is no Gaussian, or the noise has other parts than a likelihood of groups
            knows.
        SimulationFailed
            If too many simulations of the design diverge.
        """
        noise = _check_noise(family, epsilon, len(simulator.signals))
        orders = orders_for(width, simulator.space, self.order, rough)
        emulator = build(simulator, segments, centre, width, orders, rng)
        columns = [np.broadcast_to(np.eye(len(noise.shape)), emulator.residual.shape)]
        if noise.noise.start:
            columns.append(along_starts(simulator, segments, centre, noise).slope[:])
        return _RandomEffects(
            emulator,
            simulator,
            segments,
            family,
            noise,
            width,
            np.concatenate(columns, axis=2),
            orders,
            self.modes,
        )


def _check_noise(family: Family, epsilon: Epsilon, signals: int) -> NoiseModel:
    """The noise, or a refusal of what the integral over the groups' draws cannot have."""
    if family.logarithmic:
        raise Incompatible(
            f"{type(family).__name__} is no Gaussian, as random effects are. Use"
            " 'truncated_gaussian' or 'full'."
        )
    unknowns = family.unknowns.names
    others = [name for name in unknowns if not name.startswith(("mean.", "scale.", "partial."))]
    if others:
        raise Incompatible(
            f"{type(family).__name__} is no Gaussian, as this likelihood of groups is: it has"
            f" {', '.join(others)} too. Method 'random-effects' finds a 'mixture' by itself."
        )
    noise = NoiseModel(epsilon, signals).positive("RandomEffects")
    if noise.noise.rows is not None:
        raise Incompatible(
            "RandomEffects takes no filtered starts. Use starts='measured', or 'emulated'."
        )
    if noise.noise.degrees is not None:
        raise Incompatible(
            "RandomEffects knows no Student t: its integral is Gaussian. Leave degrees out, or use"
            " 'emulated'."
        )
    return noise


@dataclass(frozen=True, eq=False)
class _Integrals:
    """The rows and groups linear around the modes, with S the population's covariance.

    Attributes
    ----------
    rho : (R, p) array
        L^-1 r, with N = L L' the noise and r the residuals at the population's mean.
    jacobian : (R, p, d) array
        J = L^-1 slopes.
    whiten : (R, p, p) array
        L^-1.
    sum_of_groups : callable
        Adds up the rows of each group.
    precision : (G, d, d) array
        G = sum J'J.
    e : (G, d) array
        sum J'rho.
    factor : (G, d, d) array
        I + G S.
    inner : (G, d, d) array
        (I + G S)^-1.
    offset : (G, d) array
        S (I + G S)^-1 e, the groups' parameters less the mean.
    """

    rho: Array
    jacobian: Array
    whiten: Array
    sum_of_groups: Callable[[Array], Array]
    precision: Array
    e: Array
    factor: Array
    inner: Array
    offset: Array

    @property
    def values(self) -> Array:
        """(G,) log-likelihoods of the groups [nats]."""
        xp = namespace(self.rho)
        # The log-likelihood as if the parameters were the mean, and what the integral adds.
        log_noise = -xp.sum(xp.log(xp.linalg.diagonal(self.whiten)), axis=1)
        distance = self.rho.shape[1] * np.log(2 * np.pi) + xp.sum(self.rho**2, axis=1)
        at_mean = self.sum_of_groups(-0.5 * distance - log_noise)
        excess = xp.linalg.slogdet(self.factor)[1] - xp.sum(self.e * self.offset, axis=1)
        values: Array = at_mean - 0.5 * excess
        return values


class _RandomEffects(GroupedLogLikelihood):
    """The groups' log-likelihoods, with rows linear around the modes found anew for every phi.

    log p(y_g | phi) = sum_t log N(rho_t; 0, N_t) - (log|I + G S| - e' S (I + G S)^-1 e) / 2. The
    noise of a row is R + sum_k epsilon_k c_k c_k' with columns c (R, p, k), the p epsilons over and
    over.
    """

    has_gradients = True
    simulator: Simulator

    def __init__(
        self,
        emulator: Emulator,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        noise: NoiseModel,
        width: Array,
        columns: Array,
        orders: Ints,
        modes: ModeSettings,
    ):
        self.modes = modes
        self.orders = orders
        self.emulator = emulator
        self.simulator = simulator
        self.segments = segments
        self.family = family
        self.noise = noise
        self.columns = columns
        self.copies = columns.shape[2] // columns.shape[1]
        self.targets = simulator.targets(segments)
        # The group of each row, and the rows in the order of their groups.
        self.label, self.of_row = np.unique(segments.group[segments.rows[0]], return_inverse=True)
        self._order = np.argsort(self.of_row, kind="stable")
        self._in_order = bool((np.diff(self.of_row) >= 0).all())
        self._first = np.searchsorted(self.of_row[self._order], np.arange(len(self.label)))
        # The emulator of each group: at first the population's.
        everywhere = np.ones((len(self.label), 1))
        self.own = replace(
            emulator, centre=everywhere * emulator.centre, width=everywhere * emulator.width
        )
        row_bytes = 8 * len(emulator.indices) * (1 + len(emulator.centre))
        self.blocks = row_blocks(len(self.of_row), row_bytes)
        self.unknowns = ParameterSpace((*trusted(family, emulator.centre, width), *noise.unknowns))
        self._known = None if noise.unknowns else self._whitener(noise.epsilon(np.zeros(0)))

    def _rows(self, phi: Array) -> Array:
        return self._integrate(phi, self._modes(plain(phi))).values

    def gradient(self, phi: Any) -> Array:
        """Return d log L / d phi (m,)."""
        return self.value_score_information(np.asarray(phi, dtype=float))[1].sum(axis=0)

    def mean(self, phi: Array) -> Array:
        """Return the prediction (R, p) at each group's own mode, without noise."""
        return self._linear(self._modes(phi))[0]

    def epsilon(self, phi: Array) -> Array:
        """Return the noise variances (p,)."""
        return self.noise.epsilon(phi[len(self.family.unknowns) :])

    def predict(self, values: Array) -> Array:
        """Return the polynomials' predictions (K, R, p) at values (K, d)."""
        return self.emulator.predict(values)

    def groups(self, phi: Array) -> Groups:
        """Return the groups under the population that phi (m,) names."""
        modes = self._modes(phi)
        at = self._integrate(phi, modes)
        return Groups(self.label, np.bincount(self.of_row), modes, at.precision, at.e)

    def mode_errors(self, phi: Array) -> Array:
        """Return how far each group's mode is from the simulator's own, by a simulation there."""
        modes = self.simulator.space.feasible(self._modes(phi))
        values = np.zeros((1, int(self.label.max()) + 1, modes.shape[1]))
        values[0, self.label] = modes
        simulated = self.simulator.predict(values, self.segments)[0]
        at = self._integrate(phi, modes, simulated)
        step = self._population(phi)[0] + at.offset - modes
        errors: Array = np.max(np.abs(step) / self._sd(phi, at), axis=1)
        beyond = np.abs(modes - self.own.centre) > self.modes.reach * self.own.width
        return np.where(np.isnan(errors) | beyond.any(axis=1), np.inf, errors)

    def with_own_models(
        self, phi: Array, which: NDArray[np.bool_], rng: np.random.Generator
    ) -> "_RandomEffects":
        """Return the same likelihood with emulators around the modes of some groups."""
        modes = self._modes(phi)
        sd = self._sd(phi, self._integrate(phi, modes))
        widest = self.emulator.width
        move = np.abs(modes - self.own.centre)
        moving = move > self.modes.settled_move * self.own.width
        limit = np.where(moving, widest, np.minimum(self.own.width / 2, widest))
        wanted = np.maximum(self.modes.own_width * sd, self.modes.followed_move * move)
        width = np.maximum(np.minimum(wanted, limit), self.modes.minimum_own_width * widest)

        parts = {name: getattr(self.own, name).copy() for name in OWN_PARTS}
        of_segment = self.segments.group
        for g, seed in zip(np.flatnonzero(which), rng.spawn(int(which.sum())), strict=True):
            segments = self.segments.take(of_segment == self.label[g])
            try:
                own = build(self.simulator, segments, modes[g], width[g], self.orders, seed)
            except SimulationFailed:
                continue
            rows = self.of_row == g
            parts["centre"][g] = modes[g]
            parts["width"][g] = width[g]
            parts["coefficients"][:, rows] = own.coefficients
            parts["residual"][rows] = own.residual
        mended = copy(self)
        mended.own = replace(self.own, **parts)
        if self._known is not None:
            mended._known = mended._whitener(self.noise.epsilon(np.zeros(0)))
        return mended

    def _sd(self, phi: Array, at: _Integrals) -> Array:
        """Standard deviations (G, d) of the groups' parameters, given the population."""
        spread = self._population(phi)[1]
        variance = np.einsum("gdd->gd", spread @ at.inner)
        return np.asarray(np.sqrt(np.maximum(variance, np.finfo(float).tiny)))

    def _population(self, phi: Array) -> tuple[Array, Array]:
        """Mean (d,) and covariance (d, d)."""
        own = phi[: len(self.family.unknowns)]
        sd = self.family.sd(own)
        return self.family.mean(own), self.family.correlation(own) * sd[:, None] * sd

    def _linear(self, modes: Array) -> tuple[Array, Array]:
        """Predictions (R, p) and slopes (R, p, d) of every row at its group's mode (G, d)."""
        terms = self.own.basis_and_slopes(modes)  # (G, 1 + d, M)
        parts = []
        for rows in self.blocks:
            coefficients = self.own.coefficients[:, rows].swapaxes(0, 1)  # (r, M, p)
            parts.append(terms[self.of_row[rows]] @ coefficients)
        out = np.concatenate(parts)
        return out[:, 0], out[:, 1:].swapaxes(1, 2)

    def _whitener(self, epsilon: Array) -> Array:
        """L^-1 (R, p, p) of the noise N = L L' of every row."""
        xp = namespace(epsilon)
        columns = constant(self.columns, epsilon)
        weighted = columns * xp.concat([epsilon] * self.copies)
        residual = constant(self.own.residual, epsilon)
        noise = residual + weighted @ xp.matrix_transpose(columns)
        whiten: Array = xp.linalg.inv(xp.linalg.cholesky(noise))
        return whiten

    def _modes(self, phi: Array) -> Array:
        """(G, d) by Gauss-Newton from the population's mean, kept where the emulator is sound."""
        given = self._given(phi)
        mean = given[0]
        width = self.own.width
        low = self.own.centre - self.modes.span * width
        high = self.own.centre + self.modes.span * width
        # An emulator of a group's own is sound near its centre alone.
        modes = np.where(self.own.centre == self.emulator.centre, mean, self.own.centre)
        for _ in range(self.modes.steps):
            following = np.clip(mean + self._linearized(given, modes).offset, low, high)
            step = np.abs(following - modes)
            modes = following
            if (step <= self.modes.tolerance * width).all():
                break
        return modes

    def _integrate(self, phi: Array, modes: Array, simulated: Array | None = None) -> _Integrals:
        """The rows linear at given modes (G, d); arrays or tensors, as phi is.

        Simulated (R, p) are predictions there in the place of the emulators'.
        """
        return self._linearized(self._given(phi), modes, simulated)

    def _given(self, phi: Array) -> tuple[Array, Array, Array]:
        """Mean and covariance of the population, and L^-1 of every row, that phi (m,) names."""
        if self._known is None:
            whiten = self._whitener(self.epsilon(phi))
        else:
            whiten = constant(self._known, phi)
        return (*self._population(phi), whiten)

    def _linearized(
        self, given: tuple[Array, Array, Array], modes: Array, simulated: Array | None = None
    ) -> _Integrals:
        """As `_integrate`, from what phi names."""
        mean, spread, whiten = given
        xp = namespace(mean)

        # Whitened residuals at the population's mean, and slopes.
        predicted, slopes = (constant(part, mean) for part in self._linear(modes))
        if simulated is not None:
            predicted = simulated
        offsets = (constant(modes, mean) - mean)[self.of_row]
        away = xp.einsum("rpd,rd->rp", slopes, offsets)
        rho = xp.einsum("rpq,rq->rp", whiten, constant(self.targets, mean) - predicted + away)
        jacobian = whiten @ slopes

        # What the groups' rows say of their parameters.
        precision = self._sum(jacobian.swapaxes(1, 2) @ jacobian)
        e = self._sum(xp.einsum("rpd,rp->rd", jacobian, rho))
        factor = constant(np.eye(len(mean)), mean) + precision @ spread
        inner = xp.linalg.inv(factor)
        offset = xp.einsum("gef,gf->ge", inner, e) @ spread
        return _Integrals(rho, jacobian, whiten, self._sum, precision, e, factor, inner, offset)

    def _sum(self, rows: Array) -> Array:
        """The sum of the rows of each group (G, ...)."""
        if is_tensor(rows):
            xp = namespace(rows)
            zeros = xp.zeros((len(self.label), *rows.shape[1:]), dtype=rows.dtype)
            return zeros.index_add(0, xp.asarray(self.of_row), rows)
        ordered = rows if self._in_order else rows[self._order]
        total: Array = np.add.reduceat(ordered, self._first, axis=0)
        return total

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """Return the value, the scores of the groups (G, m) and the information (m, m)."""
        at = self._integrate(phi, self._modes(phi))
        spread = self._population(phi)[1]
        value = float(at.values.sum())

        # Of the family's unknowns, with M = (S + G^-1)^-1 and q = M (xi_hat - mean).
        q = np.einsum("gde,ge->gd", at.inner, at.e)
        matrix = at.inner @ at.precision
        by_mean, by_spread = self._population_slopes(phi)
        m_spread = np.einsum("gde,nef->ngdf", matrix, by_spread, optimize=True)
        m_mean = by_mean @ matrix.swapaxes(1, 2)  # (G, n, d)
        quadratic = np.einsum("gd,nde,ge->gn", q, by_spread, q, optimize=True)
        scores = q @ by_mean.T + 0.5 * (quadratic - np.einsum("ngdd->gn", m_spread))
        of_mean = np.einsum("gnd,kd->nk", m_mean, by_mean)
        of_spread = np.einsum("ngde,kged->nk", m_spread, m_spread, optimize=True)
        information = of_mean + 0.5 * of_spread
        if not self.noise.unknowns:
            return value, scores, information

        # Of the noise's unknowns, and of both together.
        noise_scores, of_noise, by_noise = self._noise_scores(at, spread)
        cross = 0.5 * np.einsum("nde,ked->nk", by_spread, by_noise)
        whole = np.block([[information, cross], [cross.T, of_noise]])
        return value, np.concatenate([scores, noise_scores], axis=1), whole

    def _population_slopes(self, phi: Array) -> tuple[Array, Array]:
        """d mean (n, d) and d S (n, d, d) by the family's unknowns, by central differences."""
        unknowns = self.family.unknowns
        own = phi[: len(unknowns)]
        size = np.maximum(np.abs(own), 1e-6 * (unknowns.high - unknowns.low))
        by_mean = []
        by_spread = []
        for step in 1e-6 * size * np.eye(len(own)):
            mean_above, spread_above = self._population(own + step)
            mean_below, spread_below = self._population(own - step)
            width = 2 * step.sum()
            by_mean.append((mean_above - mean_below) / width)
            by_spread.append((spread_above - spread_below) / width)
        return np.stack(by_mean), np.stack(by_spread)

    def _noise_scores(self, at: _Integrals, spread: Array) -> tuple[Array, Array, Array]:
        """Scores (G, n), information (n, n) and cross terms (n, d, d) of the noise's unknowns.

        The last are sum_g J' Sigma_g^-1 dN Sigma_g^-1 J. All are first found by the variance of
        each column c_k of the noise: with B = C' N^-1 C, A = C' N^-1 J, P_g = (S^-1 + G)^-1 and
        Q = A P_g A', C' Sigma_g^-1 C is B - Q within a row, so that products of B, Q and A' A are
        all that is needed.
        """
        posterior = spread @ at.inner
        shift = np.einsum("gde,ge->gd", posterior, at.e)[self.of_row]
        residual = at.rho - np.einsum("rpd,rd->rp", at.jacobian, shift)
        c = (at.whiten @ self.columns).swapaxes(1, 2)  # (R, k, p), whitened
        a = c @ at.jacobian
        b = c @ c.swapaxes(1, 2)
        q = a @ posterior[self.of_row] @ a.swapaxes(1, 2)

        square = (c @ residual[:, :, None])[:, :, 0] ** 2
        scores = self._sum(0.5 * (square - np.diagonal(b - q, axis1=1, axis2=2)))
        a_a = self._sum(a[:, :, :, None] * a[:, :, None, :])  # (G, k, d, d)
        a_a_p = np.einsum("gkde,gef->gkdf", a_a, posterior)
        within_rows = np.einsum("rkl,rkl->kl", b, b - 2 * q)
        between_rows = np.einsum("gkde,gled->kl", a_a_p, a_a_p, optimize=True)
        information = within_rows + between_rows
        cross = np.einsum("gde,gkef,ghf->kdh", at.inner, a_a, at.inner, optimize=True)

        slopes = np.tile(self.noise.slopes(), self.copies)
        by_unknown = np.einsum("nk,kde->nde", slopes, cross)
        return scores @ slopes.T, 0.5 * slopes @ information @ slopes.T, by_unknown
