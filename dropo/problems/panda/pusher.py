"""An arm that leads a pin over a table by joint accelerations, and whoever leads it."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Protocol

import mujoco
import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.problems.panda.reaching import joint_path
from dropo.simulators.mujoco.closed_loop import Rollouts, closed_loop

HEIGHT = 0.04  # [m] of the pin's tip above the table
FIRST = np.array(
    [0.1, 0.2, -0.1, -2.6, 0.0, 2.8, 0.0]
)  # [rad] a bent arm, from which poses are looked for
PLACE = (0.34, 0.0)  # [m] where the pin starts
ACCELERATION = 3.0  # [m/s^2] of the pin at most
JOINT_ACCELERATION = np.array(
    [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]
)  # [rad/s^2] the Panda's own limits
POWERS = [(i, j) for i in range(5) for j in range(5 - i)]
# [m] the part of the table that the pin can reach
X = np.linspace(0.32, 0.76, 12)
Y = np.linspace(-0.16, 0.16, 9)
BOX = 7  # where the box' seven numbers begin in qpos, behind the joints


class PushingPolicy(Protocol):
    """What leads the pins of n arms: wanted velocities (m, 2) [m/s] from boxes (m, 3), x [m], y
    [m], turn [rad], and pins (m, 2) [m].
    """

    def __call__(self, boxes: Array, pins: Array, ids: Ints, step: int) -> Array: ...


@lru_cache(maxsize=8)
def _polynomial(model: mujoco.MjModel) -> Array:
    """(15, 7) coefficients of the joint angles over the table, of fourth order, with the pin
    upright.
    """
    grid = np.array([(x, y) for i, x in enumerate(X) for y in (Y if i % 2 else Y[::-1])])
    positions = np.column_stack([grid, np.full(len(grid), HEIGHT)])
    upright = np.repeat(np.diag([1.0, -1.0, -1.0])[None], len(grid), axis=0)
    angles = joint_path(model, "tip", positions, upright, FIRST)
    return np.asarray(np.linalg.lstsq(_terms(grid), angles, rcond=None)[0], dtype=float)


def _terms(places: Array) -> Array:
    x = places[..., 0] - 0.5
    y = places[..., 1]
    return np.stack([x**i * y**j for i, j in POWERS], axis=-1)


def angles_at(model: mujoco.MjModel, places: Array) -> Array:
    """(n, 7) joint angles [rad] that put the pin at places (n, 2) [m] on the table."""
    return _terms(places) @ _polynomial(model)


def start_states(model: mujoco.MjModel, boxes: Array) -> Array:
    """(n, nq + nv) at rest: the arm at its start, the boxes (n, 3) where they are said to be."""
    states = np.zeros((len(boxes), model.nq + model.nv))
    states[:, : model.nq] = model.qpos0
    states[:, :BOX] = angles_at(model, np.array(PLACE))
    states[:, BOX : BOX + 2] += boxes[:, :2]
    states[:, BOX + 3], states[:, BOX + 6] = np.cos(boxes[:, 2] / 2), np.sin(boxes[:, 2] / 2)
    return states


class Arms:
    """What is commanded to n arms: angles (n, 7) [rad], the double integral of joint accelerations
    within their limits.
    """

    def __init__(self, model: mujoco.MjModel, count: int, control_step: float):
        self._model = model
        self._step = control_step
        self.pins = np.tile(PLACE, (count, 1))
        self._pin_speeds = np.zeros((count, 2))
        self.angles = angles_at(model, self.pins)
        self._speeds = np.zeros((count, 7))

    def lead(self, ids: Ints, velocities: Array) -> None:
        """Moves the arms `ids` on by a control step, towards velocities (m, 2) [m/s] of their pins."""
        change = np.clip(
            velocities - self._pin_speeds[ids],
            -ACCELERATION * self._step,
            ACCELERATION * self._step,
        )
        self._pin_speeds[ids] += change
        self.pins[ids] += self._step * self._pin_speeds[ids]
        wanted = (angles_at(self._model, self.pins[ids]) - self.angles[ids]) / self._step
        self.accelerate(ids, (wanted - self._speeds[ids]) / self._step)

    def accelerate(self, ids: Ints, accelerations: Array) -> None:
        """Integrates joint accelerations (m, 7) [rad/s^2], cut at the arm's limits, over a control
        step.
        """
        self._speeds[ids] += self._step * np.clip(
            accelerations, -JOINT_ACCELERATION, JOINT_ACCELERATION
        )
        self.angles[ids] += self._step * self._speeds[ids]


def drive(
    model: mujoco.MjModel,
    hand: PushingPolicy,
    boxes: Array,
    steps: int,
    *,
    frame_skip: int,
    noise: float = 0.0,
    fields: Mapping[str, Array] | None = None,
    rng: np.random.Generator,
) -> Rollouts:
    """n arms led by a hand for so many control steps, from boxes (n, 3) moved and turned away from
    the model's own place.

    noise: sd [m, rad] with which the hand sees the boxes; fields: (n, 1, ...) as in `closed_loop`,
    for the whole run. The runs' actions are the angles commanded.
    """
    arms = Arms(model, len(boxes), frame_skip * float(model.opt.timestep))
    errors = noise * rng.standard_normal((steps, len(boxes), 3))

    def policy(states: Array, ids: Ints, step: int) -> Array:
        arms.lead(ids, hand(boxes_of(states) + errors[step, ids], arms.pins[ids], ids, step))
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
    """x [m], y [m] and turn [rad] (..., 3) of the boxes in states (..., nq + nv)."""
    w, i, j, k = np.moveaxis(states[..., BOX + 3 : BOX + 7], -1, 0)
    turn = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
    return np.concatenate([states[..., BOX : BOX + 2], turn[..., None]], axis=-1)
