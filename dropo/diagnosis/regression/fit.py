"""How large the terms are that the equation of motion lacks: all of them fitted together.

The drives' forces T, with a gain of 1 + g, are what the motion needs by the model, L, and by what
it lacks, the sum of size times column. Divided by the gain,

    T = beta (L + sum_k size_k X_k),    beta = 1 / (1 + g),

so that the command, the only number without noise, stands on the left with a coefficient of one.
Otherwise everything could shrink towards nothing together. A joint without a drive has no such
number: its rows, -L = sum_k size_k X_k, stay apart from beta, which would else be worth least where
it is nearly 0.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dropo.core.numerics.bounded_quadratic import bounded_minimum
from dropo.core.numerics.closing_grid import SETTINGS as GRID
from dropo.core.numerics.closing_grid import ClosingGridSettings, best_place
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import Equation, own_delay
from dropo.diagnosis.regression.terms import OWN_GAIN, Term, point_mass_slope
from dropo.mjmodel.dynamics.body_regressors import point_mass

GAIN = -1
"""The index that stands for the gain of all drives among the indices of terms."""
LEAST_BETA = 1e-3


@dataclass(frozen=True)
class FitSettings:
    """How the numbers are fitted.

    Attributes
    ----------
    weight_floor : float
        No row counts more than if its error were this fraction of its joint's force.
    huber : float
        Number of standard deviations from which an error counts linearly.
    weightings : int
        Number of times that rows are weighted anew in a linear solve.
    steps : int
        Number of Gauss-Newton steps when all numbers are fitted together.
    halvings : int
        How often a step is tried, half as long each time, that leaves more than before.
    converged : float
        A step that promises to explain less than this fraction of what is left is not taken.
    places : ClosingGridSettings
        Where a payload is tried.
    misfit : float
        Fraction of what is left, as variance, that may lie along any one number.
    """

    weight_floor: float = 0.003
    huber: float = 2.5
    weightings: int = 3
    steps: int = 10
    halvings: int = 5
    converged: float = 1e-8
    places: ClosingGridSettings = GRID
    misfit: float = 0.01


SETTINGS = FitSettings()


@dataclass(frozen=True, eq=False)
class Payload:
    """A point mass on a body.

    Attributes
    ----------
    body : int
        Its place among the moving bodies.
    mass : float
        [kg].
    place : (3,) array
        In the body's frame [m].
    """

    body: int
    mass: float
    place: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """The numbers that the equation of motion lacks.

    Attributes
    ----------
    chosen : tuple of int
        The terms that are there; GAIN for the gain of the drives.
    sizes : (K,) array
        Of all K terms; 0 where one is not there.
    gain : float
        What is added to the gain of all drives, as a fraction of it.
    delay : float
        Of the commands [s].
    payload : Payload or None
        A mass that is added to a body.
    weights : (R, nv) array
        Square roots of the weights of the rows, 0 where a row does not count.
    spread : (nv,) array
        Robust standard deviation of what is left [N, N m].
    """

    chosen: tuple[int, ...]
    sizes: Array
    gain: float
    delay: float
    payload: Payload | None
    weights: Array
    spread: Array

    @property
    def beta(self) -> float:
        """One over the factor on the drives' forces."""
        return 1.0 / (1.0 + self.gain)

    @property
    def terms(self) -> list[int]:
        """The chosen terms but for the gain, in the order of the fitted numbers."""
        return [i for i in self.chosen if i != GAIN]


@dataclass(eq=False)
class Fitter:
    """Fits numbers to an equation of motion.

    Attributes
    ----------
    equation : Equation
        The equation, R rows of nv degrees of freedom.
    terms : sequence of Term
        The K terms that may be missing.
    reaches : sequence of float
        How far a payload may be from the origin of each moving body [m].
    heaviest : float
        What a payload weighs at most [kg]: one that outweighs the machine is a wrong gain.
    settings : FitSettings
        How.
    along_tendons : bool
        Whether laws are along the tendons by which drives move joints, or at the joints.
    """

    equation: Equation
    terms: Sequence[Term]
    reaches: Sequence[float]
    heaviest: float = np.inf
    settings: FitSettings = SETTINGS
    along_tendons: bool = True
    columns: Array = field(init=False)
    _drives: CubicSpline = field(init=False)

    def __post_init__(self) -> None:
        shape = (*self.equation.needed.shape, 0)
        columns = [term.column for term in self.terms]
        self.columns = np.stack(columns, axis=2) if columns else np.zeros(shape)
        self._drives = CubicSpline(self.equation.delays, self.equation.drives, axis=0)

    @cached_property
    def places(self) -> NDArray[np.bool_]:
        """(K, nv) where each term has a force."""
        return np.any(self.columns != 0, axis=0).T

    def drives(self, delay: float) -> Array:
        """Interpolate the drives' forces at a delay of the commands.

        Parameters
        ----------
        delay : float
            The delay [s].

        Returns
        -------
        (R, nv) array
            Forces [N, N m].
        """
        return np.asarray(self._drives(delay))

    def columns_at(self, delay: float, terms: Sequence[int], order: int = 0) -> Array:
        """Give the columns of terms at a delay of the commands: a drive's own gain depends on it.

        Parameters
        ----------
        delay : float
            The delay [s].
        terms : sequence of int
            Indices of K terms.
        order : int
            0 for the columns, 1 for their derivatives by the delay.

        Returns
        -------
        (R, nv, K) array
            A copy.
        """
        chosen = list(terms)
        found = self.columns[:, :, chosen] if order == 0 else self.columns[:, :, chosen] * 0.0
        gains = [k for k, i in enumerate(chosen) if self.terms[i].family == OWN_GAIN]
        if gains:
            drives = np.asarray(self._drives(delay, order))
        for k in gains:
            found[:, :, k] = np.where(self.places[chosen[k]], -drives, 0.0)
        return found

    def forces(self, delay: float) -> Array:
        """Give the drives' forces, or where there is no drive those that act there.

        Without a drive, what the motion needs is next to nothing where the model is right: the
        force that speeds the joint up counts then, which gravity or another joint gives.

        Parameters
        ----------
        delay : float
            Of the commands [s].

        Returns
        -------
        (R, nv) array
            Forces [N, N m]; NaN where a row does not count.
        """
        equation = self.equation
        passive = np.maximum(
            np.abs(equation.needed), np.abs(equation.inertia * equation.acceleration)
        )
        there = np.where(equation.driven, self.drives(delay), passive)
        return np.where(equation.used, there, np.nan)

    @property
    def own_delay(self) -> float:
        """The delay that the model's simulation has: it acts half a physics step early."""
        return own_delay(self.equation.delays)

    def start(self, chosen: tuple[int, ...]) -> Solution:
        """Begin with a model that lacks nothing; rows count by the force of their joint.

        Parameters
        ----------
        chosen : tuple of int
            Indices of the terms that are there, with a size of 0; `GAIN` for the gain of the
            drives.

        Returns
        -------
        Solution
            Without payload, at the delay of the model's own simulation.
        """
        spread = np.nan_to_num(root_mean_square(self.forces(self.own_delay)))
        spread = np.where(spread > 0, spread, np.inf)
        weights = np.where(self.equation.used, 1.0 / spread, 0.0)
        sizes = np.zeros(len(self.terms))
        return Solution(chosen, sizes, 0.0, self.own_delay, None, weights, spread)

    def payload_column(self, payload: Payload) -> Array:
        """Compute the force that 1 kg at the payload's place needs.

        Parameters
        ----------
        payload : Payload
            Its body and place; its mass is not used.

        Returns
        -------
        (R, nv) array
            Forces [N, N m].
        """
        return np.asarray(self.equation.by_inertia[payload.body] @ point_mass(payload.place))

    # ---- linear in everything but the delay and the payload's place

    def factors(self, solution: Solution) -> Array:
        """Give the factor on the model's forces, and on those that are missing, at each joint.

        Parameters
        ----------
        solution : Solution
            The numbers, of which the gain counts.

        Returns
        -------
        (nv,) array
            One over the gain's factor; 1 where there is no drive, and so no gain.
        """
        return np.where(self.equation.driven, solution.beta, 1.0)

    def linear_columns(
        self, solution: Solution, terms: Sequence[int]
    ) -> tuple[Array, Array, Array, Array]:
        """Return the columns of a linear solve, whose unknowns are multiplied by beta.

        Parameters
        ----------
        solution : Solution
            The delay, the payload's place, and the gain, by which rows without a drive are divided.
        terms : sequence of int
            Indices of k terms.

        Returns
        -------
        needed : (R, nv) array
            What the model needs where there are drives, 0 elsewhere [N, N m].
        columns : (R, nv, k) array
            The force that one unit of each of those terms needs.
        payload : (R, nv) array
            That of 1 kg of the payload; 0 where there is none.
        target : (R, nv) array
            The drives' forces; where there are none, those that nothing of the model explains.
        """
        driven = self.equation.driven
        scale = self.factors(solution) / solution.beta
        needed = np.where(driven, self.equation.needed, 0.0)
        payload = np.zeros_like(needed)
        if solution.payload is not None:
            payload = self.payload_column(solution.payload) * scale
        target = self.drives(solution.delay) - np.where(driven, 0.0, self.equation.needed)
        columns = self.columns_at(solution.delay, terms)
        return needed, columns * scale[:, None], payload, target

    def solve(self, solution: Solution) -> Solution:
        """Fit the sizes, the gain and the payload's mass by least squares, robustly weighted.

        Parameters
        ----------
        solution : Solution
            What is there, and the delay and the payload's place, which stay as they are.

        Returns
        -------
        Solution
            With these numbers, and weights from what is left.
        """
        columns, target, lowest = self._system(solution)
        found = np.zeros(0)
        for _ in range(self.settings.weightings):
            gram, moments = _normal_equations(columns, target, solution.weights)
            found = bounded_minimum(gram, moments, lowest)
            solution = self._reweighted(solution, target - columns @ found)
        names = list(solution.chosen)
        beta = max(float(found[names.index(GAIN)]), LEAST_BETA) if GAIN in names else 1.0
        sizes = np.zeros(len(self.terms))
        for i, value in zip(names, found, strict=False):
            if i != GAIN:
                sizes[i] = max(value / beta, self.terms[i].lowest)
        payload = solution.payload
        if payload is not None:
            payload = replace(payload, mass=float(found[-1] / beta))
        return replace(solution, sizes=sizes, gain=1.0 / beta - 1.0, payload=payload)

    def _system(self, solution: Solution) -> tuple[Array, Array, Array]:
        """Columns (R, nv, k), what they explain (R, nv), and lower bounds (k,)."""
        own = list(solution.terms)
        needed, terms, payload, target = self.linear_columns(solution, own)
        columns = []
        lowest = []
        for i in solution.chosen:
            columns.append(needed if i == GAIN else terms[:, :, own.index(i)])
            lowest.append(LEAST_BETA if i == GAIN else solution.beta * self.terms[i].lowest)
        if solution.payload is not None:
            columns.append(payload)
            lowest.append(0.0)
        if GAIN not in solution.chosen:
            target = target - needed
        stacked = np.stack(columns, axis=2) if columns else np.zeros((*needed.shape, 0))
        return stacked, target, np.array(lowest)

    def _reweighted(self, solution: Solution, residuals: Array) -> Solution:
        """Weights from what is left: one over each joint's spread, less for outliers."""
        used = self.equation.used
        left = np.where(used, residuals, np.nan)
        floor = self.settings.weight_floor * root_mean_square(self.forces(solution.delay))
        spread = np.fmax(deviation(left), floor)
        spread = np.where(spread > 0, spread, np.inf)
        size = np.maximum(np.abs(residuals) / spread, 1e-12)
        huber = np.sqrt(np.minimum(1.0, self.settings.huber / size))
        return replace(solution, weights=np.where(used, huber / spread, 0.0), spread=spread)

    def delayed(self, solution: Solution) -> Solution:
        """Find the delay with the least error, by a parabola through the best three of a grid.

        Parameters
        ----------
        solution : Solution
            What is there, and the weights; sizes are fitted again at each delay.

        Returns
        -------
        Solution
            The same with that delay [s].
        """
        delays = self.equation.delays
        errors = self._errors_at(solution)
        best = int(np.argmin(errors))
        if best in (0, len(delays) - 1):
            return replace(solution, delay=float(delays[best]))
        before, here, after = errors[best - 1 : best + 2]
        shift = 0.5 * (before - after) / (before - 2 * here + after)
        return replace(solution, delay=float(delays[best] + shift * (delays[1] - delays[0])))

    def _errors_at(self, solution: Solution) -> Array:
        """(D,) the weighted squared error at each of the equation's delays."""
        equation = self.equation
        columns_vary = any(self.terms[i].family == OWN_GAIN for i in solution.terms)
        # What no free gain multiplies stands on the left, whatever the delay.
        known = equation.needed
        if GAIN in solution.chosen:
            known = np.where(equation.driven, 0.0, known)
        found = []
        for k, delay in enumerate(equation.delays.tolist()):
            if k == 0 or columns_vary:
                columns, _, lowest = self._system(replace(solution, delay=delay))
                flat = _weighted(columns, solution.weights)
                gram = flat.T @ flat
            aim = ((equation.drives[k] - known) * solution.weights).ravel()
            moments = flat.T @ aim
            sizes = bounded_minimum(gram, moments, lowest)
            found.append(aim @ aim - 2 * moments @ sizes + sizes @ gram @ sizes)
        return np.array(found)

    # ---- the payload's place

    def loaded(self, solution: Solution, bodies: Iterable[int]) -> Solution:
        """Put the payload on the body, of some, and at the place that lower the error most.

        With all other numbers projected out, the error depends on a place through ten columns
        alone, so that a grid of places costs no dynamics.

        Parameters
        ----------
        solution : Solution
            What is there beside the payload, and the weights.
        bodies : iterable of int
            Places of the bodies among the moving ones.

        Returns
        -------
        Solution
            The same with that payload; unchanged where no mass lowers the error.
        """
        others, target, _ = self._system(replace(solution, payload=None))
        gram, moments = _normal_equations(others, target, solution.weights)
        ridge = 1e-10 * np.diag(np.maximum(np.diag(gram), 1e-300))
        weights = solution.weights[:, :, None]
        scale = (self.factors(solution) / solution.beta)[:, None]
        flat_others = (others * weights).reshape(target.size, others.shape[2])
        aim = (target * solution.weights).ravel()
        best: tuple[float, Payload | None] = (0.0, None)
        for body in bodies:
            own = (self.equation.by_inertia[body] * scale * weights).reshape(-1, 10)
            cross = flat_others.T @ own
            solved = np.linalg.solve(gram + ridge, np.column_stack([cross, moments]))
            left = own.T @ own - cross.T @ solved[:, :-1]
            aims = own.T @ aim - cross.T @ solved[:, -1]
            found = self._best_place(body, left, aims)
            best = max(best, found, key=lambda one: one[0])
        return solution if best[1] is None else replace(solution, payload=best[1])

    def _best_place(self, body: int, left: Array, aims: Array) -> tuple[float, Payload | None]:
        """How much 1 kg at the best place of a body explains, and the payload there."""
        reach = np.full(3, self.reaches[body])
        best = best_place(point_mass, left, aims, np.zeros(3), reach, self.settings.places)
        if best is None:
            return 0.0, None
        return best.gain, Payload(body, best.size, best.place)

    # ---- all numbers together

    def refined(self, solution: Solution) -> Solution:
        """Fit all numbers together by Gauss-Newton, the payload's place and the delay too.

        Parameters
        ----------
        solution : Solution
            Where the steps begin.

        Returns
        -------
        Solution
            Where a step would gain nothing, or after the settings' number of them.
        """
        jacobian, residuals = self.linearized(solution)
        for _ in range(self.settings.steps):
            solution = self._reweighted(solution, residuals)
            gram, moments = _normal_equations(jacobian, residuals, solution.weights)
            steps = bounded_minimum(gram, moments, *self._step_bounds(solution))
            before = weighted_squares(residuals, solution.weights)
            if steps @ (2 * moments - gram @ steps) <= self.settings.converged * before:
                break
            for _ in range(self.settings.halvings):
                moved = self._moved(solution, steps)
                jacobian, residuals = self.linearized(moved)
                if weighted_squares(residuals, solution.weights) <= before:
                    break
                steps = steps / 2
            solution = moved
        return self._reweighted(solution, residuals)

    def badness(self, solution: Solution) -> float:
        """Add up the logarithms of what is left at the joints, each over its rows.

        Parameters
        ----------
        solution : Solution
            The numbers, with the spread of what they leave.

        Returns
        -------
        float
            Less a constant, the negative log-likelihood of normal errors [nats].
        """
        rows = self.equation.used.sum(axis=0)
        return float(rows @ np.log(np.where(rows > 0, self.spread_of_drives(solution), 1.0)))

    def spread_of_drives(self, solution: Solution) -> Array:
        """Return what is left in the drives' forces as the model has them.

        A drive's noise shrinks with a gain of its own, which explains nothing.

        Parameters
        ----------
        solution : Solution
            The numbers, with the spread of what they leave.

        Returns
        -------
        (nv,) array
            [N, N m].
        """
        gains = np.zeros(len(solution.spread))
        for i in solution.terms:
            if self.terms[i].family == OWN_GAIN:
                gains[self.places[i]] = solution.sizes[i]
        return np.asarray(solution.spread / np.maximum(1 + gains, LEAST_BETA))

    def residuals(self, solution: Solution) -> Array:
        """Compute the drives' forces less what is explained.

        Parameters
        ----------
        solution : Solution
            The numbers.

        Returns
        -------
        (R, nv) array
            What is left [N, N m]; where there is no drive, what the motion needs and has not.
        """
        return self.linearized(solution)[1]

    def linearized(self, solution: Solution) -> tuple[Array, Array]:
        """Linearize what the numbers explain.

        Parameters
        ----------
        solution : Solution
            k numbers: beta where it is free, the terms' sizes, the payload's mass and place, and
            the delay, in this order.

        Returns
        -------
        jacobian : (R, nv, k) array
            Derivatives by the numbers.
        residuals : (R, nv) array
            What is left of the drives' forces.
        """
        columns = self.columns_at(solution.delay, solution.terms)
        needed = self.equation.needed + columns @ solution.sizes[solution.terms]
        factors = self.factors(solution)
        by_row = factors[:, None]
        parts = [by_row * columns]
        payload = solution.payload
        if payload is not None:
            own = self.payload_column(payload)
            needed = needed + payload.mass * own
            parts.append(by_row * own[:, :, None])
            by_inertia = self.equation.by_inertia[payload.body]
            moved = np.stack([point_mass_slope(payload.place, axis) for axis in np.eye(3)], axis=1)
            parts.append(by_row * payload.mass * (by_inertia @ moved))
        if GAIN in solution.chosen:
            parts.insert(0, np.where(self.equation.driven, needed, 0.0)[:, :, None])
        sizes = solution.sizes[solution.terms]
        moved_gains = self.columns_at(solution.delay, solution.terms, order=1) @ sizes
        by_delay = factors * moved_gains - np.asarray(self._drives(solution.delay, 1))
        parts.append(by_delay[:, :, None])
        residuals = self.drives(solution.delay) - factors * needed
        return np.concatenate(parts, axis=2), residuals

    def _step_bounds(self, solution: Solution) -> tuple[Array, Array]:
        """(k,) the lowest and the highest steps of the numbers; no payload leaves its reach."""
        lowest = [LEAST_BETA - solution.beta] if GAIN in solution.chosen else []
        lowest += [self.terms[i].lowest - solution.sizes[i] for i in solution.terms]
        highest = [np.inf] * len(lowest)
        payload = solution.payload
        if payload is not None:
            reach = self.reaches[payload.body]
            lowest += [-payload.mass / 2, *(-reach - payload.place).tolist()]
            highest += [np.inf, *(reach - payload.place).tolist()]
        first, last = self.equation.delays[[0, -1]].tolist()
        lowest.append(first - solution.delay)
        highest.append(last - solution.delay)
        return np.array(lowest), np.array(highest)

    def _moved(self, solution: Solution, steps: Array) -> Solution:
        """The solution after steps of its numbers, all shorter where a payload would go far."""
        payload = solution.payload
        if payload is not None:
            # Forces are linear in mass and moment, which steps of mass and place are one of.
            farther = payload.mass / max(payload.mass + steps[-5], 1e-300)
            longest = farther * float(np.abs(steps[-4:-1]).max())
            steps = steps * min(1.0, 0.2 * self.reaches[payload.body] / max(longest, 1e-300))
        values = steps.tolist()
        beta = solution.beta
        if GAIN in solution.chosen:
            beta = max(beta + values.pop(0), LEAST_BETA)
        sizes = solution.sizes.copy()
        for i in solution.terms:
            sizes[i] += values.pop(0)
        if payload is not None:
            reach = self.reaches[payload.body]
            mass = payload.mass + values[0]
            place = payload.place + steps[-4:-1] * payload.mass / max(mass, 1e-300)
            payload = Payload(payload.body, mass, np.clip(place, -reach, reach))
        delay = float(np.clip(solution.delay + values[-1], *self.equation.delays[[0, -1]]))
        return replace(solution, gain=1 / beta - 1, sizes=sizes, payload=payload, delay=delay)

    def covariance(self, solution: Solution) -> Array:
        """Compute the covariance of the numbers, with errors that depend on each other in a block.

        Errors that are the same in all blocks count too, by the settings' `misfit`. The variance of
        a number that moves no force is infinite.

        Parameters
        ----------
        solution : Solution
            The numbers, with the weights of rows.

        Returns
        -------
        (k, k) array
            Of one over the gain's factor where it is free, the terms' sizes, the payload's mass
            [kg] and place [m], and the delay [s], in this order.

        References
        ----------
        Liang and Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73
        (1986), 13.
        """
        jacobian, residuals = self.linearized(solution)
        weighted = jacobian * solution.weights[:, :, None]
        flat = weighted.reshape(-1, jacobian.shape[2])
        size = np.sqrt(np.sum(flat**2, axis=0))
        scale = np.where(size > 1e-100, size, np.inf)
        gram = (flat.T @ flat) / np.outer(scale, scale) + 1e-10 * np.eye(len(scale))
        inverse = np.linalg.inv(gram) / np.outer(scale, scale)
        by_row = np.einsum("rjk,rj->rk", weighted, residuals * solution.weights)
        blocks = np.unique(self.equation.block, return_inverse=True)[1]
        count = int(blocks.max()) + 1
        scores = np.zeros((count, len(scale)))
        np.add.at(scores, blocks, by_row)
        middle = scores.T @ scores * count / max(count - 1, 1)
        # What is left is no noise: a part of it may lie along any number, the same in all blocks.
        common = self.settings.misfit * float(np.count_nonzero(solution.weights)) * inverse
        covariance = np.asarray(inverse @ middle @ inverse + common)
        not_identifiable = np.flatnonzero(np.isinf(scale))
        covariance[not_identifiable, not_identifiable] = np.inf
        return covariance

    def may_have_any_gain(self, solution: Solution) -> bool:
        """Tell whether no motion tells the scale of all forces.

        Any gain of the drives would do then, with all other numbers in its proportion.

        Parameters
        ----------
        solution : Solution
            The numbers, whether the gain of all drives is among them or not.

        Returns
        -------
        bool
        """
        if not self.equation.driven.any():
            return False
        chosen = (GAIN, *(i for i in solution.chosen if i != GAIN))
        variance = float(self.covariance(replace(solution, chosen=chosen))[0, 0])
        return variance > solution.beta**2


def _normal_equations(columns: Array, target: Array, weights: Array) -> tuple[Array, Array]:
    """(k, k) weighted Gram matrix of the columns (R, nv, k), and products with the target (k,)."""
    flat = _weighted(columns, weights)
    return flat.T @ flat, flat.T @ (target * weights).ravel()


def _weighted(columns: Array, weights: Array) -> Array:
    """(R nv, k) columns (R, nv, k) times the weights (R, nv) of their rows."""
    return (columns * weights[:, :, None]).reshape(weights.size, columns.shape[2])


def weighted_squares(residuals: Array, weights: Array) -> float:
    """Add up the squares of what is left, weighted.

    Parameters
    ----------
    residuals, weights : (R, nv) arrays
        What is left, and square roots of the weights.

    Returns
    -------
    float
    """
    return float(np.sum((residuals * weights) ** 2))


def root_mean_square(values: Array) -> Array:
    """Return the root mean square of each column, NaN left out.

    Parameters
    ----------
    values : (R, nv) array
        Rows of any unit.

    Returns
    -------
    (nv,) array
        In the same unit; 0 where all rows are NaN.
    """
    there = np.isfinite(values)
    total = np.sum(np.where(there, values, 0.0) ** 2, axis=0)
    return np.asarray(np.sqrt(total / np.maximum(there.sum(axis=0), 1)))
