"""Machines whose first model lacks what every machine has; they are simulated four times finer.

The model has the kinematics and masses, and drives with a maker's gain. The machine has rotors,
dry and viscous friction, a payload, another gain and late commands. Only positions are measured.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.random import Generator

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator

STEP = 0.002  # [s] of the model's physics
FINER = 4  # physics steps of the machine in one of the model
CONTROL = 0.01  # [s]
TICK = 2 * np.pi / 16384  # [rad, m] of an encoder
NOISE = 1e-4  # [rad, m] of an encoder
SINES = 4  # in each command
Numbers = dict[tuple[str, str | None, str], float]
"""What a model lacks, by effect, place and quantity."""


@dataclass(frozen=True)
class Design:
    """A chain of bodies, each on one joint.

    Attributes
    ----------
    axes : tuple of str
        "hinge" or "slide" and the axis of each joint, such as "hinge y".
    lengths, masses : tuple of float
        Of each body [m], [kg].
    gains : tuple of float
        Of each drive: of a position servo [N m/rad, N/m]; of a motor, the torque of a whole command
        [N m, N].
    servos : bool
        Whether the drives are position servos, or motors.
    loaded : bool
        Whether a payload and a wrong gain are missing too. At a single joint no log can tell them
        from its rotor and from each other.
    along : tuple of str
        The axis along which each body extends; "z" of all of them where it is empty.
    rate : float
        What a servo gives against each rad/s, as a fraction of what it gives for each rad [s].
    coupled : bool
        Whether the last two joints are hinges of a differential: the last two drives pull tendons,
        one by the sum and one by the difference of the joints' angles.
    """

    axes: tuple[str, ...]
    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    gains: tuple[float, ...]
    servos: bool = True
    loaded: bool = True
    along: tuple[str, ...] = ()
    rate: float = 0.08
    coupled: bool = False


DESIGNS = {
    "arm, 3 joints": Design(
        ("hinge z", "hinge y", "hinge y"), (0.1, 0.4, 0.35), (1.5, 1.0, 0.6), (60.0, 60.0, 30.0)
    ),
    "arm, 6 joints": Design(
        ("hinge z", "hinge y", "hinge y", "hinge z", "hinge y", "hinge z"),
        (0.1, 0.4, 0.35, 0.1, 0.1, 0.08),
        (4.0, 8.0, 4.0, 1.5, 1.5, 0.4),
        (800.0, 800.0, 500.0, 120.0, 120.0, 60.0),
    ),
    "gantry with a wrist": Design(
        ("slide x", "slide y", "slide z", "hinge x"),
        (0.2, 0.2, 0.3, 0.15),
        (6.0, 3.0, 1.5, 0.5),
        (3000.0, 2000.0, 1500.0, 20.0),
    ),
    "gantry with a coupled wrist": Design(
        ("slide x", "slide y", "slide z", "hinge y", "hinge x"),
        (0.2, 0.2, 0.3, 0.15, 0.1),
        (6.0, 3.0, 1.5, 0.5, 0.4),
        (3000.0, 2000.0, 1500.0, 20.0, 20.0),
        coupled=True,
    ),
    "pendulum on a motor": Design(("hinge y",), (0.5,), (0.6,), (4.0,), servos=False, loaded=False),
    "two links on motors": Design(
        ("hinge y", "hinge y"), (0.3, 0.25), (0.8, 0.5), (5.0, 2.0), servos=False
    ),
}
"""The machines of the study, by name."""


@dataclass(frozen=True, eq=False)
class MissingNumbers:
    """What a machine has and its model lacks.

    Attributes
    ----------
    armature, damping, friction : (n,) arrays
        Of each joint.
    payload : float
        On the last body [kg].
    place : (3,) array
        Of the payload in the body's frame [m].
    gain : float or (n,) array
        What is added to the drives' gain, or to that of each, as a fraction of it.
    delay : float
        Of the commands [s].
    coupled : bool
        Whether the last two rotors and frictions are along tendons.
    """

    armature: Array
    damping: Array
    friction: Array
    payload: float
    place: Array
    gain: float | Array
    delay: float = 0.006
    coupled: bool = False

    def numbers(self) -> Numbers:
        """Give what is missing.

        Returns
        -------
        dict
            By effect, place and quantity.
        """
        found: Numbers = {}
        count = len(self.armature)
        for i in range(count):
            kind = "tendon" if self.coupled and i >= count - 2 else "joint"
            place = f"{kind}{i}"
            found[f"{kind}_armature", place, "armature"] = float(self.armature[i])
            found[f"{kind}_damping", place, "damping"] = float(self.damping[i])
            found[f"{kind}_friction", place, "frictionloss"] = float(self.friction[i])
        drive = "drive0" if len(self.armature) == 1 else None
        if isinstance(self.gain, float):
            found["actuator_gain", drive, "gain"] = self.gain
        else:
            for i, gain in enumerate(self.gain.tolist()):
                found["actuator_gain", f"drive{i}", "gain"] = gain
        found["actuator_delay", drive, "delay"] = self.delay
        found["payload", f"body{len(self.armature) - 1}", "mass"] = self.payload
        return {key: value for key, value in found.items() if value != 0}


def first_model(design: Design) -> mujoco.MjSpec:
    """Build the first model that an engineer would have of a machine.

    It has the kinematics and masses, and drives with a maker's gain.

    Parameters
    ----------
    design : Design
        The machine's chain of bodies.

    Returns
    -------
    mujoco.MjSpec
        With a joint "joint0", ... and a drive "drive0", ... for each body; tendons have the numbers
        of their drives.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP
    parent = spec.worldbody
    place = np.array([0.0, 0.0, 0.2])
    for i, axis in enumerate(design.axes):
        kind, letter = axis.split()
        end = design.lengths[i] * np.eye(3)["xyz".index(design.along[i] if design.along else "z")]
        end[1] += 0.02 * (i % 2)
        parent = parent.add_body(name=f"body{i}", pos=place)
        parent.add_joint(
            name=f"joint{i}",
            type=mujoco.mjtJoint.mjJNT_HINGE if kind == "hinge" else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=np.eye(3)["xyz".index(letter)],
        )
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[0.04, 0, 0],
            fromto=[0, 0, 0, *end],
            mass=design.masses[i],
            contype=0,
            conaffinity=0,
        )
        place = end
    count = len(design.gains)
    if design.coupled:
        for i, sign in ((count - 2, 1.0), (count - 1, -1.0)):
            tendon = spec.add_tendon(name=f"tendon{i}")
            tendon.wrap_joint(f"joint{count - 2}", 1.0)
            tendon.wrap_joint(f"joint{count - 1}", sign)
    for i, gain in enumerate(design.gains):
        by_tendon = design.coupled and i >= count - 2
        drive = spec.add_actuator(
            name=f"drive{i}", target=f"tendon{i}" if by_tendon else f"joint{i}"
        )
        drive.trntype = mujoco.mjtTrn.mjTRN_TENDON if by_tendon else mujoco.mjtTrn.mjTRN_JOINT
        if design.servos:
            drive.set_to_position(kp=gain, kv=design.rate * gain)
        else:
            drive.set_to_motor()
            drive.gainprm[0] = gain
    return spec


def random_machine(design: Design, rng: Generator) -> MissingNumbers:
    """Draw what a machine has and its model lacks, in plausible numbers.

    Parameters
    ----------
    design : Design
        The machine, with n joints.
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    MissingNumbers
        With numbers in proportion to the drives' gains, and a payload of half to twice the last
        body's mass.
    """
    gains = np.array(design.gains)
    n = len(gains)
    force = 1.0 if design.servos else 5.0  # motors of fewer newton metres have more friction
    return MissingNumbers(
        armature=gains * rng.uniform(2e-4, 8e-4, n) * force,
        damping=gains * rng.uniform(0.01, 0.03, n),
        friction=gains * rng.uniform(0.004, 0.012, n) * force,
        payload=float(design.masses[-1] * rng.uniform(0.5, 2.0)) * design.loaded,
        place=rng.uniform(-0.05, 0.05, 3) + np.array([0.0, 0.0, 0.08]),
        gain=float(rng.uniform(-0.25, -0.05)) * design.loaded,
        coupled=design.coupled,
    )


def nothing_missing(machine: MissingNumbers) -> MissingNumbers:
    """Let the commands come in time, for a model that has all the rest.

    Parameters
    ----------
    machine : MissingNumbers
        What the machine has.

    Returns
    -------
    MissingNumbers
        The same without delay.
    """
    return replace(machine, delay=0.0)


def built(spec: mujoco.MjSpec, machine: MissingNumbers) -> mujoco.MjSpec:
    """Build the machine itself: its model with all that is missing, at a finer physics step.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The first model, which is left as it is.
    machine : MissingNumbers
        What is missing; its delay is applied by `recorded`.

    Returns
    -------
    mujoco.MjSpec
        The machine, simulated `FINER` times finer than the model.
    """
    made = spec.copy()
    lines = list(made.joints)
    if machine.coupled:
        lines[-2:] = made.tendons
    for i, line in enumerate(lines):
        line.armature = machine.armature[i]
        line.damping = [machine.damping[i], 0, 0]
        line.frictionloss = machine.friction[i]
    if machine.payload:
        payload = made.bodies[-1].add_body(name="payload", pos=machine.place)
        payload.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[0.02, 0, 0],
            mass=machine.payload,
            contype=0,
            conaffinity=0,
        )
    factors = 1 + np.broadcast_to(machine.gain, len(made.actuators))
    for drive, factor in zip(made.actuators, factors, strict=True):
        drive.gainprm = drive.gainprm * factor
        drive.biasprm = drive.biasprm * factor
    made.option.timestep = STEP / FINER
    return made


def recorded(
    made: mujoco.MjSpec,
    servos: bool,
    delay: float,
    rng: Generator,
    *,
    seconds: float = 15.0,
    runs: int = 2,
) -> Trajectories:
    """Runs of a machine under sums of sines, its positions by encoders.

    Parameters
    ----------
    made : MjSpec
        The machine.
    servos : bool
        Whether commands are positions, or parts of a whole torque.
    delay : float
        Of the commands [s].
    rng : numpy.random.Generator
        Source of commands and noise.
    seconds : float
        Length of a run.
    runs : int
        How many.

    Returns
    -------
    Trajectories
        Positions before and after each control step, and commands.
    """
    count = round(seconds / CONTROL)
    commands = np.stack([_sines(len(made.actuators), count, servos, rng) for _ in range(runs)])
    return measured(made, commands, delay, rng)


def measured(
    made: mujoco.MjSpec,
    commands: Array,
    delay: float,
    rng: Generator,
    *,
    control: float = CONTROL,
    noise: float = NOISE,
    tick: float = TICK,
) -> Trajectories:
    """Positions of a machine by encoders, from rest at 0 under some commands.

    Parameters
    ----------
    made : MjSpec
        The machine.
    commands : (R, T, nu) array
        Of R runs of T control steps.
    delay : float
        Of the commands [s].
    rng : numpy.random.Generator
        Source of noise.
    control : float
        Control step [s].
    noise, tick : float
        Standard deviation and resolution of the encoders [rad, m].

    Returns
    -------
    Trajectories
        Positions before and after each control step, and commands.
    """
    simulator: MujocoSimulator = MujocoSimulator(
        made,
        [],
        observation=["qpos"],
        frame_skip=round(control / made.option.timestep),
        threads=1,
    )
    if delay:
        late = instances_of(simulator.effect_context, "actuator_delay")[-1]
        simulator = simulator.with_effects((), [(late, np.array([delay]))])
    runs, count, _ = commands.shape
    actions = np.concatenate(commands)
    rest = np.zeros((len(actions), simulator.model.nq))
    ends = np.arange(len(actions)) % count == count - 1
    data = Trajectories(rest, actions, rest, ends)
    segments = data.segments(count, every_step=True)
    after = simulator.predict(np.zeros((1, 0)), segments)[0].reshape(runs, count, -1)
    exact = np.concatenate([np.zeros((runs, 1, after.shape[2])), after], axis=1)
    read = np.round((exact + noise * rng.normal(size=exact.shape)) / tick) * tick
    return Trajectories(np.concatenate(read[:, :-1]), actions, np.concatenate(read[:, 1:]), ends)


def _sines(drives: int, count: int, servos: bool, rng: Generator) -> Array:
    """(count, drives) commands that begin at 0."""
    time = CONTROL * np.arange(count)
    size = 0.25 if servos else 0.5
    commands = np.zeros((count, drives))
    for i in range(drives):
        for _ in range(SINES):
            phase = 2 * np.pi * rng.uniform(0.1, 1.5) * time + rng.uniform(0, 2 * np.pi)
            commands[:, i] += size * rng.uniform(0.3, 1.0) * np.sin(phase)
    return commands - commands[0]


def problem_of(
    name: str, spec: mujoco.MjSpec, data: Trajectories, control: float = CONTROL
) -> Problem:
    """Put recorded motion together with the model that is to be diagnosed.

    Parameters
    ----------
    name : str
        The problem's name.
    spec : mujoco.MjSpec
        The model.
    data : Trajectories
        Positions and commands, as `recorded` gives them.
    control : float
        Control step [s].

    Returns
    -------
    Problem
        Without parameters to fit, on one thread.
    """
    frame_skip = round(control / spec.option.timestep)
    simulator = MujocoSimulator(spec, [], observation=["qpos"], frame_skip=frame_skip, threads=1)
    return Problem(name, simulator, data)
