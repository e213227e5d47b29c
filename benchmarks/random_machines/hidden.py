"""What a random machine has and its model lacks: none, one or two things."""

from dataclasses import dataclass

import mujoco
import numpy as np
from design import STEP, RandomDesign
from numpy.random import Generator

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
class Machine:
    """A machine, and what its model lacks.

    Attributes
    ----------
    spec : mujoco.MjSpec
        Integrated `FINER` times finer than the model, by Runge and Kutta.
    delay : float
        Of the commands [s].
    truth : dict
        By effect and place the size of what is missing.
    """

    spec: mujoco.MjSpec
    delay: float
    truth: dict[tuple[str, str | None], float]


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
    spec = design.spec.copy()
    spec.option.timestep = STEP / FINER
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    truth: dict[tuple[str, str | None], float] = {}
    delay = 0.0
    count = rng.choice(len(COUNTS), p=COUNTS)
    for effect in rng.permutation(list(NUMBERS))[:count].tolist():
        place: str | None
        if effect == "actuator_delay":
            place = None
            steps = round(rng.uniform(0.004, 0.02) / spec.option.timestep)
            size = delay = steps * spec.option.timestep
        elif effect == "actuator_gain":
            place, size = _change_a_gain(spec, rng)
        elif effect == "payload":
            place, size = _load_a_link(spec, rng)
        else:
            place, size = _change_a_joint(spec, effect, design, rng)
        truth[effect, place] = float(size)
    return Machine(spec, delay, truth)


def _change_a_gain(spec: mujoco.MjSpec, rng: Generator) -> tuple[str, float]:
    """A drive that is stronger or weaker by 10 to 30 %."""
    drive = spec.actuators[rng.integers(len(spec.actuators))]
    size = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3)
    drive.gainprm = np.asarray(drive.gainprm) * (1 + size)
    drive.biasprm = np.asarray(drive.biasprm) * (1 + size)
    return drive.name, size


def _load_a_link(spec: mujoco.MjSpec, rng: Generator) -> tuple[str, float]:
    """A point mass of 20 to 80 % of a link's, somewhere about its centre."""
    links = [body for body in spec.bodies if body.name.startswith("link")]
    link = links[rng.integers(len(links))]
    at_rest = spec.copy().compile().body(link.name)
    size = float(at_rest.mass[0] * rng.uniform(0.2, 0.8))
    payload = link.add_body(name="extra", pos=at_rest.ipos * rng.uniform(0.5, 2.0, 3))
    payload.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=size, contype=0, conaffinity=0
    )
    return link.name, size


def _change_a_joint(
    spec: mujoco.MjSpec, effect: str, design: RandomDesign, rng: Generator
) -> tuple[str, float]:
    """A joint with more rotor, 0.6 to 2 times the model's, or more friction: 2 to 6 % of the
    drive's force, dry, or viscous at 1 rad/s.
    """
    i = int(rng.integers(len(spec.joints)))
    joint = spec.joints[i]
    if effect == "joint_armature":
        size = joint.armature * rng.uniform(0.6, 2.0)
        joint.armature += size
    else:
        size = design.forces[i] * rng.uniform(0.02, 0.06)
        if effect == "joint_damping":
            joint.damping = [joint.damping[0] + size, 0, 0]
        else:
            joint.frictionloss += size
    return joint.name, size
