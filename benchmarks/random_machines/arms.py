"""Arms whose logs come from equations of their own, with models that lack something of theirs."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from drawing import Numbers
from equations import GRAVITY, STEP, Arm, Equations
from hidden import NUMBERS
from numpy.random import Generator

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.strangers import sum_of_sines

CONTROL = 0.005
"""Control step, and that of the log [s]."""
PHYSICS = 0.0025
"""Physics step of the model [s]."""
SECONDS = 10.0
RUNS = 4
STEEPEST = 4000.0
"""Largest slope of dry friction over a joint's rotor [1/s]: the integration is stable with it."""
SLIDING = 0.3
"""Velocity at which 37 % of what more friction there is before joints slide are left [rad/s]."""
TICKS = 4096
"""Of an encoder, in a turn."""
LAWS = {"joint_armature": "rotor", "joint_damping": "damping", "joint_friction": "friction"}
"""What every joint has, and what it is called of an arm."""
AT_JOINTS = {
    **LAWS,
    "joint_stribeck": "sticking",
    "joint_load_friction": "share",
    "joint_stiffness": "spring",
}
AT_DRIVES = {"actuator_gain": "gain", "actuator_bias": "offset"}
OF_ALL = {"payload": "load", "actuator_delay": "late", "actuator_lag": "lag"}
NUMBERS_OF_ARMS = {
    **NUMBERS,
    "actuator_lag": "time constant",
    "actuator_bias": "bias",
    "joint_stiffness": "stiffness",
    "joint_stribeck": "friction",
    "joint_load_friction": "share",
}
"""The number that tells the size of each thing."""
COUNTS = (0.2, 0.5, 0.3)
"""How often none, one and two things are missing of a model that has the rest."""

Drawn = Callable[[Generator], tuple[Arm, Arm]]
"""Draws a machine and its model."""


def logged(seed: int, draw: Drawn) -> tuple[Problem, str, Numbers]:
    """Draw an arm, and log its motion.

    Parameters
    ----------
    seed : int
        Decides everything.
    draw : function
        `first_model` or `known_model`.

    Returns
    -------
    problem : Problem
        Of the model, with positions alone.
    drives : str
        Their kind.
    truth : dict
        By effect and place the size of what the model lacks.
    """
    rng = np.random.default_rng([seed, 51])
    arm, known = draw(rng)
    tick = 2 * np.pi / TICKS
    runs = [_moved(arm, tick, rng) for _ in range(RUNS)]
    read = [np.round(angles / tick) * tick for angles, _ in runs]
    count = len(read[0]) - 1
    trajectories = Trajectories(
        np.concatenate([one[:-1] for one in read]),
        np.concatenate([commands for _, commands in runs]),
        np.concatenate([one[1:] for one in read]),
        np.tile(np.arange(count) == count - 1, RUNS),
    )
    simulator = MujocoSimulator(
        _model(known), [], observation=["qpos"], frame_skip=round(CONTROL / PHYSICS), threads=1
    )
    drives = "position" if arm.servos else "motor"
    return Problem(f"arm-{seed}", simulator, trajectories), drives, missing(arm, known)


def missing(arm: Arm, known: Arm) -> Numbers:
    """Say what an arm has and its model lacks.

    Parameters
    ----------
    arm, known : Arm
        The machine, and what is known of it.

    Returns
    -------
    dict
        By effect and place the size.
    """
    last = len(arm.length) - 1
    found: Numbers = {}
    for kind, place in ((AT_JOINTS, "joint"), (AT_DRIVES, "drive")):
        for effect, name in kind.items():
            pairs = zip(getattr(arm, name), getattr(known, name), strict=True)
            found |= {(effect, f"{place}{i}"): own - had for i, (own, had) in enumerate(pairs)}
    of_drives = "drive0" if last == 0 else None
    for effect, name in OF_ALL.items():
        place = f"link{last}" if effect == "payload" else of_drives
        found[effect, place] = getattr(arm, name) - getattr(known, name)
    return {key: size for key, size in found.items() if size}


def first_model(rng: Generator) -> tuple[Arm, Arm]:
    """Draw an arm on servos whose model lacks rotor, damping and friction at every joint.

    In half of the cases each it also lacks a payload, and a delay of all commands.

    Parameters
    ----------
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    tuple of two Arm
        The machine, and its model.
    """
    arm = _drawn(rng)
    nothing = (0.0,) * len(arm.length)
    known = replace(arm, rotor=nothing, damping=nothing, friction=nothing, load=0.0, late=0.0)
    return arm, known


def known_model(rng: Generator) -> tuple[Arm, Arm]:
    """Draw an arm whose model has all of it but none, one or two things.

    Half of the arms are moved by torques that a controller beside the log commands; half of them
    have dry friction that the model has, too, in MuJoCo's way.

    Parameters
    ----------
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    tuple of two Arm
        The machine, and its model.
    """
    arm = replace(_drawn(rng), load=0.0, late=0.0, servos=bool(rng.random() < 0.5))
    if rng.random() < 0.5:
        arm = replace(arm, friction=(0.0,) * len(arm.length))
    known = arm
    effects = [*AT_JOINTS, *AT_DRIVES, *OF_ALL]
    count = rng.choice(len(COUNTS), p=COUNTS)
    for effect in rng.permutation(effects)[:count].tolist():
        arm = _with(arm, known, effect, rng)
    steepest = np.array(arm.friction) + arm.sticking + np.array(arm.share) * arm.largest
    turning = np.maximum(arm.turning, steepest / (STEEPEST * np.array(known.rotor)))
    return replace(arm, turning=tuple(turning.tolist())), known


def _with(arm: Arm, known: Arm, effect: str, rng: Generator) -> Arm:
    """An arm with one thing more, whose size suits what is known of it."""
    n = len(arm.length)
    at = int(rng.integers(n))
    heavy = known.largest[at] / 4
    sizes = {
        "rotor": known.rotor[at] * rng.uniform(0.6, 2.0),
        "damping": known.damping[at] * rng.uniform(0.5, 1.5),
        "friction": heavy * rng.uniform(0.05, 0.15),
        "sticking": heavy * rng.uniform(0.05, 0.15),
        "share": rng.uniform(0.08, 0.25),
        "spring": heavy * rng.uniform(0.2, 0.6),
        "gain": rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3),
        "offset": heavy * rng.uniform(0.05, 0.15) / (known.stiffness[at] if arm.servos else 1.0),
        "load": rng.uniform(0.08, 0.3),
        "late": STEP * int(rng.integers(12, 60)),
        "lag": rng.uniform(0.01, 0.04),
    }
    name = {**AT_JOINTS, **AT_DRIVES, **OF_ALL}[effect]
    size = float(sizes[name])
    if effect in OF_ALL:
        return replace(arm, **{name: getattr(arm, name) + size})
    changed = list(getattr(arm, name))
    changed[at] += size
    return replace(arm, **{name: tuple(changed)})


def _drawn(rng: Generator) -> Arm:
    """An arm of one to three links, whose friction is 5 to 15 % of the largest load, and so on."""
    n = int(rng.integers(1, 4))
    length = rng.uniform(0.12, 0.3, n)
    mass = rng.uniform(0.2, 0.8, n)
    centre = length * rng.uniform(0.35, 0.65, n)
    inertia = mass * length**2 / 12 * rng.uniform(0.8, 1.2, n)
    load = float(rng.uniform(0.08, 0.3)) if rng.random() < 0.5 else 0.0
    late = STEP * int(rng.integers(12, 60)) if rng.random() < 0.5 else 0.0
    heavy = np.array([_load(length, mass, centre, load, first) for first in range(n)])
    swung = np.array([_swung(length, mass, centre, inertia, load, first) for first in range(n)])
    stiffness = heavy * rng.uniform(6, 15, n)
    rotor = swung * rng.uniform(0.2, 0.8, n)
    critical = 2 * np.sqrt(stiffness * (swung + rotor))
    slowing = critical * rng.uniform(0.1, 0.3, n)
    damping = critical * rng.uniform(0.03, 0.15, n)
    friction = heavy * rng.uniform(0.05, 0.15, n)
    turning = np.maximum(rng.uniform(0.002, 0.01, n), friction / (STEEPEST * rotor))
    nothing = np.zeros(n)
    numbers = {
        "length": length,
        "mass": mass,
        "centre": centre,
        "inertia": inertia,
        "stiffness": stiffness,
        "slowing": slowing,
        "largest": 4 * heavy,
        "rotor": rotor,
        "damping": damping,
        "spring": nothing,
        "friction": friction,
        "sticking": nothing,
        "share": nothing,
        "turning": turning,
        "sliding": np.full(n, SLIDING),
        "gain": nothing,
        "offset": nothing,
    }
    return Arm(**{name: tuple(one.tolist()) for name, one in numbers.items()}, load=load, late=late)


def _load(length: Array, mass: Array, centre: Array, load: float, first: int) -> float:
    """The torque of gravity at a joint where all links from it on are level [N m]."""
    reach = np.cumsum(np.append(0.0, length[first:]))
    arms = reach[:-1] + centre[first:]
    return float(GRAVITY * (mass[first:] @ arms + load * reach[-1]))


def _swung(
    length: Array, mass: Array, centre: Array, inertia: Array, load: float, first: int
) -> float:
    """The moment of inertia about a joint where all links from it on are straight [kg m^2]."""
    reach = np.cumsum(np.append(0.0, length[first:]))
    arms = reach[:-1] + centre[first:]
    return float(mass[first:] @ arms**2 + inertia[first:].sum() + load * reach[-1] ** 2)


def _moved(arm: Arm, tick: float, rng: Generator) -> tuple[Array, Array]:
    """Angles (T + 1, n) of a run from rest, and the commands (T, n) in its steps."""
    n = len(arm.length)
    steps = round(SECONDS / CONTROL)
    time = CONTROL * np.arange(steps)
    sines = [sum_of_sines(time, 4, (0.1, 1.2), (0.2, 0.5), rng) for _ in range(n)]
    wanted = 0.5 * np.stack(sines, axis=1)
    controller = _Controller(arm, tick)
    equations = Equations(arm)
    every = round(CONTROL / STEP)
    late = round(arm.late / STEP)
    kept = 1 - np.exp(-STEP / arm.lag) if arm.lag else 1.0
    angles = [0.0] * n
    speeds = [0.0] * n
    acting = np.zeros(n)
    found = [angles]
    commands = np.zeros((steps, n))
    for step in range(steps):
        commands[step] = controller(wanted[step], np.array(angles))
        for part in range(every):
            at = (step * every + part - late) // every
            acting = acting + kept * ((commands[at] if at >= 0 else 0.0) - acting)
            angles, speeds = equations.step(angles, speeds, acting.tolist())
        found.append(angles)
    return np.array(found), commands


class _Controller:
    """What is commanded where an angle is wanted: the angle itself, or a torque."""

    def __init__(self, arm: Arm, tick: float) -> None:
        self.arm = arm
        self.tick = tick
        self.before = np.zeros(len(arm.length))

    def __call__(self, wanted: Array, angles: Array) -> Array:
        """The commands (n,) at some angles (n,), which are read by encoders."""
        arm = self.arm
        if arm.servos:
            return wanted
        read = np.round(angles / self.tick) * self.tick
        speed = (read - self.before) / CONTROL
        self.before = read
        torque = np.array(arm.stiffness) * (wanted - read) - np.array(arm.slowing) * speed
        return np.clip(torque, -np.array(arm.largest), arm.largest)


def _model(arm: Arm) -> mujoco.MjSpec:
    """MuJoCo's model of an arm, as far as that has what it is."""
    spec = mujoco.MjSpec()
    spec.option.timestep = PHYSICS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody
    above = 0.0
    for i, (m, c) in enumerate(arm.bodies):
        body = body.add_body(name=f"link{i}", pos=[0, 0, -above])
        above = arm.length[i]
        body.explicitinertial = True
        body.mass = m
        body.ipos = [0, 0, -c]
        body.inertia = [arm.inertia[i], arm.inertia[i], 0.1 * arm.inertia[i]]
        joint = body.add_joint(name=f"joint{i}", axis=[0, 1, 0])
        joint.armature = arm.rotor[i]
        joint.damping = [arm.damping[i], 0, 0]
        joint.frictionloss = arm.friction[i]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, 0, 0, -above], size=[0.02, 0, 0]
        )
        drive = spec.add_actuator(name=f"drive{i}", target=f"joint{i}")
        drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if arm.servos:
            drive.set_to_position(kp=arm.stiffness[i], kv=arm.slowing[i])
        drive.forcelimited = True
        drive.forcerange = [-arm.largest[i], arm.largest[i]]
    return spec
