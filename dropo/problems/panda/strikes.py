"""Hits of an arm with a stick against a puck: joint trajectories from a two-dimensional latent,
speed and direction.
"""

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from dropo.core.services.validation import Array, check_shape
from dropo.problems.panda.reaching import joint_path

# [m/s] of the blade where it meets the puck, [rad] its direction from +y
SPEED = (0.4, 1.04)
SPREAD = (-0.35, 0.35)
LIMIT = 2.0  # latents lie within -2 and 2, their middle is 0
KNOTS = 17  # as in the thesis, whose actions are 17 commands of 7 joints
# [m] the blade moves: until it meets the puck, on at the same speed, and to rest
RUN_UP = 0.2
FOLLOW = 0.02
BRAKE = 0.08
RIM = 0.038  # [m] the puck's radius
FIRST = np.radians(
    [-30.0, -20.0, 0.0, 100.0, 0.0, -60.0, 0.0]
)  # a bent arm, from which the first pose is looked for


def speed_and_direction(latents: ArrayLike) -> tuple[Array, Array]:
    """[m/s] (n,) and [rad] (n,) of latents (n, 2), which are cut at -+ LIMIT."""
    unit = (np.clip(np.asarray(latents, dtype=float), -LIMIT, LIMIT) + LIMIT) / (2 * LIMIT)
    return SPEED[0] + np.ptp(SPEED) * unit[:, 0], SPREAD[0] + np.ptp(SPREAD) * unit[:, 1]


def hits(model: mujoco.MjModel, latents: ArrayLike, steps: int, control_step: float) -> Array:
    """Commanded joint angles (n, steps, 7) [rad] of n latents (n, 2).

    The blade starts behind the puck, turns into the direction while it speeds up smoothly, meets
    the puck's place at the speed, brakes and stays. Poses at 17 times are turned into angles, with
    cubic splines between.
    """
    latents = np.asarray(latents, dtype=float)
    check_shape("latents", latents, (None, 2), "hits")
    times = control_step * np.arange(1.0, steps + 1)
    return np.stack(
        [_hit(model, v, turn, times) for v, turn in zip(*speed_and_direction(latents), strict=True)]
    )


@lru_cache(maxsize=8)
def rest(model: mujoco.MjModel) -> Array:
    """(7,) the angles [rad] from which every hit starts."""
    positions, rotations = _poses(model.body("puck").pos, np.array([RUN_UP]), np.zeros(1))
    angles = joint_path(model, "blade", positions, rotations, FIRST)[0]
    angles.flags.writeable = False
    return angles


def _hit(model: mujoco.MjModel, speed: float, turn: float, times: Array) -> Array:
    begin = 2 * RUN_UP / speed
    on = FOLLOW / speed
    end = 2 * BRAKE / speed
    knots = np.linspace(0.0, begin + on + end, KNOTS)
    gone = speed * (
        _ramp(knots / begin) * begin
        + np.clip(knots - begin, 0, on)
        + end * _brake((knots - begin - on) / end)
    )
    turned = turn * _smooth(np.clip(1.4 * knots / begin, 0, 1))
    positions, rotations = _poses(model.body("puck").pos, RUN_UP - gone, turned)
    angles = joint_path(model, "blade", positions, rotations, rest(model))
    return np.asarray(CubicSpline(knots, angles, bc_type="clamped")(np.minimum(times, knots[-1])))


def _smooth(share: Array) -> Array:
    """From 0 to 1, flat at both ends."""
    return share * share * (3 - 2 * share)


def _ramp(share: Array) -> Array:
    """The integral of `_smooth` up to a share, 1/2 from 1 on."""
    share = np.clip(share, 0, 1)
    return share**3 - share**4 / 2


def _brake(share: Array) -> Array:
    """The integral of 1 - `_smooth`."""
    return np.clip(share, 0, 1) - _ramp(share)


def _poses(puck: Array, away: Array, turned: Array) -> tuple[Array, Array]:
    """The blade's positions (n, 3) and rotations (n, 3, 3), its face `away` (n,) [m] from the puck
    and turned (n,) [rad] from +y.
    """
    zero = np.zeros_like(turned)
    ahead = np.stack([-np.sin(turned), np.cos(turned), zero], axis=1)
    down = np.stack([zero, zero, zero - 1], axis=1)
    rotations = np.stack([np.cross(ahead, down), ahead, down], axis=2)
    return puck - (away[:, None] + RIM) * ahead, rotations
