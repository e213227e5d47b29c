"""What may be missing from the equation of motion, as columns of a regression."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import Model
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import Equation, independent_joints, model_of
from dropo.mjmodel.bodies import body_masses, inertia_matrix, mass_centre, moving_bodies
from dropo.mjmodel.dynamics.body_regressors import point_mass
from dropo.mjmodel.dynamics.drives import feedback_at
from dropo.mjmodel.dynamics.forces import linear_drives
from dropo.mjmodel.joints import Joint, actuators, numbers_of
from dropo.mjmodel.options import gravity, physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.tendons import FixedTendon, moved_by_tendons


@dataclass(frozen=True)
class LoneDrive:
    """A drive that acts at a joint alone, by a force that is linear in its command.

    Attributes
    ----------
    name : str
        What the model calls it.
    per_command : float
        Its force for a command of 1 [N, N m].
    """

    name: str
    per_command: float


@dataclass(frozen=True, eq=False)
class Term:
    """A number that may be missing: an effect's quantity at one place.

    Attributes
    ----------
    effect, target, variant : str
        The effect as `dropo list effects` names it; the target is None where it is global.
    quantity : str
        Its name in results.
    unit : str
        "1" for a number without one.
    lowest : float
        The number that is added to the model must not be below this.
    model : float or None
        The model's own number.
    least : float
        Below this size it is what the model's own physics step makes.
    family : str
        Terms of one family are one physical law at several places.
    column : (R, nv) array
        The force that one unit of it needs [N, N m].
    drive : LoneDrive or None
        The drive an offset of whose command is the same force.
    """

    effect: str
    target: str | None
    variant: str
    quantity: str
    unit: str
    lowest: float
    model: float | None
    least: float
    family: str
    column: Array
    drive: LoneDrive | None = None

    @property
    def label(self) -> str:
        """Such as "joint_damping:elbow"."""
        place = "" if self.target is None else f":{self.target}"
        variant = f".{self.variant}" if self.variant else ""
        return f"{self.effect}{place}{variant}"


LAWS = ("armature", "damping", "friction")
"""Families that every joint of a machine has: they are tried first, at all joints together."""
OWN_GAIN = "own gain"
"""The family of the drives' own gains beside the gain that all of them share."""
INERTIA = "inertia"
"""The family of the bodies' rotational inertias: beside rotors no motion tells most of them."""
INERTIAL = ("mass", "com", INERTIA)
"""Families of terms whose scale is that of the masses; those of one body are one candidate."""


def terms_of(
    simulator: RobotSimulator, equation: Equation, *, along_tendons: bool = True
) -> list[Term]:
    """List the terms of a robot but for the drives' common gain, delays and payloads.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    equation : Equation
        Its equation of motion along a log.
    along_tendons : bool
        Whether rotors and friction are along the tendons by which drives move joints, or at the
        joints.

    Returns
    -------
    list of Term
        The commonest first.
    """
    model = model_of(simulator)
    found: list[Term] = []
    along_tendons = along_tendons and not equation.by_joint
    by_tendon = moved_by_tendons(model) if along_tendons else frozenset()
    drives = _linear_in_command(model)
    for joint in independent_joints(simulator):
        own = _joint_terms(model, joint, equation, drives.get(joint.qvel))
        found += [term for term in own if joint.qvel not in by_tendon or term.family not in LAWS]
    for line, direction in zip(equation.tendons, equation.along_tendons.T, strict=True):
        if line.driven and along_tendons:
            found += _tendon_terms(line, direction, equation, physics_step(model))
    if equation.floating:  # the weight of a free base fixes the scale of each drive
        found += _gain_terms(model, equation)
    else:
        found += _own_gain_terms(model, equation)
    if np.any(gravity(model)):
        found += _tilt_terms(model, equation)
    for k, (body, name) in enumerate(moving_bodies(model)):
        found += _body_terms(model, body, name, equation.by_inertia[k])
    return [term for term in found if np.any(np.abs(term.column[equation.used]) > 0)]


def _joint_terms(
    model: Model, joint: Joint, equation: Equation, drive: LoneDrive | None
) -> list[Term]:
    """Rotor, friction, spring and offset of one joint, at which a drive may act alone."""
    dof = joint.qvel
    step = physics_step(model)
    kp, kv = feedback_at(model, joint)
    own = numbers_of(model, joint)

    def term(
        effect: str,
        quantity: str,
        unit: str,
        values: Array,
        family: str,
        *,
        base: float | None = None,
        bounded: bool = False,
        least: float = 0.0,
        variant: str = "",
        drive: LoneDrive | None = None,
    ) -> Term:
        lowest = -(base or 0.0) if bounded else -np.inf
        return Term(
            effect, joint.name, variant, quantity, unit, lowest, base, least, family, values, drive
        )

    found = [
        term(
            "joint_armature",
            "armature",
            joint.inertia,
            equation.column("acceleration", dof),
            "armature",
            base=own.armature,
            bounded=True,
            least=(kv + own.damping) * step / 2,
        ),
        term(
            "joint_damping",
            "damping",
            joint.damping,
            equation.column("velocity", dof),
            "damping",
            base=own.damping,
            bounded=True,
            least=kp * step / 2,
        ),
        term(
            "joint_friction",
            "frictionloss",
            joint.force,
            equation.column("direction", dof),
            "friction",
            base=own.friction,
            bounded=True,
        ),
        term(
            "joint_stiffness",
            "stiffness",
            joint.stiffness,
            equation.column("position", dof) - own.rest * equation.column("one", dof),
            "stiffness",
            base=own.stiffness,
            bounded=True,
        ),
        term(
            "joint_stiffness",
            "load",
            joint.force,
            -equation.column("one", dof),
            "offset",
            variant="rest",
            drive=drive,
        ),
    ]
    if equation.driven[dof] and not equation.floating:  # what contacts load is not known
        load = np.zeros_like(equation.load)
        load[:, dof] = equation.load[:, dof]
        share = term(
            "joint_load_friction",
            "share",
            "1",
            load,
            "load friction",
            base=0.0,
            bounded=True,
        )
        found.append(share)
    return found


def _tendon_terms(
    line: FixedTendon, direction: Array, equation: Equation, step: float
) -> list[Term]:
    """Rotor and friction along a tendon.

    direction: (R,) of its motion; step: of the physics [s].
    """
    tendon = line.tendon

    def term(quantity: str, unit: str, rows: Array, base: float, least: float) -> Term:
        effect = f"tendon_{'friction' if quantity == 'frictionloss' else quantity}"
        family = effect.removeprefix("tendon_")
        column = np.multiply.outer(rows, line.moments)
        return Term(effect, tendon.name, "", quantity, unit, -base, base, least, family, column)

    least = (line.feedback + line.damping) * step / 2
    acceleration = equation.acceleration @ line.moments
    velocity = equation.velocity @ line.moments
    return [
        term("armature", tendon.mass, acceleration, line.armature, least),
        term("damping", tendon.damping, velocity, line.damping, line.stiffness * step / 2),
        term("frictionloss", tendon.force, direction, line.friction, 0.0),
    ]


def _gain_terms(model: Model, equation: Equation) -> list[Term]:
    """The gain of each drive that acts at a joint alone."""
    found = []
    for name, dof in _lone_drives(model):
        column = -equation.column("drive", dof)
        found.append(_gain_term(name, "gain", column))
    return found


def _own_gain_terms(model: Model, equation: Equation) -> list[Term]:
    """The gain of each of several drives, beside the one that they share."""
    lone = _lone_drives(model)
    if len(lone) < 2:  # a drive by itself has no gain beside the common one
        return []
    found = []
    for name, dof in lone:
        column = np.zeros_like(equation.needed)
        column[:, dof] = -equation.drives[0, :, dof]
        found.append(_gain_term(name, OWN_GAIN, column))
    return found


def _gain_term(drive: str, family: str, column: Array) -> Term:
    """The gain of a drive, whose force at each row is that of the column with the other sign."""
    return Term("actuator_gain", drive, "", "gain", "1", -1.0, 1.0, 0.0, family, column)


def _lone_drives(model: Model) -> list[tuple[str, int]]:
    """The drives that act at a joint alone, with its degree of freedom."""
    drives = actuators(model)
    places = [drive.joint.id for drive in drives if drive.joint is not None]
    found = []
    for drive in drives:
        if drive.joint is not None and places.count(drive.joint.id) == 1:
            found.append((drive.name, drive.joint.qvel))
    return found


def _linear_in_command(model: Model) -> dict[int, LoneDrive]:
    """By its degree of freedom, each drive that acts at a joint alone, of the same force per
    command wherever it is.
    """
    two = np.array([[0.0], [1.0]])
    drives = linear_drives(model, two * np.ones(model.nq), two * np.ones(model.nv))
    found = {}
    for dof, places in drives.lone.items():
        place = places[0]
        here, there = (drives.gains[:, place] * drives.moments[place, dof]).tolist()
        if len(places) == 1 and here and here == there:
            found[dof] = LoneDrive(actuators(model)[place].name, here)
    return found


def _tilt_terms(model: Model, equation: Equation) -> list[Term]:
    """The direction of gravity, turned about the world's x and y axes."""
    down = gravity(model)
    found = []
    for axis, letter in enumerate("xy"):
        turned = np.cross(np.eye(3)[axis], down)
        column = equation.by_gravity @ turned
        found.append(
            Term("gravity_tilt", None, letter, letter, "rad", -np.inf, None, 0.0, "tilt", column)
        )
    return found


def _body_terms(model: Model, body: int, name: str, by_inertia: Array) -> list[Term]:
    """The mass of a body, its centre of mass, and its rotational inertia."""
    place = mass_centre(model, body)
    mass = float(body_masses(model)[body])
    found = [
        Term(
            "body_mass",
            name,
            "",
            "mass",
            "kg",
            -mass,
            mass,
            0.0,
            "mass",
            by_inertia @ point_mass(place),
        )
    ]
    for axis, letter in enumerate("xyz"):
        column = by_inertia @ (mass * point_mass_slope(place, np.eye(3)[axis]))
        found.append(
            Term(
                "body_com",
                name,
                letter,
                letter,
                "m",
                -np.inf,
                float(place[axis]),
                0.0,
                "com",
                column,
            )
        )
    turning = inertia_matrix(model, body)
    moments = [turning[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    column = by_inertia @ np.array([0.0, 0.0, 0.0, 0.0, *moments])
    return [
        *found,
        Term("body_inertia", name, "", "inertia", "1", -1.0, 1.0, 0.0, INERTIA, column),
    ]


def point_mass_slope(place: Array, axis: Array) -> Array:
    """Return the derivative of the inertial numbers of 1 kg by its place along an axis.

    Parameters
    ----------
    place : (3,) array
        In the body's frame [m].
    axis : (3,) array
        A unit vector in the body's frame.

    Returns
    -------
    (10,) array
        Per metre, as `dropo.mjmodel.dynamics.body_regressors.INERTIAL` orders them.
    """
    step = 1e-6
    return (point_mass(place + step * axis) - point_mass(place - step * axis)) / (2 * step)


def families_of(terms: Sequence[Term]) -> dict[str, tuple[int, ...]]:
    """Return the places of terms by family.

    Parameters
    ----------
    terms : sequence of Term
        The terms.

    Returns
    -------
    dict of str to tuple of int
        By the family's name, in the order in which the terms come.
    """
    found: dict[str, tuple[int, ...]] = {}
    for i, term in enumerate(terms):
        found[term.family] = (*found.get(term.family, ()), i)
    return found
