"""What a random machine has and its model lacks: none, one or two things."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from design import STEP, RandomDesign
from numpy.random import Generator

from dropo.core.services.validation import Array

FINER = 5
"""Physics steps of the machine in one of the model."""
NUMBERS = {
    "joint_armature": "armature",
    "joint_damping": "damping",
    "joint_friction": "frictionloss",
    "payload": "mass",
    "actuator_gain": "gain",
    "actuator_delay": "delay",
}
"""The number that tells the size of each thing that may be missing."""
COUNTS = (0.2, 0.5, 0.3)
"""How often none, one and two of them are."""


@dataclass(frozen=True, eq=False)
class Hidden:
    """One thing that a model lacks.

    Attributes
    ----------
    effect : str
        Its kind.
    place : str or None
        The joint, link or drive that has it.
    size : float
        Its number, added to the model's.
    position : (3,) array or None
        Where a payload is on its link [m].
    """

    effect: str
    place: str | None
    size: float
    position: Array | None = None


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine, and what its model lacks.

    Attributes
    ----------
    spec : mujoco.MjSpec
        Integrated `FINER` times finer than the model, by Runge and Kutta.
    delay : float
        Of the commands [s].
    hidden : sequence of Hidden
        What is missing.
    """

    spec: mujoco.MjSpec
    delay: float
    hidden: Sequence[Hidden]

    @property
    def truth(self) -> dict[tuple[str, str | None], float]:
        """By effect and place the size of what is missing."""
        return {(one.effect, one.place): one.size for one in self.hidden}


def random_machine(design: RandomDesign, rng: Generator) -> Machine:
    """Draw what is missing, and build the machine with it.

    Parameters
    ----------
    design : RandomDesign
        Its model.
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    Machine
    """
    count = rng.choice(len(COUNTS), p=COUNTS)
    effects = rng.permutation(list(NUMBERS))[:count].tolist()
    return built(design, [_drawn(design, effect, rng) for effect in effects])


def built(design: RandomDesign, hidden: Sequence[Hidden]) -> Machine:
    """Build the machine that has these things.

    Parameters
    ----------
    design : RandomDesign
        Its model.
    hidden : sequence of Hidden
        What it has beside.

    Returns
    -------
    Machine
    """
    spec = design.spec.copy()
    spec.option.timestep = STEP / FINER
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    for one in hidden:
        _add(spec, one)
    delay = sum(one.size for one in hidden if one.effect == "actuator_delay")
    return Machine(spec, delay, hidden)


def _drawn(design: RandomDesign, effect: str, rng: Generator) -> Hidden:
    """Something of a kind.

    Commands that are late by 4 to 20 ms; a drive that is stronger or weaker by 10 to 30 %; a point
    mass of 20 to 80 % of a link's, somewhere about its centre; a joint with more rotor, 0.6 to 2
    times the model's, or more friction: 2 to 6 % of the drive's force, dry, or viscous at 1 rad/s.
    """
    spec = design.spec
    if effect == "actuator_delay":
        step = STEP / FINER
        drives = spec.actuators
        place = drives[0].name if len(drives) == 1 else None
        return Hidden(effect, place, round(rng.uniform(0.004, 0.02) / step) * step)
    if effect == "actuator_gain":
        drive = spec.actuators[rng.integers(len(spec.actuators))]
        return Hidden(effect, drive.name, float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3)))
    if effect == "payload":
        links = [body for body in spec.bodies if body.name.startswith("link")]
        link = links[rng.integers(len(links))].name
        at_rest = spec.copy().compile().body(link)
        size = float(at_rest.mass[0] * rng.uniform(0.2, 0.8))
        return Hidden(effect, link, size, at_rest.ipos * rng.uniform(0.5, 2.0, 3))
    i = int(rng.integers(len(spec.joints)))
    joint = spec.joints[i]
    if effect == "joint_armature":
        return Hidden(effect, joint.name, float(joint.armature * rng.uniform(0.6, 2.0)))
    return Hidden(effect, joint.name, float(design.forces[i] * rng.uniform(0.02, 0.06)))


def _add(spec: mujoco.MjSpec, hidden: Hidden) -> None:
    """Write a thing into a machine; a delay is none of its body."""
    if hidden.effect == "actuator_gain":
        drive = spec.actuator(hidden.place)
        drive.gainprm = np.asarray(drive.gainprm) * (1 + hidden.size)
        drive.biasprm = np.asarray(drive.biasprm) * (1 + hidden.size)
    elif hidden.effect == "payload":
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        body = spec.body(hidden.place).add_body(name="extra", pos=hidden.position)
        body.add_geom(type=sphere, size=[0.01, 0, 0], mass=hidden.size, contype=0, conaffinity=0)
    elif hidden.effect == "joint_armature":
        spec.joint(hidden.place).armature += hidden.size
    elif hidden.effect == "joint_damping":
        joint = spec.joint(hidden.place)
        joint.damping = [joint.damping[0] + hidden.size, 0, 0]
    elif hidden.effect == "joint_friction":
        spec.joint(hidden.place).frictionloss += hidden.size
