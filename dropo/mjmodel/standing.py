"""Where a machine with a free base may stand: the points of its body that are nearest the ground.

The ground is a level plane, so that it does not matter where on it the machine is.
"""

from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import Joint, all_joints
from dropo.mjmodel.names import driven_joints

LEVEL = 0.999
"""Least cosine between the normal of a level plane and the vertical."""
ABOVE = 10.0
"""How high the base is held above the ground while distances are measured, in extents."""

UNKNOWN_BASE = (
    "The pose of the base {0!r} is not in the data, and its machine may touch the ground: contacts"
    " would be those of a machine that starts where the model stands. `dropo init` estimates the"
    " pose where a gyro, an accelerometer and all joints' angles are logged; else log it, or fix"
    " the base in the model if the machine hung on a stand."
)


@dataclass(frozen=True, eq=False)
class Footing:
    """k points that may stand on the ground, at n instants, seen from a site of the base.

    Attributes
    ----------
    places : (n, k, 3) array
        From the site to each point, in the base's axes [m].
    speeds : (n, k, 3) array
        Of each point as the joints move it, seen from the base, in its axes [m/s].
    heights : (n, k) array
        Of each point above the lowest one of its instant [m].
    """

    places: Array
    speeds: Array
    heights: Array


def floating_base(model: mujoco.MjModel) -> Joint | None:
    """Find the free joint of a machine: of the only free body that carries driven joints.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    Joint or None
        None where there is no such body, or several.
    """
    every = all_joints(model)
    driven = driven_joints(model)
    roots = {int(model.body_rootid[every[i].body]) for i in driven if i >= 0}
    free = [joint for joint in every if joint.kind == "free" and joint.body in roots]
    return free[0] if len(free) == 1 else None


def refuse_unknown_base(model: mujoco.MjModel, observed: Collection[int]) -> None:
    """Refuse data without the pose of a machine's base that may touch something.

    Every start would be where the model stands, whatever the machine did, and the contacts that
    follow from it would be taken for those that were measured.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    observed : collection of int
        Places of qpos that were observed.

    Raises
    ------
    Incompatible
        If nothing of the base's pose was observed, and its machine may touch what does not move.
    """
    name, places = _base_places(model)
    if not places or not places.isdisjoint(observed):
        return
    if any(_colliding(model, i) for i in _still_geoms(model)):
        raise Incompatible(UNKNOWN_BASE.format(name))


def _base_places(model: mujoco.MjModel) -> tuple[str, set[int]]:
    """The name of a floating base and its places in qpos: a free joint, or undriven ones of a body
    that hangs from the world by several and carries driven ones; none where nothing floats.
    """
    base = floating_base(model)
    if base is not None:
        return base.name, set(range(base.qpos, base.qpos + 7))
    every = all_joints(model)
    driven = {int(i) for i in driven_joints(model) if i >= 0}
    for root in sorted({int(model.body_rootid[every[i].body]) for i in driven}):
        own = [joint for joint in every if joint.body == root]
        plain = all(joint.kind in ("slide", "hinge") for joint in own)
        if len(own) > 1 and plain and driven.isdisjoint(joint.id for joint in own):
            return str(model.body(root).name), {joint.qpos for joint in own}
    return "", set()


def level_ground(model: mujoco.MjModel) -> int | None:
    """Find the level plane on which a model's machine stands.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    int or None
        The geom. None where there is none, several, or something else that does not move and that
        the machine may touch.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    still = [i for i in _still_geoms(model) if _colliding(model, i)]
    if len(still) != 1 or model.geom_type[still[0]] != mujoco.mjtGeom.mjGEOM_PLANE:
        return None
    normal = data.geom_xmat[still[0]].reshape(3, 3)[:, 2]
    pull = model.opt.gravity
    is_level = normal[2] > LEVEL and -pull[2] > LEVEL * float(np.linalg.norm(pull)) > 0
    return still[0] if is_level else None


def _still_geoms(model: mujoco.MjModel) -> list[int]:
    """The geoms that do not move."""
    return [i for i in range(model.ngeom) if model.body_weldid[model.geom_bodyid[i]] == 0]


def _colliding(model: mujoco.MjModel, ground: int) -> list[int]:
    """The geoms of moving bodies that may touch one that is still."""
    found = []
    for i in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[i]] == 0:
            continue
        own = int(model.geom_contype[i]) & int(model.geom_conaffinity[ground])
        other = int(model.geom_contype[ground]) & int(model.geom_conaffinity[i])
        if own or other:
            found.append(i)
    return found


def footing(
    model: mujoco.MjModel,
    ground: int,
    site: int,
    turns: Array,
    positions: Array,
    velocities: Array,
) -> Footing:
    """Find the points of a machine that are nearest the ground.

    Parameters
    ----------
    model : MjModel
        The compiled model, with a floating base.
    ground : int
        The geom on which it stands.
    site : int
        The site of the base from which points are seen.
    turns : (n, 4) array
        Quaternions of the base, the real part first.
    positions, velocities : (n, nq), (n, nv) arrays
        Of the joints; those of the base do not count [rad, m].

    Returns
    -------
    Footing
    """
    base = floating_base(model)
    assert base is not None
    geoms = _colliding(model, ground)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normal = data.geom_xmat[ground].reshape(3, 3)[:, 2].copy()
    high = data.geom_xpos[ground] + ABOVE * model.stat.extent * normal
    n = len(turns)
    places = np.zeros((n, len(geoms), 3))
    speeds = np.zeros((n, len(geoms), 3))
    heights = np.zeros((n, len(geoms)))
    jacobian = np.zeros((3, model.nv))
    ends = np.zeros(6)
    still = velocities.copy()
    still[:, base.qvel : base.qvel + 6] = 0.0
    for i in range(n):
        data.qpos[:] = positions[i]
        data.qpos[base.qpos : base.qpos + 3] = high
        data.qpos[base.qpos + 3 : base.qpos + 7] = turns[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        inward = data.xmat[base.body].reshape(3, 3).T
        for k, geom in enumerate(geoms):
            mujoco.mj_geomDistance(model, data, ground, geom, 1e3 * model.stat.extent, ends)
            point = ends[3:].copy()
            mujoco.mj_jac(model, data, jacobian, None, point, int(model.geom_bodyid[geom]))
            places[i, k] = inward @ (point - data.site_xpos[site])
            speeds[i, k] = inward @ (jacobian @ still[i])
            heights[i, k] = normal @ point
    heights -= heights.min(axis=1, keepdims=True)
    return Footing(places, speeds, heights)


def site_of(model: mujoco.MjModel, sensor: int) -> int | None:
    """Find the site on the floating base that a sensor stands on.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    sensor : int
        Its number.

    Returns
    -------
    int or None
        None where it stands elsewhere.
    """
    base = floating_base(model)
    if base is None or model.sensor_objtype[sensor] != mujoco.mjtObj.mjOBJ_SITE:
        return None
    site = int(model.sensor_objid[sensor])
    return site if model.site_bodyid[site] == base.body else None


def site_in_body(model: mujoco.MjModel, site: int) -> tuple[Array, Array]:
    """Return where a site is in its body.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    site : int
        Its number.

    Returns
    -------
    place : (3,) array
        In the body's frame [m].
    rotation : (3, 3) array
        From the site's axes.
    """
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.site_quat[site])
    return np.array(model.site_pos[site]), turn.reshape(3, 3)


def ground_height(model: mujoco.MjModel, ground: int) -> float:
    """Return the height of a level plane.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    ground : int
        The number of a level plane.

    Returns
    -------
    float
        In m.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return float(data.geom_xpos[ground][2])
