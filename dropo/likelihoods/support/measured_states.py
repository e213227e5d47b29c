"""Residuals as what they are where starts were measured, too: the noise of measured states.

A state ends one row and starts the next: its noise is in both, with opposite signs.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dropo.core.numerics.kept_rows import KeptRows
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class StatesSettings:
    """What is affordable.

    Attributes
    ----------
    most : int
        So many numbers at most of all rows' slopes in their starts.
    """

    most: int = 10_000_000


SETTINGS = StatesSettings()


@dataclass(frozen=True, eq=False)
class StartNoise:
    """The noise of the states from which R rows start.

    Attributes
    ----------
    noise : (R, p) array
        In the signals' units.
    before : (R,) array of int
        The row that ends in the state from which a row starts, or -1.
    """

    noise: Array
    before: Ints


def start_noise(
    residuals: Array,
    slope: KeptRows,
    epsilon: Array,
    segments: Segments,
    settings: StatesSettings = SETTINGS,
) -> StartNoise | None:
    """Find the least noise of measured states that makes the residuals.

    With n the noise of a state and J the slope of a row in its start, r = n_end - J n_start.

    Parameters
    ----------
    residuals : (R, p) array
        Measured less predicted, in the signals' units.
    slope : (R, p, p) array
        J of each row.
    epsilon : (p,) array
        The noise's variances.
    segments : Segments
        With R compared rows.
    settings : StatesSettings

    Returns
    -------
    StartNoise or None
        None where rows share an end, or that would take too much.
    """
    count, p = residuals.shape
    segment, step = segments.rows
    end = segments.steps[segment, step]
    if count * p * p > settings.most or len(np.unique(end)) < count:
        return None
    first = segments.steps[segment, 0]
    data = segments.trajectories
    row_of = np.full(len(data.observations), -1)
    row_of[end] = np.arange(count)
    goes_on = (first > 0) & (data.trajectory[first] == data.trajectory[first - 1])
    goes_on &= (data.observations[first] == data.next_observations[first - 1]).all(axis=1)
    before = np.where(goes_on, row_of[first - 1], -1)

    # States are the rows' ends, then the starts in which none of them ends.
    others, number = np.unique(first, return_inverse=True)
    start = np.where(before >= 0, before, count + number)
    row = (np.arange(count)[:, None] * p + np.arange(p))[:, :, None]
    column = (start[:, None] * p + np.arange(p))[:, None]
    rows, columns = (place.ravel() for place in np.broadcast_arrays(row, column))
    size = (count * p, (count + len(others)) * p)
    by_start = sparse.coo_array((slope[:].ravel(), (rows, columns)), shape=size)
    of_states = sparse.eye_array(*size) - by_start
    weighed = sparse.csc_array(of_states * np.tile(epsilon, count + len(others)))
    gram = sparse.csc_array(weighed @ of_states.T)
    noise = np.asarray(weighed.T @ splu(gram).solve(residuals.ravel()))
    return StartNoise(noise.reshape(-1, p)[start], before)
