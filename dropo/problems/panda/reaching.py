"""Inverse kinematics: joint angles that bring a site of an arm to poses, one after another."""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.mjmodel.appearance import posed
from dropo.mjmodel.kinematics import site_pose
from dropo.mjmodel.names import element_id


@dataclass(frozen=True)
class ReachingSettings:
    """How a pose is solved.

    Attributes
    ----------
    iterations : int
        Maximum number of steps for one pose.
    damping : float
        Damping of the least squares of a step.
    tolerance : float
        Largest error of a solved pose [m, rad].
    """

    iterations: int = 50
    damping: float = 1e-4
    tolerance: float = 1e-6


DEFAULT = ReachingSettings()


def joint_path(
    model: mujoco.MjModel,
    site: str,
    positions: Array,
    rotations: Array,
    first: Array,
    settings: ReachingSettings = DEFAULT,
) -> Array:
    """Joint angles that bring a site to poses, one after another.

    Each pose is solved by damped least squares from the angles of the one before it. Of all
    solutions of an arm with more joints than needed, this finds one nearby.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm, whose joints come first in `qpos`.
    site : str
        Name of the site.
    positions : (n, 3) array
        Positions of the site [m].
    rotations : (n, 3, 3) array
        Its rotation matrices.
    first : (q,) array
        Angles [rad] from which the first pose is solved; q joints move.
    settings : ReachingSettings
        Iterations, damping and tolerance.

    Returns
    -------
    (n, q) array
        Angles of the first q joints [rad].

    Raises
    ------
    BadArgument
        If a pose is out of reach.
    """
    data = posed(model)
    site_id = element_id(model, "site", site)
    out = np.empty((len(positions), len(first)))
    angles = np.array(first, dtype=float)
    for i, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
        for _ in range(settings.iterations):
            error, jacobian = _pose_error(model, data, site_id, angles, position, rotation)
            if np.abs(error).max() < settings.tolerance:
                break
            damped = jacobian @ jacobian.T + settings.damping * np.eye(6)
            angles = angles + jacobian.T @ np.linalg.solve(damped, error)
        else:
            raise BadArgument(
                f"No angles bring the site {site!r} to pose {i} at "
                f"{np.round(position, 3)}: it is out of the arm's reach."
            )
        out[i] = angles
    return out


def _pose_error(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    site: int,
    angles: Array,
    position: Array,
    rotation: Array,
) -> tuple[Array, Array]:
    """The remaining translation and rotation (6,), and the site's Jacobian (6, q)."""
    pose = site_pose(model, data, site, angles)
    turn = 0.5 * np.cross(pose.rotation.T, rotation.T).sum(axis=0)
    error = np.concatenate([position - pose.position, turn])
    return error, pose.jacobian[:, : len(angles)]
