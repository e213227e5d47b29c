"""The one rule by which elements of a model are named."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import known

KINDS = ("free", "ball", "slide", "hinge")
"""The kinds of joints, in the order of MuJoCo's `mjtJoint`."""


def element_names(model: mujoco.MjModel, kind: str) -> dict[str, int]:
    """List the names of a model's elements of one kind, with their ids.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    kind : str
        "body", "joint", "actuator", "geom", "sensor" or another of MuJoCo's.

    Returns
    -------
    dict of str to int
        In the model's order. Every joint and actuator is there (see `joint_names` and
        `actuator_names`); elements of other kinds are left out where they have no name.
    """
    if kind == "joint":
        return {name: i for i, name in enumerate(joint_names(model))}
    if kind == "actuator":
        return {name: i for i, name in enumerate(actuator_names(model))}
    return {name: i for i, name in enumerate(_given(model, kind)) if name}


def element_id(model: mujoco.MjModel, kind: str, name: str) -> int:
    """Find an element by its name.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    kind : str
        "body", "joint", "actuator", "geom", "sensor" or another of MuJoCo's.
    name : str
        As `element_names` lists it.

    Returns
    -------
    int

    Raises
    ------
    UnknownName
        If there is none of that name; with the nearest valid one.
    """
    names = element_names(model, kind)
    return names[known(kind, name, names)]


def element_name(model: mujoco.MjModel, kind: str, index: int) -> str:
    """Name an element that MuJoCo may leave without a name.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    kind : str
        "body", "geom" or another of MuJoCo's.
    index : int
        Its id.

    Returns
    -------
    str
        Its own name, else kind and id, as in "body3".
    """
    found = mujoco.mj_id2name(model, _object(kind), index)
    return str(found) if found else f"{kind}{index}"


TYPES = (
    ("geom_type", mujoco.mjtGeom, "geom"),
    ("sensor_type", mujoco.mjtSensor, "sensor"),
    ("eq_type", mujoco.mjtEq, "equality"),
    ("actuator_trntype", mujoco.mjtTrn, "actuator"),
    ("actuator_dyntype", mujoco.mjtDyn, "actuator"),
    ("actuator_gaintype", mujoco.mjtGain, "actuator"),
    ("actuator_biastype", mujoco.mjtBias, "actuator"),
)
"""Fields that say of which type the elements of a kind are."""


def element_of_type(model: mujoco.MjModel, said: str) -> str:
    """Find the first element of a type that a message of MuJoCo's names.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    said : str
        The message, with the name of an enum's entry such as "mjGEOM_SDF".

    Returns
    -------
    str
        As in "geom 'ball'"; "the model" where no element is of such a type.
    """
    for field, types, kind in TYPES:
        for i, value in enumerate(getattr(model, field)):
            if types(int(value)).name in said:
                return f"{kind} {element_name(model, kind, i)!r}"
    return "the model"


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Name all joints, each differently, in the model's order.

    A joint without a name goes by its body's. Where a body has several of them, each is called by
    body, kind and the axis of the body's frame that it is along: "torso/slide_x", "torso/slide_z",
    "torso/hinge_y", "arm/ball". Where two would be called the same, or an axis is along none of the
    frame's, the joint's number among those of its body stands in place of the axis:
    "torso/hinge_2". Where the body has no name either, and where a name is taken already, it is
    "joint5" by its id.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of str
    """
    given = _given(model, "joint")
    taken = {name for name in given if name}
    names = list(given)
    for body in range(model.nbody):
        first = int(model.body_jntadr[body])
        own = range(first, first + int(model.body_jntnum[body]))
        unnamed = [joint for joint in own if not given[joint]]
        owner = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
        if not owner:
            wanted = [f"joint{joint}" for joint in unnamed]
        elif len(unnamed) == 1:
            wanted = [str(owner)]
        else:
            wanted = [f"{owner}/{axis}" for axis in _axes(model, unnamed)]
        for joint, name in zip(unnamed, wanted, strict=True):
            names[joint] = _free(name, f"joint{joint}", taken)
            taken.add(names[joint])
    return names


def actuator_names(model: mujoco.MjModel) -> list[str]:
    """Name all actuators, each differently, in the model's order.

    An actuator without a name goes by the joint that it alone drives, else it is "actuator2" by its
    id.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of str
    """
    given = _given(model, "actuator")
    taken = {name for name in given if name}
    joints = joint_names(model)
    driven = driven_joints(model)
    names = []
    for actuator, name in enumerate(given):
        joint = int(driven[actuator])
        number = f"actuator{actuator}"
        if not name:
            alone = joint >= 0 and int((driven == joint).sum()) == 1
            name = _free(joints[joint] if alone else number, number, taken)
            taken.add(name)
        names.append(name)
    return names


def driven_joints(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Find the joint of each actuator.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (nu,) array of int
        The joint's id, or -1 where the actuator drives none.
    """
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return np.where(on_joint, model.actuator_trnid[:, 0], -1).astype(np.int64)


def _given(model: mujoco.MjModel, kind: str) -> list[str]:
    """The names of all elements of one kind in the MJCF, "" where there is none."""
    counts = {
        "camera": "ncam",
        "equality": "neq",
        "material": "nmat",
        "actuator": "nu",
        "joint": "njnt",
    }
    count = getattr(model, counts.get(kind, f"n{kind}"))
    return [mujoco.mj_id2name(model, _object(kind), i) or "" for i in range(count)]


def _object(kind: str) -> mujoco.mjtObj:
    """MuJoCo's number of a kind of element."""
    return getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")


def _axes(model: mujoco.MjModel, joints: list[int]) -> list[str]:
    """What distinguishes the joints of a body: kind and axis, else kind and number."""
    found = []
    for joint in joints:
        kind = KINDS[int(model.jnt_type[joint])]
        along = np.flatnonzero(np.abs(model.jnt_axis[joint]) > 1 - 1e-9)
        number = joint - int(model.body_jntadr[model.jnt_bodyid[joint]])
        if kind == "ball":
            found.append((kind, f"{kind}_{number}"))
        elif len(along):
            found.append((f"{kind}_{'xyz'[along[0]]}", f"{kind}_{number}"))
        else:
            found.append((f"{kind}_{number}", f"{kind}_{number}"))
    first = [axis for axis, _ in found]
    return [axis if first.count(axis) == 1 else number for axis, number in found]


def _free(name: str, number: str, taken: set[str]) -> str:
    """The name where it is not taken, else the number, made longer until it is not taken."""
    while name in taken:
        name = number
        number = f"{number}_"
    return name
