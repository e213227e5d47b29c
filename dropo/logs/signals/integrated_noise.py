"""Motion as m-fold integrated white noise, seen through noise: smoothed and filtered states, and
the likelihood, in linear time.

A state holds the position and its first m - 1 derivatives; the m-th one is white noise of density
q. Measured positions carry white noise of variance r. The posterior mean of the position is the
smoothing spline of order 2 m - 1 (Wahba, JRSS B 40, 1978). The precision of all states together is
a band matrix, so that one banded Cholesky factor gives the smoothed states and the likelihood (Rue
and Held 2005, chapter 2). The likelihood is the one of contrasts that no initial state changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

FREE = 1e8  # a variance, in units of that of a measurement, that lets a number be anything


def transition(order: int) -> tuple[Array, Array]:
    """A and Q, (m, m) each: a state one unit of time later is A state + a normal vector of
    covariance q Q.
    """
    i, j = np.indices((order, order))
    factorials = np.array([factorial(k) for k in range(order)], dtype=float)
    a = np.where(j >= i, 1 / factorials[np.maximum(j - i, 0)], 0.0)
    return a, 1 / (factorials[order - 1 - i] * factorials[order - 1 - j] * (2 * order - 1 - i - j))


@dataclass(frozen=True, eq=False)
class Motion:
    """One measured position, (n,) at increasing `time` (n,) [s]; it begins anew at the rows in
    `jumps`.

    unit: seconds of a typical step, the inner unit of time, which keeps numbers of like size.
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

    @cached_property
    def _precisions(self) -> Array:
        """(n - 1, m, m) of the noise in each step, at q = 1 and h = 1; 0 into a row where the
        motion begins anew.
        """
        out = np.repeat(np.linalg.inv(transition(self.order)[1])[None], len(self.time) - 1, axis=0)
        out[self.jumps - 1] = 0.0
        return out

    def _factor(self, ratio: float) -> Array:
        """The banded Cholesky factor (2 m, n m) of the states' precision in units of 1 / r; ratio:
        q / r for the inner unit of time.
        """
        m = self.order
        n = len(self.time)
        a = transition(m)[0]
        weights = 1 / (ratio * self.scale[:, :, None] * self.scale[:, None, :])
        between = -weights * (self._precisions @ a)
        diagonal = np.zeros((n, m, m))
        diagonal[:-1] += weights * (a.T @ self._precisions @ a)
        diagonal[1:] += weights * self._precisions
        diagonal[:, 0, 0] += 1.0
        band = np.zeros((2 * m, n, m))
        for column in range(m):
            for row in range(column, m):
                band[row - column, :, column] = diagonal[:, row, column]
            for row in range(m):
                band[m + row - column, :-1, column] = between[:, row, column]
        return np.asarray(
            cholesky_banded(band.reshape(2 * m, n * m), lower=True, check_finite=False)
        )

    def _states(self, factor: Array, measured: Array) -> Array:
        """(n, m, k) from k measured columns (n, k)."""
        right = np.zeros((len(self.time), self.order, measured.shape[1]))
        right[:, 0] = measured
        found = cho_solve_banded(
            (factor, True), right.reshape(-1, right.shape[2]), check_finite=False
        )
        return np.asarray(found).reshape(right.shape)

    def fit(self, ratio: float) -> tuple[float, float, float]:
        """At q / r = ratio, in the inner unit of time: the sum of squares, the log determinant, and
        the degrees of freedom.

        Minus twice the log likelihood is squares / r + degrees log r + determinant, up to a
        constant.
        """
        factor = self._factor(ratio)
        states = self._states(factor, self.measured[:, None])[:, :, 0]
        noise = self._noise(states)
        squares = (
            np.sum((self.measured - states[:, 0]) ** 2)
            + np.einsum("ni,nij,nj->", noise, self._precisions, noise) / ratio
        )
        within = np.ones(len(self.time) - 1, dtype=bool)
        within[self.jumps - 1] = False
        determinant = 2 * np.log(factor[0]).sum() + 2 * np.log(self.scale[within]).sum()
        determinant += within.sum() * np.linalg.slogdet(ratio * transition(self.order)[1])[1]
        return (
            float(squares),
            float(determinant),
            len(self.time) - self.order * (1 + len(self.jumps)),
        )

    def _noise(self, states: Array) -> Array:
        """(n - 1, m) what was added in each step, in the units of a step of length 1."""
        return states[1:] / self.scale - (states[:-1] / self.scale) @ transition(self.order)[0].T

    def smoothed(self, ratio: float, measured: Array) -> Array:
        """(n, m, k) the states given every measurement, per second, of k columns (n, k) measured in
        place of this one.
        """
        return (
            self._states(self._factor(ratio), measured)
            / self.unit ** np.arange(self.order)[:, None]
        )

    def scores(self, ratio: float) -> Array:
        """(n - 1, m) how much each step wants each derivative to jump, in like units for all steps
        (Harvey and Koopman 1992).
        """
        states = self._states(self._factor(ratio), self.measured[:, None])
        return np.einsum("nij,nj->ni", self._precisions, self._noise(states[:, :, 0]))


def filtered(motions: Sequence[Motion], ratios: Array) -> Array:
    """(p, n, m) the states of p positions measured at the same times, each given the measurements
    up to it: a Kalman filter.

    ratios: (p,) q / r in the inner unit of time. It knows of no jumps: behind one it catches up.
    """
    first = motions[0]
    m = first.order
    p = len(motions)
    scale = first.scale
    measured = np.stack([motion.measured for motion in motions], axis=1)  # (n, p)
    covariance = np.repeat(np.diag([1.0, *[FREE] * (m - 1)])[None], p, axis=0)  # in units of r
    out = np.zeros((len(measured), p, m))
    out[0, :, 0] = measured[0]
    a, q = transition(m)
    moves = scale[:, :, None] * a / scale[:, None, :]
    noises = scale[:, :, None] * q * scale[:, None, :]
    for k, (a, q) in enumerate(zip(moves, noises, strict=True)):
        states = out[k] @ a.T
        covariance = a @ covariance @ a.T + ratios[:, None, None] * q
        gain = covariance[:, :, 0] / (covariance[:, :1, 0] + 1)
        out[k + 1] = states + gain * (measured[k + 1] - states[:, 0])[:, None]
        covariance = covariance - gain[:, :, None] * covariance[:, None, 0, :]
    return out.transpose(1, 0, 2) / first.unit ** np.arange(m)
