"""What else, at the place of a cause, whole motions do not tell from it."""

from collections.abc import Collection, Mapping

import mujoco

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.far_off.model import PAYLOAD
from dropo.diagnosis.laws.extension import padded, with_laws
from dropo.diagnosis.search.aliases import beside_numbers
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.trials import State
from dropo.mjmodel.bodies import moving_bodies
from dropo.mjmodel.joints import actuators, joints
from dropo.mjmodel.robot_simulator import RobotSimulator

OF_BODIES = (PAYLOAD, "body_mass", "body_com", "body_inertia")
"""What a body may have otherwise."""
OF_JOINTS = ("joint_armature", "joint_damping", "joint_friction", "joint_stiffness")
"""What a joint may have otherwise."""
OF_DRIVES = ("actuator_gain", "actuator_bias", "actuator_delay", "actuator_lag")
"""What a drive may have otherwise."""


def alike_in_motions(
    simulator: RobotSimulator,
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    named: Collection[str],
    alike: float,
) -> dict[str, Review]:
    """Compare named effects with usual ones of the same body, its joints and their drives.

    About a joint that is upright, a payload is nothing but inertia. What else a payload may be is
    known when it is fitted.

    Parameters
    ----------
    simulator : RobotSimulator
        Of the model as it came.
    library : Library
        With the effects that explain whole motions.
    last : State
        The model that explains them.
    reviews : mapping of str to Review
        By the label of each of its effects.
    named : collection of str
        The labels of those that are compared.
    alike : float
        Cosine of two responses, what the other numbers take up projected out, from which they are
        alike.

    Returns
    -------
    dict of str to Review
        With `others`, by a simulation of the windows to fit for each effect that is compared.
    """
    compared = [one for one in last.accepted if one.label in named and one.effect != PAYLOAD]
    places = _places(simulator.model, {one.target for one in compared if one.target is not None})
    taken = {one.label for one in last.accepted}
    offered = [
        one
        for name in (*OF_BODIES, *OF_JOINTS, *OF_DRIVES)
        for one in instances_of(simulator.effect_context, name)
        if one.target in places and one.label not in taken
    ]
    larger = with_laws(library, offered)
    whole = padded(last, larger)
    found = beside_numbers(larger, whole, reviews, compared, offered, alike)
    library.simulator.steps = larger.simulator.steps
    return found


def _places(model: mujoco.MjModel, targets: Collection[str]) -> set[str]:
    """The bodies that targets are, move or drive, with all their joints and drives."""
    names = dict(moving_bodies(model))
    found: dict[int, set[str]] = {body: {name} for body, name in names.items()}
    for joint in joints(model):
        found.setdefault(joint.body, set()).add(joint.name)
    for drive in actuators(model):
        if drive.joint is not None:
            found.setdefault(drive.joint.body, set()).add(drive.name)
    return {place for own in found.values() if own & set(targets) for place in own}
