"""Hopping, the task of the thesis' policies (section 6.2.4), as Gymnasium's Hopper-v5 has it."""

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.task import Task
from dropo.core.services.validation import Array
from dropo.problems.hopper.data import healthy, start_states
from dropo.problems.hopper.model import FRAME_SKIP

STEPS = 500  # control steps of an episode in the thesis
SECONDS = 0.002 * FRAME_SKIP  # of a control step
FASTEST = 10.0  # [m/s, rad/s] at which Gymnasium clips the velocities that it shows
FARTHEST = 100.0  # bound of a healthy state's numbers, except for the first two positions


def hopping() -> Task:
    """The task of hopping forward.

    Returns
    -------
    Task
        Its reward is the forward speed [m/s] less 0.001 of the squared commands, with a bonus of 1
        for each control step that ends upright.
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
    """The reward of Hopper-v5 without its bonus.

    Parameters
    ----------
    before, after : (m, 12) array
        States at the start and at the end of a control step.
    actions : (m, 3) array
        Commands in between.

    Returns
    -------
    (m,) array
        Forward speed [m/s] less 0.001 of the squared commands.
    """
    return (after[:, 0] - before[:, 0]) / SECONDS - 1e-3 * np.sum(actions**2, axis=1)


def upright(states: Array) -> NDArray[np.bool_]:
    """Tell which states have not fallen by Gymnasium's rule.

    Parameters
    ----------
    states : (m, 12) array
        States, `qpos` then `qvel`.

    Returns
    -------
    (m,) bool array
        Whether the torso is high and upright enough, and no component is beyond `FARTHEST`.
    """
    return healthy(states) & (np.abs(states[:, 2:]) < FARTHEST).all(axis=1)


def shown(rows: Array) -> Array:
    """Clip the velocities of observations as Gymnasium clips them.

    Parameters
    ----------
    rows : (m, 11) array
        Observations: five positions, then six velocities.

    Returns
    -------
    (m, 11) array
        The same, with velocities within -`FASTEST` and `FASTEST`.
    """
    return np.concatenate([rows[:, :5], np.clip(rows[:, 5:], -FASTEST, FASTEST)], axis=1)
