"""A command that also acts elsewhere."""

from collections.abc import Iterator
from functools import partial

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_coupling(context: EffectContext) -> Iterator[EffectInstance]:
    """A fraction of an actuator's command that also reaches another actuator.

    u_j' = u_j + s u_i; the variant names actuator j.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each ordered pair of actuators, with the pure number s.
    """
    found = actuators(context.model)
    for source in found:
        for other in found:
            if source.id == other.id:
                continue
            fraction = Quantity("share", "1", -1.0, 1.0, (-0.05, -0.005, 0.005, 0.05))
            hook = partial(_leak, source.id, other.id)
            yield EffectInstance(
                "actuator_coupling", source.name, (fraction,), f"on-{other.name}", actuation=hook
            )


def _leak(source: int, other: int, commands: Array, step: float, magnitudes: Array) -> Array:
    """Adds a fraction of the source's commands to those of the other actuator."""
    out = commands.copy()
    out[:, other] += magnitudes[0] * commands[:, source]
    return out
