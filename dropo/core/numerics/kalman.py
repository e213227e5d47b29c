"""Steps of the Kalman filter and of the Rauch-Tung-Striebel smoother: arrays in, arrays out.

A state x of m numbers follows x' = A x + b + w with w ~ N(0, Q), and s of its components are
measured: y = H x + v with v ~ N(0, R), where H selects these components and R is diagonal. An
extended filter passes A and b of its linearization. Every array may have leading axes, such as one
of trajectories, which broadcast. Covariances are in the products of the components' units.

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
        H: the components that are measured.
    variance : (s,) array
        Variances of their noise, in their squared units.
    covariance : (s, s) array
        R: the same as a diagonal matrix.
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
            Variance of the noise of each component; infinite where it was not measured. At least
            one must be finite.

        Returns
        -------
        Sensors
        """
        columns = np.flatnonzero(np.isfinite(variance))
        measured_variance = variance[columns]
        covariance = np.diag(measured_variance)
        # Neighbouring columns are a slice, which numpy takes without a copy.
        first = int(columns[0])
        end = int(columns[-1]) + 1
        if end - first == len(columns):
            return Sensors(slice(first, end), measured_variance, covariance)
        return Sensors(columns, measured_variance, covariance)


class Update(NamedTuple):
    """A state corrected by a measurement.

    Attributes
    ----------
    state : (..., m) array
        Mean given the measurement.
    covariance : (..., m, m) array
        Covariance given the measurement.
    gain : (..., m, s) array
        K, the Kalman gain: the state was corrected by K times the innovation.
    innovation : (..., s) array
        Measurement less what was predicted for it.
    innovation_covariance : (..., s, s) array
        S, the covariance of the innovation.
    """

    state: Array
    covariance: Array
    gain: Array
    innovation: Array
    innovation_covariance: Array

    @property
    def squared_distance(self) -> Array:
        """(...,) squared Mahalanobis distance: chi-squared with s degrees of freedom."""
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
        Q, the covariance of the process noise: of what the map misses.
    drift : (..., m) array or float
        b, what one step adds whatever the state.

    Returns
    -------
    tuple of arrays
        Mean (..., m) and covariance (..., m, m) after the step.
    """
    mean = (transition @ state[..., None])[..., 0] + drift
    predicted_covariance = transition @ covariance @ transition.swapaxes(-1, -2) + process
    return mean, predicted_covariance


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
    cross = covariance[..., columns, :]  # H P
    innovation_covariance = cross[..., columns] + sensors.covariance  # S = H P H' + R
    innovation = measured - state[..., columns]
    if len(sensors.variance) == 1:
        # One measured component needs no solver. P - P H' S^-1 H P takes H P and P H' as they are:
        # so rounding that makes P unsymmetric dies out.
        gain = covariance[..., columns] / innovation_covariance
        corrected = state + gain[..., 0] * innovation
        corrected_covariance = covariance - gain * cross
    else:
        # K = P H' S^-1, by its transpose S^-1 H P.
        transposed_gain = np.linalg.solve(innovation_covariance, cross)
        gain = np.asarray(transposed_gain.swapaxes(-1, -2), dtype=float)
        corrected = state + (gain @ innovation[..., None])[..., 0]
        # Joseph's form, (I - K H) P (I - K H)' + K R K', stays positive semidefinite.
        remaining = np.broadcast_to(np.eye(state.shape[-1]), covariance.shape).copy()  # I - K H
        remaining[..., columns] -= gain
        corrected_covariance = remaining @ covariance @ remaining.swapaxes(-1, -2)
        corrected_covariance += (gain * sensors.variance) @ gain.swapaxes(-1, -2)
    return Update(corrected, corrected_covariance, gain, innovation, innovation_covariance)


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
        Mean (..., m), covariance (..., m, m), and the lag-one covariance (..., m, m) of the next
        state with this one, all given all measurements.
    """
    mean, covariance = filtered
    predicted_mean, predicted_covariance = predicted
    next_mean, next_covariance = following
    # The smoother's gain, by its transpose: covariance A' predicted_covariance^-1.
    transposed_gain = np.linalg.solve(predicted_covariance, transition @ covariance)
    gain = transposed_gain.swapaxes(-1, -2)
    smoothed_mean = mean + (gain @ (next_mean - predicted_mean)[..., None])[..., 0]
    covariance_change = next_covariance - predicted_covariance
    smoothed_covariance = covariance + gain @ covariance_change @ gain.swapaxes(-1, -2)
    lag_one_covariance = next_covariance @ gain.swapaxes(-1, -2)
    return smoothed_mean, smoothed_covariance, lag_one_covariance
