"""The equations of a hanging chain, which no simulator steps, by Runge and Kutta.

Dry friction is a tanh of the velocity, as gears have it, and not MuJoCo's constraint; drives and
friction act within a step, not from its start.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

Floats = tuple[float, ...]
STEP = 2.5e-4
"""Of the integration [s]."""
GRAVITY = 9.81


@dataclass(frozen=True)
class Arm:
    """A chain of n links that hang below each other.

    Attributes
    ----------
    length, mass, centre, inertia : tuple of n floats
        Of each link: its length [m], mass [kg], distance of its centre from its joint [m], and
        moment of inertia about that centre [kg m^2].
    stiffness, slowing, largest : tuple of n floats
        Of each drive's controller [N m/rad, N m s/rad], and its largest torque [N m].
    rotor, damping, spring : tuple of n floats
        Of each joint [kg m^2, N m s/rad, N m/rad].
    friction, sticking, share : tuple of n floats
        Dry friction [N m], what more of it there is before a joint slides [N m], and the fraction
        of the drive's torque that is friction, too.
    turning, sliding : tuple of n floats
        Velocities at which dry friction is 76 % of its size, and 37 % of `sticking` are left
        [rad/s].
    gain, offset : tuple of n floats
        The fraction by which each drive is stronger, and what is added to its command.
    load : float
        At the tip of the last link [kg].
    late, lag : float
        Dead time of the commands, a multiple of `STEP`, and time constant of their lag [s].
    servos : bool
        Whether commands are angles, and the controller the drive's own; else they are torques.
    """

    length: Floats
    mass: Floats
    centre: Floats
    inertia: Floats
    stiffness: Floats
    slowing: Floats
    largest: Floats
    rotor: Floats
    damping: Floats
    spring: Floats
    friction: Floats
    sticking: Floats
    share: Floats
    turning: Floats
    sliding: Floats
    gain: Floats
    offset: Floats
    load: float = 0.0
    late: float = 0.0
    lag: float = 0.0
    servos: bool = True

    @property
    def bodies(self) -> list[tuple[float, float]]:
        """Mass and centre of each link."""
        return list(zip(self.mass, self.centre, strict=True))


class Equations:
    """M(q) q'' = torques - C(q, q') - G(q), in angles of the links from the vertical."""

    def __init__(self, arm: Arm):
        self.arm = arm
        self.n = n = len(arm.length)
        # What a body i moves by where link j turns: its length if i is beyond it, or its centre.
        bodies = [(m, [*arm.length[:i], c]) for i, (m, c) in enumerate(arm.bodies)]
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
            drive = self._drive(a, q[a], v[a], command[a] + arm.offset[a])
            faster = (v[a] / arm.sliding[a]) ** 2
            dry = arm.friction[a] + arm.sticking[a] * math.exp(-faster) + arm.share[a] * abs(drive)
            right[a] += drive - arm.damping[a] * v[a] - arm.spring[a] * q[a]
            right[a] -= dry * math.tanh(v[a] / arm.turning[a])
        return _solved(of_joints, right)

    def _drive(self, joint: int, q: float, v: float, command: float) -> float:
        """The torque of a drive [N m]."""
        arm = self.arm
        torque = command
        if arm.servos:
            torque = arm.stiffness[joint] * (command - q) - arm.slowing[joint] * v
        torque *= 1 + arm.gain[joint]
        return max(-arm.largest[joint], min(arm.largest[joint], torque))


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
