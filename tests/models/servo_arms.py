"""Arms whose first model lacks what every machine has: the machine is simulated four times finer.

The model has the kinematics and masses, and servos with a maker's gain; the machine has rotors,
dry and viscous friction, a payload, another gain and late commands. Only angles are measured.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.simulators.mujoco.simulator import MujocoSimulator

STEP = 0.002
CONTROL = 0.01
TICK = 2 * np.pi / 16384
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
LENGTHS = (0.1, 0.4, 0.35, 0.1, 0.1, 0.08)
MASSES = {3: (1.5, 1.0, 0.6), 6: (4.0, 8.0, 4.0, 1.5, 1.5, 0.4)}
GAINS = {3: (60.0, 60.0, 30.0), 6: (800.0, 800.0, 500.0, 120.0, 120.0, 60.0)}


@dataclass(frozen=True)
class Machine:
    """What a machine has and its model lacks.

    Attributes
    ----------
    armature, damping, friction : (n,) arrays
        Of each joint.
    payload : float
        On the last link [kg].
    place : (3,) array
        Of the payload [m].
    gain : float
        What is added to the servos' gain, as a fraction.
    delay : float
        Of the commands [s].
    """

    armature: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    payload: float
    place: np.ndarray
    gain: float
    delay: float = 0.006


def arm(joints: int) -> mujoco.MjSpec:
    """The first model of an arm of 3 or 6 joints."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP
    parent = spec.worldbody
    place = np.array([0.0, 0.0, 0.2])
    for i in range(joints):
        end = np.array([0.0, 0.02 * (i % 2), LENGTHS[i]])
        parent = parent.add_body(name=f"link{i}", pos=place)
        parent.add_joint(name=f"joint{i}", axis=[float(x) for x in AXES[i].split()])
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[0.04, 0, 0],
            fromto=[0, 0, 0, *end],
            mass=MASSES[joints][i],
            contype=0,
            conaffinity=0,
        )
        place = end
    for i, kp in enumerate(GAINS[joints]):
        servo = spec.add_actuator(name=f"servo{i}", target=f"joint{i}")
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(kp=kp, kv=0.08 * kp)
    return spec


def machine(joints: int, rng: np.random.Generator) -> Machine:
    """A machine of plausible numbers."""
    kp = np.array(GAINS[joints])
    return Machine(
        armature=kp * rng.uniform(2e-4, 8e-4, joints),
        damping=kp * rng.uniform(0.01, 0.03, joints),
        friction=kp * rng.uniform(0.004, 0.012, joints),
        payload=float(MASSES[joints][-1] * rng.uniform(0.5, 2.0)),
        place=rng.uniform(-0.05, 0.05, 3) + np.array([0, 0, 0.08]),
        gain=float(rng.uniform(-0.25, -0.05)),
    )


def built(spec: mujoco.MjSpec, there: Machine) -> mujoco.MjSpec:
    """The machine itself, at a quarter of the model's step."""
    made = spec.copy()
    for i, joint in enumerate(made.joints):
        joint.armature = there.armature[i]
        joint.damping = [there.damping[i], 0, 0]
        joint.frictionloss = there.friction[i]
    last = made.bodies[-1]
    body = last.add_body(name="payload", pos=there.place)
    size = [0.02, 0, 0]
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    body.add_geom(type=ball, size=size, mass=there.payload, contype=0, conaffinity=0)
    for servo in made.actuators:
        servo.gainprm = servo.gainprm * (1 + there.gain)
        servo.biasprm = servo.biasprm * (1 + there.gain)
    made.option.timestep = STEP / 4
    return made


def recorded(
    made: mujoco.MjSpec,
    rng: np.random.Generator,
    *,
    delay: float = 0.006,
    seconds: float = 15.0,
    runs: int = 2,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Angles and commands (m, n) of some runs under sums of sines, with an encoder's errors."""
    model = made.compile()
    joints = model.nu
    fine = round(CONTROL / model.opt.timestep)
    late = round(delay / model.opt.timestep)
    logs = []
    for _ in range(runs):
        time = CONTROL * np.arange(round(seconds / CONTROL))
        commands = np.zeros((len(time), joints))
        for i in range(joints):
            for _ in range(4):
                phase = 2 * np.pi * rng.uniform(0.1, 1.5) * time + rng.uniform(0, 2 * np.pi)
                commands[:, i] += 0.25 * rng.uniform(0.3, 1.0) * np.sin(phase)
        commands -= commands[0]
        held = np.repeat(commands, fine, axis=0)
        held = np.concatenate([np.repeat(held[:1], late, axis=0), held])[: len(held)]
        data = mujoco.MjData(model)
        angles = np.empty((len(time), joints))
        for k in range(len(held)):
            if k % fine == 0:
                angles[k // fine] = data.qpos
            data.ctrl[:] = held[k]
            mujoco.mj_step(model, data)
        angles = angles + 1e-4 * rng.normal(size=angles.shape)
        logs.append((np.round(angles / TICK) * TICK, commands))
    return logs


def problem_of(spec: mujoco.MjSpec, logs: list[tuple[np.ndarray, np.ndarray]]) -> Problem:
    """The log with the model that is to be diagnosed; angles alone are observed."""
    simulator = MujocoSimulator(
        spec, [], observation=["qpos"], frame_skip=round(CONTROL / spec.option.timestep), threads=1
    )
    ends = [np.arange(len(angles) - 1) == len(angles) - 2 for angles, _ in logs]
    data = Trajectories(
        np.concatenate([angles[:-1] for angles, _ in logs]),
        np.concatenate([commands[:-1] for _, commands in logs]),
        np.concatenate([angles[1:] for angles, _ in logs]),
        np.concatenate(ends),
    )
    return Problem("arm", simulator, data)
