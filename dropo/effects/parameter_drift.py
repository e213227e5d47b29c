"""Numbers that change while the data are recorded."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import Atom, Quantity, Robot
from dropo.core.contracts.time_profile import growing, setting_in
from dropo.core.services.validation import Array
from dropo.effects.actuator_gain import actuator_gain
from dropo.effects.body_mass import body_mass
from dropo.effects.contact_friction import contact_friction
from dropo.effects.joint_damping import joint_damping
from dropo.effects.joint_friction import joint_friction

CHANGING = (body_mass, joint_damping, joint_friction, actuator_gain, contact_friction)
"""What changes on machines: payloads, grease that warms up, wear, batteries, dirt."""


def parameter_drift(robot: Robot) -> Iterator[Atom]:
    """A declared parameter, or a number of the model, that changes: "from" a moment on that is to be found, or as a "ramp".

    theta(t) = theta + d [t >= t*] or theta + d r(t), with t how far into the data a segment begins and r from 0 to 1 in ten
    stages. The target is the parameter's name or the label of the effect that sets in.
    """
    for place, parameter in enumerate(robot.parameters):
        width = parameter.high - parameter.low
        probes = tuple(share * width for share in (-0.1, -0.01, 0.01, 0.1))
        size = Quantity(parameter.name, parameter.unit, -width, width, probes)
        yield from _drifting(Atom(parameter.name, None, (size,), declared=partial(_add, place, parameter.lower, parameter.upper)))
    for effect in CHANGING:
        for atom in effect(robot):
            if atom.target is not None or effect is contact_friction:
                yield from _drifting(atom)


def _drifting(atom: Atom) -> Iterator[Atom]:
    yield setting_in(atom)
    yield growing(atom)


def _add(place: int, lower: float, upper: float, values: Array, sizes: Array) -> Array:
    """The value with its change, within what is physically possible."""
    out = np.array(values)
    out[place] = np.clip(out[place] + sizes[0], lower, upper)
    return out
