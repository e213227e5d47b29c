"""Models of random machines: chains and trees of two to five links, on any kind of drive.

Axes stand in any direction, links are boxes and capsules off their joints, bases hang on walls and
ceilings; what depends on size (rotors, friction, the drives' force) is drawn in proportion to it.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.random import Generator

from dropo.core.services.validation import Array

STEP = 0.002
"""Physics step of the model [s]."""
DRIVES = {"position": 0.6, "motor": 0.25, "velocity": 0.15}
"""How often the drives of a machine are position servos, motors, or velocity servos."""
POSTURES = 30
"""Random postures of which the worst load decides the drives' force."""


@dataclass(frozen=True, eq=False)
class RandomDesign:
    """A machine as its model has it.

    Attributes
    ----------
    spec : mujoco.MjSpec
        Joints "joint0", ... of bodies "link0", ...; drives "drive0", ... of the joints of the same
        number, of which one may be missing.
    drives : str
        Their kind, one of `DRIVES`.
    forces : (n,) array
        A drive's force at each joint [N m, N].
    """

    spec: mujoco.MjSpec
    drives: str
    forces: Array


def random_design(rng: Generator) -> RandomDesign:
    """Draw a machine.

    Parameters
    ----------
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    RandomDesign
    """
    drives = str(rng.choice(list(DRIVES), p=list(DRIVES.values())))
    count = int(rng.integers(2, 6))
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    _add_links(spec, count, rng)
    undriven = int(rng.integers(1, count)) if drives != "velocity" and rng.random() < 0.2 else None
    if undriven is not None:
        spec.joints[undriven].type = mujoco.mjtJoint.mjJNT_HINGE
    inertia, load = _loads(spec, rng)
    forces = 3 * load + 15 * inertia
    for i, joint in enumerate(spec.joints):
        driven = i != undriven
        joint.armature = float(inertia[i] * rng.uniform(0.05, 0.4))
        joint.damping = [float(forces[i] * rng.uniform(0.005, 0.03) * (1 if driven else 0.2)), 0, 0]
        joint.frictionloss = float(forces[i] * rng.uniform(0.01, 0.04) * (1 if driven else 0.1))
        if driven:
            _add_drive(spec, i, drives, float(forces[i]), rng)
    return RandomDesign(spec, drives, forces)


def _add_links(spec: mujoco.MjSpec, count: int, rng: Generator) -> None:
    """Add a base and the links, in a chain or with a branch at the first."""
    turn = rng.normal(size=4) if rng.random() < 0.4 else np.array([1.0, 0.0, 0.0, 0.0])
    parent = spec.worldbody.add_body(name="base", pos=[0, 0, 1], quat=turn / np.linalg.norm(turn))
    place = np.zeros(3)
    branches = count > 2 and rng.random() < 0.25
    mass = np.exp(rng.uniform(np.log(0.2), np.log(8.0)))
    reach = rng.uniform(0.08, 0.4)
    first = (parent, place)
    for i in range(count):
        if branches and i == count - 1:
            parent, place = first
        axis = rng.normal(size=3) if rng.random() < 0.3 else np.eye(3)[rng.integers(3)]
        axis = axis / np.linalg.norm(axis)
        slides = rng.random() < 0.15
        length = reach * rng.uniform(0.6, 1.3) * 0.85**i
        end = rng.normal(size=3)
        if not slides:
            end = end - 0.7 * (end @ axis) * axis
        end = end * length / np.linalg.norm(end)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        parent = parent.add_body(name=f"link{i}", pos=place)
        parent.add_joint(name=f"joint{i}", type=kind, axis=axis)
        _add_shape(parent, end, length, float(mass * 0.7**i * rng.uniform(0.6, 1.4)), rng)
        place = end
        if i == 0:
            first = (parent, place)


def _add_shape(
    body: mujoco.MjsBody, end: Array, length: float, mass: float, rng: Generator
) -> None:
    """A capsule from the joint to the end, or a box between them; nothing collides."""
    shape = body.add_geom(mass=mass, contype=0, conaffinity=0)
    if rng.random() < 0.5:
        shape.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        shape.size = [0.15 * length, 0, 0]
        shape.fromto = [0, 0, 0, *end]
    else:
        shape.type = mujoco.mjtGeom.mjGEOM_BOX
        shape.size = length * rng.uniform(0.15, 0.5, 3)
        shape.pos = end / 2


def _loads(spec: mujoco.MjSpec, rng: Generator) -> tuple[Array, Array]:
    """Each joint's inertia at rest, and the largest load of gravity in random postures."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    load = np.zeros(model.nv)
    for _ in range(POSTURES):
        data.qpos[:] = rng.uniform(-1, 1, model.nq)
        mujoco.mj_forward(model, data)
        load = np.maximum(load, np.abs(data.qfrc_bias))
    return np.diagonal(inertia), load


def _add_drive(spec: mujoco.MjSpec, i: int, kind: str, force: float, rng: Generator) -> None:
    """A drive of joint i."""
    drive = spec.add_actuator(name=f"drive{i}", target=f"joint{i}")
    drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
    if kind == "position":
        drive.set_to_position(kp=force * rng.uniform(4, 12), kv=force * rng.uniform(0, 0.3))
    elif kind == "velocity":
        drive.set_to_velocity(kv=force * rng.uniform(1, 4))
    else:
        drive.set_to_motor()
        drive.gainprm[0] = force
