"""Numbers that change while the data are recorded."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, instances_of
from dropo.core.contracts.support.time_profile import growing, setting_in
from dropo.core.services.validation import Array

CHANGING = ("body_mass", "joint_damping", "joint_friction", "actuator_gain", "contact_friction")
"""Effects that change on real robots: payloads, warm grease, wear, batteries, dirt."""


def parameter_drift(context: EffectContext) -> Iterator[EffectInstance]:
    """A declared parameter, or a number of the model, that changes while the data are recorded.

    It changes "from" a moment on that is to be found, theta(t) = theta + d [t >= t*], or as a
    "ramp", theta(t) = theta + d r(t): t is how far into the data a segment begins, and r grows from
    0 to 1 in ten stages. The target is the parameter's name or the label of the effect that
    changes.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        The variants "from" and "ramp" for each declared parameter, and for each instance of the
        effects that can change in the course of the data.
    """
    for place, parameter in enumerate(context.parameters):
        width = parameter.high - parameter.low
        probes = tuple(fraction * width for fraction in (-0.1, -0.01, 0.01, 0.1))
        change = Quantity(parameter.name, parameter.unit, -width, width, probes)
        add = partial(_add, place, parameter.lower, parameter.upper)
        yield from _drifting(EffectInstance(parameter.name, None, (change,), declared=add))
    for effect in CHANGING:
        for instance in instances_of(context, effect):
            if instance.target is not None or effect == "contact_friction":
                yield from _drifting(instance)


def _drifting(instance: EffectInstance) -> Iterator[EffectInstance]:
    """The two ways in which an effect can change."""
    yield setting_in(instance)
    yield growing(instance)


def _add(place: int, lower: float, upper: float, values: Array, magnitudes: Array) -> Array:
    """Changes one value, within what is physically possible."""
    out = np.array(values)
    out[place] = np.clip(out[place] + magnitudes[0], lower, upper)
    return out
