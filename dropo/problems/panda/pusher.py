"""An arm that guides a pin over a table by joint accelerations, under any pushing policy."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Protocol

import mujoco
import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import reference_pose
from dropo.mjmodel.options import physics_step
from dropo.problems.panda.reaching import joint_path
from dropo.simulators.mujoco.closed_loop import Rollouts, closed_loop

HEIGHT = 0.04  # [m] of the pin's tip above the table
FIRST = np.array([0.1, 0.2, -0.1, -2.6, 0.0, 2.8, 0.0])
"""[rad] a bent arm, from which poses are solved."""
PLACE = (0.34, 0.0)  # [m] where the pin starts
ACCELERATION = 3.0  # [m/s^2] maximum of the pin
JOINT_ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
"""[rad/s^2] the Panda's own limits."""
POWERS = [(i, j) for i in range(5) for j in range(5 - i)]
X = np.linspace(0.32, 0.76, 12)
"""[m] the part of the table within the pin's reach, ahead."""
Y = np.linspace(-0.16, 0.16, 9)
"""[m] the part of the table within the pin's reach, aside."""
BOX = 7  # where the box' seven numbers begin in qpos, behind the joints


class PushingPolicy(Protocol):
    """Guides the pins of n arms: wanted velocities of the pins from the places of the boxes."""

    def __call__(self, boxes: Array, pins: Array, ids: Ints, step: int) -> Array:
        """Wanted velocities of pins at a control step.

        Parameters
        ----------
        boxes : (m, 3) array
            x [m], y [m] and turn [rad] of the boxes.
        pins : (m, 2) array
            Places of the pins [m].
        ids : (m,) int array
            Which of the n arms these are.
        step : int
            Number of the control step, from 0.

        Returns
        -------
        (m, 2) array
            Velocities [m/s].
        """
        ...


@lru_cache(maxsize=8)
def _polynomial(model: mujoco.MjModel) -> Array:
    """Coefficients (15, 7) of the joint angles over the table, of fourth order, the pin upright."""
    # The grid is walked there and back, so that each pose is close to the one before it.
    grid = np.array([(x, y) for i, x in enumerate(X) for y in (Y if i % 2 else Y[::-1])])
    positions = np.column_stack([grid, np.full(len(grid), HEIGHT)])
    upright = np.repeat(np.diag([1.0, -1.0, -1.0])[None], len(grid), axis=0)
    angles = joint_path(model, "tip", positions, upright, FIRST)
    return np.asarray(np.linalg.lstsq(_terms(grid), angles, rcond=None)[0], dtype=float)


def _terms(places: Array) -> Array:
    """The polynomial's terms (..., 15) at places (..., 2) [m]."""
    x = places[..., 0] - 0.5
    y = places[..., 1]
    return np.stack([x**i * y**j for i, j in POWERS], axis=-1)


def angles_at(model: mujoco.MjModel, places: Array) -> Array:
    """Joint angles that put the pin at places on the table.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with a site "tip".
    places : (n, 2) array
        Places on the table [m].

    Returns
    -------
    (n, 7) array
        Angles [rad], by a polynomial of fourth order in the places.
    """
    return _terms(places) @ _polynomial(model)


def start_states(model: mujoco.MjModel, boxes: Array) -> Array:
    """States at rest: the arm at its start, the boxes moved and turned.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with the box.
    boxes : (n, 3) array
        How far the boxes are moved in x and y [m] from the model's own place, and turned [rad].

    Returns
    -------
    (n, nq + nv) array
        States, `qpos` then `qvel`.
    """
    states = np.zeros((len(boxes), model.nq + model.nv))
    states[:, : model.nq] = reference_pose(model)
    states[:, :BOX] = angles_at(model, np.array(PLACE))
    states[:, BOX : BOX + 2] += boxes[:, :2]
    states[:, BOX + 3] = np.cos(boxes[:, 2] / 2)
    states[:, BOX + 6] = np.sin(boxes[:, 2] / 2)
    return states


class Arms:
    """What is commanded to n arms: joint angles, by accelerations within the arm's limits.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm.
    count : int
        Number of arms, n.
    control_step : float
        Duration of a control step [s].

    Attributes
    ----------
    angles : (n, 7) array
        Commanded joint angles [rad], the double integral of the joint accelerations.
    pins : (n, 2) array
        Commanded places of the pins [m].
    """

    def __init__(self, model: mujoco.MjModel, count: int, control_step: float):
        self._model = model
        self._step = control_step
        self.pins = np.tile(PLACE, (count, 1))
        self._pin_speeds = np.zeros((count, 2))
        self.angles = angles_at(model, self.pins)
        self._speeds = np.zeros((count, 7))

    def lead(self, ids: Ints, velocities: Array) -> None:
        """Move arms on by a control step, towards velocities of their pins.

        Parameters
        ----------
        ids : (m,) int array
            Which arms move.
        velocities : (m, 2) array
            Wanted velocities of their pins [m/s].
        """
        limit = ACCELERATION * self._step
        self._pin_speeds[ids] += np.clip(velocities - self._pin_speeds[ids], -limit, limit)
        self.pins[ids] += self._step * self._pin_speeds[ids]
        wanted = (angles_at(self._model, self.pins[ids]) - self.angles[ids]) / self._step
        self.accelerate(ids, (wanted - self._speeds[ids]) / self._step)

    def accelerate(self, ids: Ints, accelerations: Array) -> None:
        """Integrates joint accelerations, clipped at the arm's limits, over a control step.

        Parameters
        ----------
        ids : (m,) int array
            Which arms move.
        accelerations : (m, 7) array
            Joint accelerations [rad/s^2].
        """
        clipped = np.clip(accelerations, -JOINT_ACCELERATION, JOINT_ACCELERATION)
        self._speeds[ids] += self._step * clipped
        self.angles[ids] += self._step * self._speeds[ids]


def drive(
    model: mujoco.MjModel,
    pushing_policy: PushingPolicy,
    boxes: Array,
    steps: int,
    *,
    frame_skip: int,
    noise: float = 0.0,
    fields: Mapping[str, Array] | None = None,
    rng: np.random.Generator,
) -> Rollouts:
    """Rollouts n arms under a pushing policy.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with the box.
    pushing_policy : PushingPolicy
        Guides the pins.
    boxes : (n, 3) array
        How far the boxes are moved in x and y [m] from the model's own place, and turned [rad].
    steps : int
        Number of control steps.
    frame_skip : int
        Physics steps in a control step.
    noise : float
        Standard deviation [m, rad] with which the policy sees the boxes.
    fields : mapping or None
        Fields of the model (n, 1, ...) as in `closed_loop`, for the whole run.
    rng : numpy.random.Generator
        Source of that noise.

    Returns
    -------
    Rollouts
        Their actions are the joint angles commanded [rad].
    """
    arms = Arms(model, len(boxes), frame_skip * physics_step(model))
    errors = noise * rng.standard_normal((steps, len(boxes), 3))

    def policy(states: Array, ids: Ints, step: int) -> Array:
        measured = boxes_of(states) + errors[step, ids]
        arms.lead(ids, pushing_policy(measured, arms.pins[ids], ids, step))
        return arms.angles[ids]

    return closed_loop(
        model,
        policy,
        start_states(model, boxes),
        steps,
        frame_skip=frame_skip,
        fields=fields,
        hold=steps,
    )


def boxes_of(states: Array) -> Array:
    """Read where the boxes are.

    Parameters
    ----------
    states : (..., nq + nv) array
        States, `qpos` then `qvel`.

    Returns
    -------
    (..., 3) array
        x [m], y [m] and turn about the vertical axis [rad].
    """
    w, i, j, k = np.moveaxis(states[..., BOX + 3 : BOX + 7], -1, 0)
    turn = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
    return np.concatenate([states[..., BOX : BOX + 2], turn[..., None]], axis=-1)
