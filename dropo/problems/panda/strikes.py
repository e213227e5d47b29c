"""Strikes of an arm with a stick against a puck, from two latent numbers: speed and direction."""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from dropo.core.services.validation import Array, check_shape
from dropo.mjmodel.bodies import body_place
from dropo.mjmodel.names import element_id
from dropo.problems.panda.reaching import joint_path

LIMIT = 2.0  # latents lie within -2 and 2, their middle is 0
RIM = 0.038  # [m] the puck's radius
FIRST = np.radians([-30.0, -20.0, 0.0, 100.0, 0.0, -60.0, 0.0])
"""[rad] a bent arm, from which the first pose is solved."""


@dataclass(frozen=True)
class StrikeSettings:
    """How a latent becomes a motion of the blade.

    Attributes
    ----------
    speed : (float, float)
        Speeds of the blade where it meets the puck [m/s], at latents of -2 and 2.
    direction : (float, float)
        Directions from +y [rad], at latents of -2 and 2.
    run_up : float
        Distance that the blade moves until it meets the puck [m].
    follow : float
        Distance that it moves on at the same speed [m].
    brake : float
        Distance in which it comes to rest [m].
    knots : int
        Number of times at which poses are solved; 17 as in the thesis, whose actions are 17
        commands of 7 joints.
    """

    speed: tuple[float, float] = (0.4, 1.04)
    direction: tuple[float, float] = (-0.35, 0.35)
    run_up: float = 0.2
    follow: float = 0.02
    brake: float = 0.08
    knots: int = 17


DEFAULT = StrikeSettings()


def speed_and_direction(
    latents: ArrayLike, settings: StrikeSettings = DEFAULT
) -> tuple[Array, Array]:
    """Speeds and directions of strikes.

    Parameters
    ----------
    latents : (n, 2) array
        Latents, clipped at -2 and 2.
    settings : StrikeSettings
        The ranges of speed and direction.

    Returns
    -------
    speed : (n,) array
        Speed of the blade [m/s].
    direction : (n,) array
        Its direction from +y [rad].
    """
    unit = (np.clip(np.asarray(latents, dtype=float), -LIMIT, LIMIT) + LIMIT) / (2 * LIMIT)
    speed = settings.speed[0] + np.ptp(settings.speed) * unit[:, 0]
    direction = settings.direction[0] + np.ptp(settings.direction) * unit[:, 1]
    return speed, direction


def strikes(
    model: mujoco.MjModel,
    latents: ArrayLike,
    steps: int,
    control_step: float,
    settings: StrikeSettings = DEFAULT,
) -> Array:
    """Commanded joint angles of strikes.

    The blade starts behind the puck, turns into the direction while it speeds up smoothly, meets
    the puck's place at the speed, brakes and stays. Poses at the knots are turned into angles, with
    cubic splines between them.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with a site "blade", and a body "puck".
    latents : (n, 2) array
        Latents of speed and direction.
    steps : int
        Number of control steps.
    control_step : float
        Duration of a control step [s].
    settings : StrikeSettings
        How a latent becomes a motion.

    Returns
    -------
    (n, steps, 7) array
        Joint angles [rad].

    Raises
    ------
    BadArgument
        If `latents` are not of the shape (n, 2), or a pose is out of the arm's reach.
    """
    latents = np.asarray(latents, dtype=float)
    check_shape("latents", latents, (None, 2), "strikes")
    times = control_step * np.arange(1.0, steps + 1)
    speeds, directions = speed_and_direction(latents, settings)
    angles = []
    for speed, direction in zip(speeds, directions, strict=True):
        knots, at_knots = _strike(model, float(speed), float(direction), settings)
        path = CubicSpline(knots, at_knots, bc_type="clamped")
        angles.append(path(np.minimum(times, knots[-1])))
    return np.stack(angles)


@lru_cache(maxsize=8)
def rest(model: mujoco.MjModel, settings: StrikeSettings = DEFAULT) -> Array:
    """The joint angles from which every strike starts.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with a site "blade", and a body "puck".
    settings : StrikeSettings
        The distance at which the blade starts behind the puck.

    Returns
    -------
    (7,) array
        Angles [rad], read-only.

    Raises
    ------
    BadArgument
        If the pose is out of the arm's reach.
    """
    away = np.array([settings.run_up])
    positions, rotations = _poses(_puck(model), away, np.zeros(1))
    angles = joint_path(model, "blade", positions, rotations, FIRST)[0]
    angles.flags.writeable = False
    return angles


def _puck(model: mujoco.MjModel) -> Array:
    """Where the puck (3,) is at first [m]."""
    return body_place(model, element_id(model, "body", "puck"))


@lru_cache(maxsize=1024)
def _strike(
    model: mujoco.MjModel, speed: float, direction: float, settings: StrikeSettings
) -> tuple[Array, Array]:
    """Knots (k,) [s] of one strike and the joint angles (k, 7) [rad] there, read-only.

    Studies ask for the same strikes again and again.
    """
    # How long the blade speeds up, moves on at the speed, and brakes.
    run_up = 2 * settings.run_up / speed
    follow = settings.follow / speed
    brake = 2 * settings.brake / speed
    knots = np.linspace(0.0, run_up + follow + brake, settings.knots)
    travelled = speed * (
        _ramp(knots / run_up) * run_up
        + np.clip(knots - run_up, 0, follow)
        + brake * _brake((knots - run_up - follow) / brake)
    )
    turned = direction * _smooth(np.clip(1.4 * knots / run_up, 0, 1))
    away = settings.run_up - travelled
    positions, rotations = _poses(_puck(model), away, turned)
    angles = joint_path(model, "blade", positions, rotations, rest(model, settings))
    for array in (knots, angles):
        array.flags.writeable = False
    return knots, angles


def _smooth(fraction: Array) -> Array:
    """From 0 to 1, flat at both ends."""
    return fraction * fraction * (3 - 2 * fraction)


def _ramp(fraction: Array) -> Array:
    """The integral of `_smooth` up to a fraction, 1/2 from 1 on."""
    fraction = np.clip(fraction, 0, 1)
    return fraction**3 - fraction**4 / 2


def _brake(fraction: Array) -> Array:
    """The integral of 1 - `_smooth`."""
    return np.clip(fraction, 0, 1) - _ramp(fraction)


def _poses(puck: Array, away: Array, turned: Array) -> tuple[Array, Array]:
    """The blade's positions (n, 3) [m] and rotations (n, 3, 3).

    Its face is `away` (n,) [m] from the puck's rim and turned by `turned` (n,) [rad] from +y.
    """
    zero = np.zeros_like(turned)
    ahead = np.stack([-np.sin(turned), np.cos(turned), zero], axis=1)
    down = np.stack([zero, zero, zero - 1], axis=1)
    rotations = np.stack([np.cross(ahead, down), ahead, down], axis=2)
    return puck - (away[:, None] + RIM) * ahead, rotations
