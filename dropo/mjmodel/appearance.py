"""What a model looks like in some pose: outlines of its geoms, and where its elements are."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array
from dropo.mjmodel.names import element_names

SHOWN = 3
"""Groups of geoms that a viewer shows at first: those below this number."""
THICK = 0.03
"""Radius of the lines of a skeleton, as a fraction of the length of all links in a row."""
MOST = 400
"""Vertices of a mesh that are kept for its outline."""
KINDS = ("joint", "actuator", "body", "geom", "tendon", "site", "sensor")
"""Kinds of elements, in the order in which a name is looked up."""
FIRST = {
    "body": "body",
    "payload": "body",
    "external": "body",
    "wind": "body",
    "actuator": "actuator",
    "contact": "geom",
    "tendon": "tendon",
    "sensor": "sensor",
}
"""The kind that the target of an effect is first looked for among, by the effect's first word."""


@dataclass(frozen=True, eq=False)
class GeomOutline:
    """A geom in the world.

    Attributes
    ----------
    points : (n, 3) array
        Points whose hull it is [m]: one of a sphere, both ends of a capsule's axis.
    radius : float
        Around these points [m].
    ground : bool
        Whether it does not move.
    """

    points: Array
    radius: float
    ground: bool


def posed(model: mujoco.MjModel, qpos: Array | None = None) -> mujoco.MjData:
    """Place a model in a pose.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    qpos : (nq,) array, optional
        Joint positions; the model's own by default.

    Returns
    -------
    MjData
        With the places of everything.
    """
    data = mujoco.MjData(model)
    move(model, data, data.qpos.copy() if qpos is None else qpos)
    return data


def move(model: mujoco.MjModel, data: mujoco.MjData, qpos: Array) -> None:
    """Move data to joint positions, with the places of all elements.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        Changed in place.
    qpos : (nq,) array
        Joint positions.
    """
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)


def moving_geoms(model: mujoco.MjModel) -> NDArray[np.int64]:
    """List the ids of the geoms that are shown and can move.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (g,) array of int
        Ids in ascending order; those of bodies welded to the world are left out.
    """
    moving = [i for i in _shown(model) if model.body_weldid[model.geom_bodyid[i]] > 0]
    return np.array(moving, dtype=np.int64)


def part_places(model: mujoco.MjModel, poses: Array) -> Array:
    """Find where the parts of a robot are in some poses.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    poses : (N, nq) array
        Joint positions.

    Returns
    -------
    (N, g, 3) array
        Centres [m] of the geoms that move; of bodies and their masses where a model has no such.
    """
    geoms = moving_geoms(model)
    data = mujoco.MjData(model)
    out = []
    for qpos in poses:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        bodies = np.concatenate([data.xpos[1:], data.xipos[1:]])
        out.append(data.geom_xpos[geoms] if len(geoms) else bodies)
    return np.array(out)


def floats(model: mujoco.MjModel) -> bool:
    """Return whether a robot may go away from where it stands.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    bool
        True where it has a free joint, or two slides on one body.
    """
    kinds = np.asarray(model.jnt_type)
    slides = np.asarray(model.jnt_bodyid)[kinds == mujoco.mjtJoint.mjJNT_SLIDE]
    free = bool((kinds == mujoco.mjtJoint.mjJNT_FREE).any())
    return free or len(set(slides.tolist())) < len(slides)


def part_sizes(model: mujoco.MjModel) -> Array:
    """Return the radii of balls around the parts of `part_places`.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (g,) array
        In metres; of a model without geoms that are shown one size for all, by its reach.
    """
    geoms = moving_geoms(model)
    if len(geoms):
        return np.asarray(model.geom_rbound[geoms], dtype=float)
    return np.full(2 * (model.nbody - 1), THICK * _reach(model))


def skeleton(model: mujoco.MjModel, data: mujoco.MjData) -> list[GeomOutline]:
    """Return lines between the joints of a model whose bodies have no geoms to be seen.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        Of `posed`.

    Returns
    -------
    list of GeomOutline
        From every body to its parent, and to its centre of mass at the end of a chain; none where
        there are geoms.
    """
    if len(moving_geoms(model)):
        return []
    radius = THICK * _reach(model)
    out = []
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        still = bool(model.body_weldid[body] == 0)
        if parent:
            ends = np.stack([data.xpos[parent], data.xpos[body]])
            out.append(GeomOutline(ends, radius, still))
        if body not in model.body_parentid:
            ends = np.stack([data.xpos[body], data.xipos[body]])
            out.append(GeomOutline(ends, 0.7 * radius, still))
    return out


def _reach(model: mujoco.MjModel) -> float:
    """The length of all links in a row [m]."""
    lengths = np.linalg.norm(model.body_pos[2:], axis=1).sum()
    return max(float(lengths), float(np.linalg.norm(model.body_ipos[1:], axis=1).max()), 0.05)


def shapes(model: mujoco.MjModel, data: mujoco.MjData) -> list[GeomOutline]:
    """Return the geoms that a viewer shows, but for planes and height fields; else the skeleton.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        Of `posed`.

    Returns
    -------
    list of GeomOutline
    """
    out = skeleton(model, data)
    for i in _shown(model):
        local, radius = _outline(model, i)
        if local is None:
            continue
        points = data.geom_xpos[i] + local @ data.geom_xmat[i].reshape(3, 3).T
        out.append(GeomOutline(points, radius, model.body_weldid[model.geom_bodyid[i]] == 0))
    return out


def _shown(model: mujoco.MjModel) -> list[int]:
    """The geoms that a viewer shows at first, without planes; all where none is."""
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    solid = [i for i in range(model.ngeom) if model.geom_type[i] != plane]
    shown = [i for i in solid if model.geom_group[i] < SHOWN and model.geom_rgba[i, 3] > 0]
    return shown or solid


def _outline(model: mujoco.MjModel, i: int) -> tuple[Array | None, float]:
    """Points in a geom's frame, and the radius around them."""
    kind = mujoco.mjtGeom(int(model.geom_type[i]))
    size = np.asarray(model.geom_size[i], dtype=float)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.array([[0, 0, -size[1]], [0, 0, size[1]]]), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return corners * size, 0.0
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        ends = [np.column_stack([size[0] * circle, np.full(24, z)]) for z in (-size[1], size[1])]
        return np.concatenate(ends), 0.0
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        rings = [
            np.column_stack([np.cos(up) * circle, np.full(24, np.sin(up))])
            for up in np.linspace(-1.4, 1.4, 9)
        ]
        return np.concatenate(rings) * size, 0.0
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        start = int(model.mesh_vertadr[mesh])
        count = int(model.mesh_vertnum[mesh])
        vertices = model.mesh_vert[start : start + count : max(1, count // MOST)]
        return np.asarray(vertices, dtype=float), 0.0
    return None, 0.0


def element_places(
    model: mujoco.MjModel, data: mujoco.MjData, effect: str, target: str
) -> list[Array]:
    """Find where the target of an effect is.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        Of `posed`.
    effect : str
        The effect's name, which says among which elements the target is looked for first.
    target : str
        The name of an element, of a signal ("qpos.elbow"), or several joined by signs.

    Returns
    -------
    list of (3,) array
        Places [m]; none where nothing has such a name.
    """
    first = FIRST.get(effect.split("_")[0], "joint")
    kinds = (first, *(kind for kind in KINDS if kind != first))
    whole = _place(model, data, kinds, target)
    if whole is not None:
        return [whole]
    parts = [_place(model, data, kinds, part) for part in re.split(r"[\s,+&]+", target)]
    found = [place for place in parts if place is not None]
    if found or "." not in target:
        return found
    return element_places(model, data, effect, target.partition(".")[2])


def _place(
    model: mujoco.MjModel, data: mujoco.MjData, kinds: tuple[str, ...], name: str
) -> Array | None:
    """Where the first element of such a name is."""
    for kind in kinds:
        ids = element_names(model, kind)
        if name in ids:
            return _where(model, data, kind, ids[name])
    return None


def _where(model: mujoco.MjModel, data: mujoco.MjData, kind: str, i: int) -> Array | None:
    """Where one element is; None where it is in no one place."""
    if kind == "joint":
        return np.array(data.xanchor[i])
    if kind == "body":
        return np.array(data.xipos[i])
    if kind == "geom":
        return np.array(data.geom_xpos[i])
    if kind == "site":
        return np.array(data.site_xpos[i])
    if kind == "tendon":
        return _tendon(model, data, i)
    if kind == "actuator":
        named = {
            int(mujoco.mjtTrn.mjTRN_JOINT): "joint",
            int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): "joint",
            int(mujoco.mjtTrn.mjTRN_TENDON): "tendon",
            int(mujoco.mjtTrn.mjTRN_SITE): "site",
            int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "site",
            int(mujoco.mjtTrn.mjTRN_BODY): "body",
        }
        moved = named.get(int(model.actuator_trntype[i]))
        return (
            None if moved is None else _where(model, data, moved, int(model.actuator_trnid[i, 0]))
        )
    objects = {
        int(mujoco.mjtObj.mjOBJ_JOINT): "joint",
        int(mujoco.mjtObj.mjOBJ_BODY): "body",
        int(mujoco.mjtObj.mjOBJ_XBODY): "body",
        int(mujoco.mjtObj.mjOBJ_SITE): "site",
        int(mujoco.mjtObj.mjOBJ_GEOM): "geom",
        int(mujoco.mjtObj.mjOBJ_TENDON): "tendon",
        int(mujoco.mjtObj.mjOBJ_ACTUATOR): "actuator",
    }
    seen = objects.get(int(model.sensor_objtype[i]))
    return None if seen is None else _where(model, data, seen, int(model.sensor_objid[i]))


def _tendon(model: mujoco.MjModel, data: mujoco.MjData, i: int) -> Array | None:
    """The middle of what a tendon wraps: its joints, sites and geoms."""
    start = int(model.tendon_adr[i])
    count = int(model.tendon_num[i])
    kinds = {
        int(mujoco.mjtWrap.mjWRAP_JOINT): "joint",
        int(mujoco.mjtWrap.mjWRAP_SITE): "site",
        int(mujoco.mjtWrap.mjWRAP_SPHERE): "geom",
        int(mujoco.mjtWrap.mjWRAP_CYLINDER): "geom",
    }
    places = []
    for k in range(start, start + count):
        kind = kinds.get(int(model.wrap_type[k]))
        place = None if kind is None else _where(model, data, kind, int(model.wrap_objid[k]))
        if place is not None:
            places.append(place)
    return np.mean(places, axis=0) if places else None
