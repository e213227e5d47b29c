"""Inverse kinematics: joint angles that bring a site of an arm to poses, one after another."""

import mujoco
import numpy as np

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array

ROUNDS = 50
DAMPING = 1e-4
EXACT = 1e-6  # [m, rad]


def joint_path(
    model: mujoco.MjModel, site: str, positions: Array, rotations: Array, first: Array
) -> Array:
    """(n, q) angles [rad] of the model's first q joints at which the site has the positions (n, 3)
    [m] and rotations (n, 3, 3).

    Each pose is solved from the one before it, the first from `first` (q,), by damped least
    squares: of all solutions of an arm with more joints than it needs, a near one. BadArgument
    where a pose is out of reach.
    """
    data = mujoco.MjData(model)
    place = model.site(site).id
    out = np.empty((len(positions), len(first)))
    angles = np.array(first, dtype=float)
    for i, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
        for _ in range(ROUNDS):
            error, slope = _error(model, data, place, angles, position, rotation)
            if np.abs(error).max() < EXACT:
                break
            angles = angles + slope.T @ np.linalg.solve(
                slope @ slope.T + DAMPING * np.eye(6), error
            )
        else:
            raise BadArgument(
                f"No angles bring the site {site!r} to pose {i} at "
                f"{np.round(position, 3)}: it is out of the arm's reach."
            )
        out[i] = angles
    return out


def _error(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    site: int,
    angles: Array,
    position: Array,
    rotation: Array,
) -> tuple[Array, Array]:
    """What is left to move and to turn (6,), and the site's Jacobian (6, q)."""
    data.qpos[: len(angles)] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
    now = data.site_xmat[site].reshape(3, 3)
    turn = 0.5 * np.cross(now.T, rotation.T).sum(axis=0)
    return np.concatenate([position - data.site_xpos[site], turn]), jacobian[:, : len(angles)]
