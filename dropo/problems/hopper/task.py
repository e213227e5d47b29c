"""Hopping: what the policies of the thesis are trained for on the hopper (section 6.2.4), as
Gymnasium's Hopper-v5 has it.
"""

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.task import Task
from dropo.core.services.validation import Array
from dropo.problems.hopper.data import healthy, start_states
from dropo.problems.hopper.model import FRAME_SKIP

STEPS = 500  # control steps of an episode in the thesis
SECONDS = 0.002 * FRAME_SKIP  # of a control step
FASTEST = 10.0  # [m/s, rad/s] beyond which Gymnasium cuts a velocity that it shows
FARTHEST = 100.0  # of any number of a sound state, behind the first two positions


def hopping() -> Task:
    """Forward speed [m/s], less 0.001 of the squared commands; a bonus of 1 for each step that ends
    upright.
    """
    return Task(
        forward,
        start_states,
        steps=STEPS,
        alive=upright,
        bonus=1.0,
        observe=shown,
        source="dropo.problems.hopper.task:hopping",
    )


def forward(before: Array, actions: Array, after: Array) -> Array:
    """(m,) the reward of Hopper-v5 without its bonus."""
    return (after[:, 0] - before[:, 0]) / SECONDS - 1e-3 * np.sum(actions**2, axis=1)


def upright(states: Array) -> NDArray[np.bool_]:
    """(m,) which have not fallen, by Gymnasium's rule."""
    return healthy(states) & (np.abs(states[:, 2:]) < FARTHEST).all(axis=1)


def shown(rows: Array) -> Array:
    """(m, 11) observation rows with velocities cut as Gymnasium cuts them."""
    return np.concatenate([rows[:, :5], np.clip(rows[:, 5:], -FASTEST, FASTEST)], axis=1)
