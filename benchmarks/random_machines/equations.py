"""Arms that no simulator steps: the equations of a hanging chain, by Runge and Kutta.

Their dry friction is a tanh of the velocity, as gears have it, and not MuJoCo's constraint; drives
and friction act within a step, not from its start. The model has the right masses, lengths and
drives, and no friction, damping or rotor at any joint.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from drawing import Numbers
from numpy.random import Generator

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.strangers import sum_of_sines

STEP = 2.5e-4
"""Of the integration [s]."""
CONTROL = 0.005
"""Control step, and that of the log [s]."""
PHYSICS = 0.0025
"""Physics step of the model [s]."""
SECONDS = 10.0
RUNS = 4
GRAVITY = 9.81
STEEPEST = 4000.0
"""Largest slope of dry friction over a joint's rotor [1/s]: the integration is stable with it."""
TICKS = 4096
"""Of an encoder, in a turn."""


@dataclass(frozen=True)
class Arm:
    """A chain of n links that hang below each other, as its model has it, and what it has beside.

    Attributes
    ----------
    length, mass, centre, inertia : tuple of n floats
        Of each link: its length [m], mass [kg], distance of its centre from its joint [m], and
        moment of inertia about that centre [kg m^2].
    stiffness, slowing, largest : tuple of n floats
        Of each position servo [N m/rad, N m s/rad, N m].
    rotor, damping, friction : tuple of n floats
        Of each joint [kg m^2, N m s/rad, N m], none of which the model has.
    turning : tuple of n floats
        Velocity at which dry friction is 76 % of its size [rad/s].
    load : float
        At the tip of the last link [kg].
    late : float
        Of the commands [s], a multiple of `STEP`.
    """

    length: tuple[float, ...]
    mass: tuple[float, ...]
    centre: tuple[float, ...]
    inertia: tuple[float, ...]
    stiffness: tuple[float, ...]
    slowing: tuple[float, ...]
    largest: tuple[float, ...]
    rotor: tuple[float, ...]
    damping: tuple[float, ...]
    friction: tuple[float, ...]
    turning: tuple[float, ...]
    load: float
    late: float

    @property
    def truth(self) -> Numbers:
        """By effect and place the size of what is missing."""
        found: Numbers = {}
        parts = (self.rotor, self.damping, self.friction)
        for effect, sizes in zip(LAWS, parts, strict=True):
            for joint, size in enumerate(sizes):
                found[effect, f"joint{joint}"] = size
        if self.load:
            found["payload", f"link{len(self.length) - 1}"] = self.load
        if self.late:  # of the only drive, or of all
            found["actuator_delay", "drive0" if len(self.length) == 1 else None] = self.late
        return found


LAWS = ("joint_armature", "joint_damping", "joint_friction")
"""What every joint lacks."""


def stepped(seed: int) -> tuple[Problem, Numbers]:
    """Draw an arm, and log its motion.

    Parameters
    ----------
    seed : int
        Decides everything.

    Returns
    -------
    problem : Problem
        Of the model, with positions alone.
    truth : dict
        By effect and place the size of what the model lacks.
    """
    rng = np.random.default_rng([seed, 51])
    arm = _drawn(rng)
    runs = [_moved(arm, rng) for _ in range(RUNS)]
    tick = 2 * np.pi / TICKS
    read = [np.round(moved / tick) * tick for moved, _ in runs]
    count = len(read[0]) - 1
    trajectories = Trajectories(
        np.concatenate([one[:-1] for one in read]),
        np.concatenate([commands for _, commands in runs]),
        np.concatenate([one[1:] for one in read]),
        np.tile(np.arange(count) == count - 1, RUNS),
    )
    simulator = MujocoSimulator(
        _model(arm), [], observation=["qpos"], frame_skip=round(CONTROL / PHYSICS), threads=1
    )
    return Problem(f"equations-{seed}", simulator, trajectories), arm.truth


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
    numbers = (length, mass, centre, inertia, stiffness, slowing, 4 * heavy)
    numbers = (*numbers, rotor, damping, friction, turning)
    return Arm(*(tuple(one.tolist()) for one in numbers), load, late)


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


def _moved(arm: Arm, rng: Generator) -> tuple[Array, Array]:
    """Angles (T + 1, n) of a run from rest, and the commands (T, n) in its steps."""
    n = len(arm.length)
    steps = round(SECONDS / CONTROL)
    time = CONTROL * np.arange(steps)
    wanted = [sum_of_sines(time, 4, (0.1, 1.2), (0.2, 0.5), rng) for _ in range(n)]
    commands = 0.5 * np.stack(wanted, axis=1)
    equations = _Equations(arm)
    every = round(CONTROL / STEP)
    late = round(arm.late / STEP)
    angles = [0.0] * n
    speeds = [0.0] * n
    found = [angles]
    for step in range(steps):
        for part in range(every):
            at = (step * every + part - late) // every
            command = commands[at].tolist() if at >= 0 else [0.0] * n
            angles, speeds = equations.step(angles, speeds, command)
        found.append(angles)
    return np.array(found), commands


class _Equations:
    """M(q) q'' = torques - C(q, q') - G(q), in angles of the links from the vertical."""

    def __init__(self, arm: Arm):
        self.arm = arm
        self.n = n = len(arm.length)
        # What a body i moves by where link j turns: its length if i is beyond it, or its centre.
        bodies = [(m, [*arm.length[:i], c]) for i, (m, c) in enumerate(_bodies(arm))]
        bodies.append((arm.load, list(arm.length)))
        self.coupled = [[0.0] * n for _ in range(n)]
        self.weight = [0.0] * n
        for m, arms in bodies:
            for j, a in enumerate(arms):
                self.weight[j] += GRAVITY * m * a
                for k, b in enumerate(arms):
                    self.coupled[j][k] += m * a * b

    def step(
        self, q: Sequence[float], v: Sequence[float], command: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Angles and speeds after a step, by Runge and Kutta's fourth order."""
        h = STEP
        slopes = [(list(v), self.accelerations(q, v, command))]
        for part in (0.5, 0.5, 1.0):
            dq, dv = slopes[-1]
            there = [a + part * h * b for a, b in zip(q, dq, strict=True)]
            fast = [a + part * h * b for a, b in zip(v, dv, strict=True)]
            slopes.append((fast, self.accelerations(there, fast, command)))
        weights = (h / 6, h / 3, h / 3, h / 6)
        after = list(q)
        speed = list(v)
        for weight, (dq, dv) in zip(weights, slopes, strict=True):
            for i in range(self.n):
                after[i] += weight * dq[i]
                speed[i] += weight * dv[i]
        return after, speed

    def accelerations(
        self, q: Sequence[float], v: Sequence[float], command: Sequence[float]
    ) -> list[float]:
        """Of the joints [rad/s^2]."""
        arm = self.arm
        n = self.n
        angle = _sums(q)
        speed = _sums(v)
        # Of the links' own angles, then of the joints': a torque at a joint turns all links from
        # it on.
        matrix = [[0.0] * n for _ in range(n)]
        force = [0.0] * n
        for j in range(n):
            force[j] = -self.weight[j] * math.sin(angle[j])
            for k in range(n):
                apart = angle[j] - angle[k]
                matrix[j][k] = self.coupled[j][k] * math.cos(apart)
                force[j] -= self.coupled[j][k] * math.sin(apart) * speed[k] ** 2
            matrix[j][j] += arm.inertia[j]
        of_joints = [
            [sum(matrix[j][k] for j in range(a, n) for k in range(b, n)) for b in range(n)]
            for a in range(n)
        ]
        right = [sum(force[a:]) for a in range(n)]
        for a in range(n):
            of_joints[a][a] += arm.rotor[a]
            drive = arm.stiffness[a] * (command[a] - q[a]) - arm.slowing[a] * v[a]
            right[a] += max(-arm.largest[a], min(arm.largest[a], drive))
            right[a] -= arm.damping[a] * v[a] + arm.friction[a] * math.tanh(v[a] / arm.turning[a])
        return _solved(of_joints, right)


def _bodies(arm: Arm) -> list[tuple[float, float]]:
    """Mass and centre of each link."""
    return list(zip(arm.mass, arm.centre, strict=True))


def _sums(values: Sequence[float]) -> list[float]:
    """Running sums."""
    total = 0.0
    found = []
    for value in values:
        total += value
        found.append(total)
    return found


def _solved(matrix: list[list[float]], right: list[float]) -> list[float]:
    """Solve a small positive definite system by elimination, which overwrites it."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1, n):
            factor = matrix[j][i] / matrix[i][i]
            for k in range(i, n):
                matrix[j][k] -= factor * matrix[i][k]
            right[j] -= factor * right[i]
    for i in reversed(range(n)):
        right[i] = (right[i] - sum(matrix[i][k] * right[k] for k in range(i + 1, n))) / matrix[i][i]
    return right


def _model(arm: Arm) -> mujoco.MjSpec:
    """The model that has the links and the servos alone."""
    spec = mujoco.MjSpec()
    spec.option.timestep = PHYSICS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody
    above = 0.0
    for i, (m, c) in enumerate(_bodies(arm)):
        body = body.add_body(name=f"link{i}", pos=[0, 0, -above])
        above = arm.length[i]
        body.explicitinertial = True
        body.mass = m
        body.ipos = [0, 0, -c]
        body.inertia = [arm.inertia[i], arm.inertia[i], 0.1 * arm.inertia[i]]
        body.add_joint(name=f"joint{i}", axis=[0, 1, 0])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, 0, 0, -above], size=[0.02, 0, 0]
        )
        servo = spec.add_actuator(name=f"drive{i}", target=f"joint{i}")
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(kp=arm.stiffness[i], kv=arm.slowing[i])
        servo.forcelimited = True
        servo.forcerange = [-arm.largest[i], arm.largest[i]]
    return spec
