"""Where bodies and sites are, and how that changes with the joints."""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.contracts.effect import StepState
from dropo.core.services.validation import Array


def centre_motion(state: StepState, body: int) -> tuple[Array, Array]:
    """Find the centre of mass of a body in n simulations, and how it follows their joints.

    Parameters
    ----------
    state : StepState
        n simulations at one physics step.
    body : int
        The body's id.

    Returns
    -------
    points : (n, 3) array
        Places of its centre of mass in the world [m].
    jacobians : (n, 3, nv) array
        d velocity / d qvel.
    """
    data = mujoco.MjData(state.model)
    jacobians = np.zeros((len(state.qpos), 3, state.model.nv))
    points = np.zeros((len(state.qpos), 3))
    for i in range(len(points)):
        data.qpos[:] = state.qpos[i]
        mujoco.mj_kinematics(state.model, data)
        mujoco.mj_comPos(state.model, data)
        mujoco.mj_jacBodyCom(state.model, data, jacobians[i], None, body)
        points[i] = data.xipos[body]
    return points, jacobians


@dataclass(frozen=True, eq=False)
class SitePose:
    """Where a site is.

    Attributes
    ----------
    position : (3,) array
        In the world [m].
    rotation : (3, 3) array
        From its own axes to the world's.
    jacobian : (6, nv) array
        Of its velocity and angular velocity.
    """

    position: Array
    rotation: Array
    jacobian: Array


def site_pose(model: mujoco.MjModel, data: mujoco.MjData, site: int, positions: Array) -> SitePose:
    """Find where a site is.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        Of the model; is changed in place.
    site : int
        The site's id.
    positions : (q,) array
        The first q joint positions [m, rad]; others are as in `data`.

    Returns
    -------
    SitePose
    """
    data.qpos[: len(positions)] = positions
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
    rotation = data.site_xmat[site].reshape(3, 3)
    return SitePose(data.site_xpos[site].copy(), rotation.copy(), jacobian)
