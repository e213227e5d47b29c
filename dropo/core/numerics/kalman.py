"""Steps of the Kalman filter and of the Rauch-Tung-Striebel smoother: arrays in, arrays out.

A state x of m numbers follows x' = A x + b + w with w ~ N(0, Q), and some of its components are
measured, each with independent noise. An extended filter passes A and b of its linearization.
Every array may have leading axes, such as one of trajectories, which broadcast.

References
----------
Rauch, Tung and Striebel, AIAA Journal 3 (1965), 1445; Jazwinski, Stochastic Processes and Filtering
Theory (1970), chapter 8.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array


@dataclass(frozen=True, eq=False)
class Sensors:
    """Which components of a state are measured, and with what noise.

    Attributes
    ----------
    columns : (s,) int array or slice
        The components that are measured.
    variance : (s,) array
        Variances of their noise, in their squared units.
    covariance : (s, s) array
        The same as a diagonal matrix.
    """

    columns: NDArray[np.int64] | slice
    variance: Array
    covariance: Array

    @staticmethod
    def of(variance: Array) -> "Sensors":
        """The sensors of a state by the variance of each component.

        Parameters
        ----------
        variance : (m,) array
            Variance of the noise of each component; infinite where it was not measured.

        Returns
        -------
        Sensors
        """
        columns = np.flatnonzero(np.isfinite(variance))
        known = variance[columns]
        first = int(columns[0])
        contiguous = len(columns) == int(columns[-1]) + 1 - first
        index = slice(first, first + len(columns)) if contiguous else columns
        return Sensors(index, known, np.diag(known))


class Update(NamedTuple):
    """A state corrected by a measurement.

    Attributes
    ----------
    state : (..., m) array
        Mean given the measurement.
    covariance : (..., m, m) array
        Covariance given the measurement.
    gain : (..., m, s) array
        Share of the innovation by which the state was corrected.
    innovation : (..., s) array
        Measurement less what was predicted for it.
    innovation_covariance : (..., s, s) array
        Covariance of the innovation.
    """

    state: Array
    covariance: Array
    gain: Array
    innovation: Array
    innovation_covariance: Array

    @property
    def squared_distance(self) -> Array:
        """(...,) squared Mahalanobis length of the innovation: chi-squared with s degrees."""
        column = self.innovation[..., None]
        weighted = np.linalg.solve(self.innovation_covariance, column)
        return np.asarray((column.swapaxes(-1, -2) @ weighted)[..., 0, 0])

    @property
    def log_likelihood(self) -> Array:
        """(...,) log density of the innovation, less its constant -s log(2 pi) / 2 [nats]."""
        log_determinant = np.linalg.slogdet(self.innovation_covariance)[1]
        return np.asarray(-0.5 * (self.squared_distance + log_determinant))


def predict(
    state: Array, covariance: Array, transition: Array, process: Array, drift: Array | float = 0.0
) -> tuple[Array, Array]:
    """Predict the state after one step.

    Parameters
    ----------
    state : (..., m) array
        Mean before the step.
    covariance : (..., m, m) array
        Covariance before the step.
    transition : (..., m, m) array
        A, the linear map of one step.
    process : (..., m, m) array
        Q, the covariance of what the map misses.
    drift : (..., m) array or float
        b, what one step adds whatever the state.

    Returns
    -------
    tuple of arrays
        Mean (..., m) and covariance (..., m, m) after the step.
    """
    mean = (transition @ state[..., None])[..., 0] + drift
    return mean, transition @ covariance @ transition.swapaxes(-1, -2) + process


def update(state: Array, covariance: Array, measured: Array, sensors: Sensors) -> Update:
    """Correct a state by measurements of some of its components.

    Parameters
    ----------
    state : (..., m) array
        Mean before the measurement.
    covariance : (..., m, m) array
        Covariance before the measurement.
    measured : (..., s) array
        Measured components, in the order of `sensors.columns`.
    sensors : Sensors
        Which components these are, and their noise.

    Returns
    -------
    Update
        The corrected state, and how it was corrected.
    """
    columns = sensors.columns
    cross = covariance[..., columns, :]
    innovation_covariance = cross[..., columns] + sensors.covariance
    innovation = measured - state[..., columns]
    if len(sensors.variance) == 1:
        # One measured component needs no solver. P - P H' S^-1 H P takes H P and P H' as they are:
        # so rounding that makes P unsymmetric dies out.
        gain = covariance[..., columns] / innovation_covariance
        corrected = state + gain[..., 0] * innovation
        return Update(corrected, covariance - gain * cross, gain, innovation, innovation_covariance)
    solved = np.linalg.solve(innovation_covariance, cross)
    gain = np.asarray(solved.swapaxes(-1, -2), dtype=float)
    corrected = state + (gain @ innovation[..., None])[..., 0]
    # Joseph's form, (I - K H) P (I - K H)' + K R K', stays positive.
    rest = np.broadcast_to(np.eye(state.shape[-1]), covariance.shape).copy()
    rest[..., columns] -= gain
    spread = rest @ covariance @ rest.swapaxes(-1, -2)
    spread += (gain * sensors.variance) @ gain.swapaxes(-1, -2)
    return Update(corrected, spread, gain, innovation, innovation_covariance)


def smooth(
    filtered: tuple[Array, Array],
    transition: Array,
    predicted: tuple[Array, Array],
    following: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Correct a filtered state by all that was measured after it.

    Parameters
    ----------
    filtered : tuple of arrays
        Mean (..., m) and covariance (..., m, m) given the measurements up to this state.
    transition : (..., m, m) array
        A, the linear map of the step from it.
    predicted : tuple of arrays
        Mean and covariance of the next state, as `predict` gave them.
    following : tuple of arrays
        Mean and covariance of the next state given all measurements.

    Returns
    -------
    tuple of arrays
        Mean (..., m), covariance (..., m, m), and the covariance (..., m, m) of the next state
        with this one, all given all measurements.
    """
    state, covariance = filtered
    gain = np.linalg.solve(predicted[1], transition @ covariance).swapaxes(-1, -2)
    mean = state + (gain @ (following[0] - predicted[0])[..., None])[..., 0]
    spread = covariance + gain @ (following[1] - predicted[1]) @ gain.swapaxes(-1, -2)
    lagged = following[1] @ gain.swapaxes(-1, -2)
    return mean, spread, lagged
