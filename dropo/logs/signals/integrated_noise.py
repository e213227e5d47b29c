"""Motion as m-fold integrated white noise, seen through noise, in linear time.

A state holds the position and its first m - 1 derivatives; the m-th one is white noise of density
q. Measured positions carry white noise of variance r. The posterior mean of the position is the
smoothing spline of order 2 m - 1 (Wahba, JRSS B 40, 1978). The precision of all states together is
a band matrix, so that one banded Cholesky factor gives the smoothed states and the likelihood (Rue
and Held 2005, chapter 2). The likelihood is the one of contrasts that no initial state changes. The
filter, which knows the past alone, is a Kalman filter step by step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from math import factorial

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from dropo.core.numerics.kalman import Sensors, predict, update
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

FREE = 1e8  # a variance, in units of that of a measurement, that lets a number be anything


@cache
def transition(order: int) -> tuple[Array, Array]:
    """Return the transition over one unit of time.

    Parameters
    ----------
    order : int
        m, the numbers in a state.

    Returns
    -------
    a : (m, m) array
        A state one unit of time later is A state + a normal vector of covariance q Q.
    q : (m, m) array
        Q.
    """
    i, j = np.indices((order, order))
    factorials = np.array([factorial(k) for k in range(order)], dtype=float)
    a = np.where(j >= i, 1 / factorials[np.maximum(j - i, 0)], 0.0)
    products = factorials[order - 1 - i] * factorials[order - 1 - j]
    q = 1 / (products * (2 * order - 1 - i - j))
    for array in (a, q):
        array.flags.writeable = False  # the same arrays at every call
    return a, q


@dataclass(frozen=True)
class LikelihoodTerms:
    """What the likelihood of measured positions is made of.

    Under a variance r of the measurements, minus twice its logarithm is squares / r + degrees log r
    + log_determinant, up to a constant.

    Attributes
    ----------
    squares : float
        Squared residuals of the most likely motion, plus the squares of the noise that drives it
        in units of q / r; in the position's unit squared.
    log_determinant : float
        Of the states' precision, in units of 1 / r, and of the covariance of what drives them.
    degrees : int
        Degrees of freedom: measurements less the numbers of the states at which the motion begins.
    """

    squares: float
    log_determinant: float
    degrees: int

    def __add__(self, other: "LikelihoodTerms") -> "LikelihoodTerms":
        """Those of two independent motions together."""
        return LikelihoodTerms(
            self.squares + other.squares,
            self.log_determinant + other.log_determinant,
            self.degrees + other.degrees,
        )


@dataclass(frozen=True, eq=False)
class IntegratedNoise:
    """One measured position.

    Attributes
    ----------
    time : (n,) array
        Increasing instants [s].
    measured : (n,) array
        The position then.
    order : int
        m, the numbers in a state.
    jumps : int array
        Rows at which the motion begins anew.
    unit : float
        A typical step, the inner unit of time, which keeps numbers of like size [s].
    """

    time: Array
    measured: Array
    order: int
    jumps: Ints
    unit: float

    @cached_property
    def scale(self) -> Array:
        """(n - 1, m) T of each step h, for which A(h) = T A(1) T^-1 and Q(h) = T Q(1) T."""
        steps = np.diff(self.time) / self.unit
        return steps[:, None] ** (self.order - 0.5 - np.arange(self.order))

    def steps(self) -> tuple[Array, Array]:
        """Give the matrices of every step.

        Returns
        -------
        transition, noise : (n - 1, m, m) array
            A(h) and Q(h) at q = 1.
        """
        a, q = transition(self.order)
        rows = self.scale[:, :, None]
        columns = self.scale[:, None, :]
        return rows * a / columns, rows * q * columns

    @cached_property
    def _precisions(self) -> Array:
        """(n - 1, m, m) of the noise in each step, at q = h = 1; 0 where the motion begins anew."""
        precision = np.linalg.inv(transition(self.order)[1])
        precisions = np.repeat(precision[None], len(self.time) - 1, axis=0)
        precisions[self.jumps - 1] = 0.0
        return precisions

    @cached_property
    def _moved_precisions(self) -> tuple[Array, Array]:
        """(n - 1, m, m) each: P A and A' P A of the precisions P."""
        a = transition(self.order)[0]
        return self._precisions @ a, a.T @ self._precisions @ a

    def _factor(self, ratio: float) -> Array:
        """The banded Cholesky factor (2 m, n m) of the states' precision in units of 1 / r."""
        m = self.order
        n = len(self.time)
        to_next, of_next = self._moved_precisions
        weights = 1 / (ratio * self.scale[:, :, None] * self.scale[:, None, :])
        # Blocks of the precision: of each state, and of each with the next.
        between = -weights * to_next
        diagonal = np.zeros((n, m, m))
        diagonal[:-1] += weights * of_next
        diagonal[1:] += weights * self._precisions
        diagonal[:, 0, 0] += 1.0
        # The lower band, diagonal by diagonal.
        band = np.zeros((2 * m, n, m))
        for column in range(m):
            for row in range(column, m):
                band[row - column, :, column] = diagonal[:, row, column]
            for row in range(m):
                band[m + row - column, :-1, column] = between[:, row, column]
        flat = band.reshape(2 * m, n * m)
        return np.asarray(cholesky_banded(flat, lower=True, check_finite=False))

    def _states(self, factor: Array, measured: Array) -> Array:
        """(n, m, k) from k measured columns (n, k)."""
        right = np.zeros((len(self.time), self.order, measured.shape[1]))
        right[:, 0] = measured
        flat = right.reshape(-1, right.shape[2])
        found = cho_solve_banded((factor, True), flat, check_finite=False)
        return np.asarray(found).reshape(right.shape)

    def likelihood_terms(self, ratio: float) -> LikelihoodTerms:
        """Return what the likelihood is made of.

        Parameters
        ----------
        ratio : float
            q / r, in the inner unit of time.

        Returns
        -------
        LikelihoodTerms
        """
        factor = self._factor(ratio)
        states = self._states(factor, self.measured[:, None])[:, :, 0]
        noise = self._noise(states)
        squares = np.sum((self.measured - states[:, 0]) ** 2)
        squares += np.einsum("ni,nij,nj->", noise, self._precisions, noise) / ratio
        no_jump = np.ones(len(self.time) - 1, dtype=bool)
        no_jump[self.jumps - 1] = False
        log_determinant = 2 * np.log(factor[0]).sum() + 2 * np.log(self.scale[no_jump]).sum()
        log_determinant += no_jump.sum() * np.linalg.slogdet(ratio * transition(self.order)[1])[1]
        degrees = len(self.time) - self.order * (1 + len(self.jumps))
        return LikelihoodTerms(float(squares), float(log_determinant), degrees)

    def _noise(self, states: Array) -> Array:
        """(n - 1, m) what was added in each step, in the units of a step of length 1."""
        return states[1:] / self.scale - (states[:-1] / self.scale) @ transition(self.order)[0].T

    def smoothed(self, ratio: float, measured: Array) -> Array:
        """Estimate the states from all measurements.

        Parameters
        ----------
        ratio : float
            q / r, in the inner unit of time.
        measured : (n, k) array
            k positions measured in place of this one.

        Returns
        -------
        (n, m, k) array
            The positions and their derivatives [per second].
        """
        units = self.unit ** np.arange(self.order)[:, None]
        return self._states(self._factor(ratio), measured) / units

    def scores(self, ratio: float) -> Array:
        """Return how much each step asks each derivative to jump.

        Parameters
        ----------
        ratio : float
            q / r, in the inner unit of time.

        Returns
        -------
        (n - 1, m) array
            Scores, in like units for all steps (Harvey and Koopman 1992).
        """
        states = self._states(self._factor(ratio), self.measured[:, None])
        return np.einsum("nij,nj->ni", self._precisions, self._noise(states[:, :, 0]))


def filter_motions(motions: Sequence[IntegratedNoise], ratios: Array) -> Array:
    """Estimate the states of positions measured at the same times, by the past alone.

    The filter knows of no jumps: behind one it catches up.

    Parameters
    ----------
    motions : sequence of IntegratedNoise
        The p positions.
    ratios : (p,) array
        q / r of each, in the inner unit of time.

    Returns
    -------
    (p, n, m) array
        The position and its derivatives [per second].
    """
    first = motions[0]
    order = first.order
    measured = np.stack([motion.measured for motion in motions], axis=1)[:, :, None]  # (n, p, 1)
    transitions, processes = first.steps()
    # The variance of a measurement is the unit, and only the position is measured.
    sensors = Sensors.of(np.array([1.0, *[np.inf] * (order - 1)]))
    start = np.diag([1.0, *[FREE] * (order - 1)])
    covariance = np.repeat(start[None], len(motions), axis=0)
    states = np.zeros((len(measured), len(motions), order))
    states[0, :, 0] = measured[0, :, 0]
    state = states[0]
    for k, (a, q) in enumerate(zip(transitions, processes, strict=True)):
        state, covariance = predict(state, covariance, a, ratios[:, None, None] * q)
        corrected = update(state, covariance, measured[k + 1], sensors)
        state = corrected.state
        covariance = corrected.covariance
        states[k + 1] = state
    # From derivatives by the inner unit of time to derivatives by seconds.
    return states.transpose(1, 0, 2) / first.unit ** np.arange(order)
