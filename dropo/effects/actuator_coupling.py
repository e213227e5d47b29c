"""A command that also acts elsewhere."""

from collections.abc import Iterator
from functools import partial

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_coupling(context: EffectContext) -> Iterator[EffectInstance]:
    """A share of an actuator's command that also reaches another one, u_j' = u_j + s u_i; the
    variant names that one.
    """
    found = actuators(context.model)
    for source in found:
        for other in found:
            if source.id == other.id:
                continue
            size = Quantity("share", "1", -1.0, 1.0, (-0.05, -0.005, 0.005, 0.05))
            hook = partial(_leak, source.id, other.id)
            yield EffectInstance(
                "actuator_coupling", source.name, (size,), f"on-{other.name}", actuation=hook
            )


def _leak(source: int, other: int, commands: Array, step: float, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, other] += magnitudes[0] * commands[:, source]
    return out
