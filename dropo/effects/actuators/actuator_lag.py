"""First-order lag between a command and its force."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy.signal import lfilter

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import each_and_all
from dropo.mjmodel.joints import actuators


def actuator_lag(context: EffectContext) -> Iterator[EffectInstance]:
    """A first-order lag of an actuator, or of all of them alike.

    T dx/dt = u - x, exact for commands that are held. What acts in a physics step is the mean of x
    over it. A trajectory begins settled on its first command.

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
        probes = (0.02 * dt, 0.2 * dt, dt)
        time = Quantity("time constant", "s", 0.0, 20 * dt, probes, smooth=False)
        yield EffectInstance("actuator_lag", target, (time,), actuation=partial(_lagged, list(ids)))


def _lagged(ids: Sequence[int], commands: Array, step: float, magnitudes: Array) -> Array:
    """Filters the commands of some actuators."""
    time = max(float(magnitudes[0]), 1e-12)
    keep = np.exp(-step / time)
    given = commands[:, ids]
    # x at the start of each physics step
    x = lfilter([0.0, 1 - keep], [1.0, -keep], given - given[:1], axis=0) + given[:1]
    out = commands.copy()
    out[:, ids] = given + (x - given) * (1 - keep) * time / step
    return out
