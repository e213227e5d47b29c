"""Dead time between a command and its force."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import each_and_all
from dropo.mjmodel.joints import actuators


def actuator_delay(context: EffectContext) -> Iterator[EffectInstance]:
    """Dead time of an actuator, or of all of them alike.

    u'(t) = u(t - T), as its mean over each physics step. Before a trajectory begins, its first
    command is taken to have been held.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each actuator, and one for all of them alike where there are several, with T in
        seconds.
    """
    dt = context.control_step
    for target, ids in each_and_all(actuators(context.model)):
        probes = (0.02 * dt, 0.25 * dt, dt, 2 * dt, 3 * dt)
        delay = Quantity("delay", "s", 0.0, 10 * dt, probes, smooth=False)
        yield EffectInstance(
            "actuator_delay",
            target,
            (delay,),
            actuation=partial(_delayed, ids),
            alike=() if target else ("sensor_delay",),
        )


def _delayed(ids: Sequence[int], commands: Array, step: float, magnitudes: Array) -> Array:
    """Shifts the commands of some actuators by whole physics steps and a part of one."""
    whole, part = divmod(magnitudes[0] / step, 1.0)
    out = commands.copy()
    rows = np.arange(len(commands)) - int(whole)
    newer = np.maximum(rows, 0)
    older = np.maximum(rows - 1, 0)
    for place in ids:
        column = commands[:, place]
        out[:, place] = (1 - part) * column[newer] + part * column[older]
    return out
