"""The gain of an actuator."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import each_and_all
from dropo.mjmodel.joints import actuators


def actuator_gain(context: EffectContext) -> Iterator[EffectInstance]:
    """The gain of an actuator, or of all of them alike.

    F' = (1 + g) F: the whole force by one factor, feedback terms included.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each actuator, and one for all of them alike where there are several, with the pure
        number g.
    """
    for target, ids in each_and_all(actuators(context.model)):
        gain = Quantity("gain", "1", -0.9, 4.0, (-0.05, -0.01, 0.01, 0.05), relative=True)
        yield EffectInstance("actuator_gain", target, (gain,), model=partial(_scale, ids))


def _scale(ids: Sequence[int], model: Any, magnitudes: Array) -> None:
    """Scales the gain and bias parameters of some actuators."""
    for place in ids:
        model.actuator_gainprm[place, :3] *= 1 + magnitudes[0]
        model.actuator_biasprm[place, :3] *= 1 + magnitudes[0]
