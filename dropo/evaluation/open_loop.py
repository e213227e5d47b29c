"""What a simulator predicts under commands that nobody has given yet."""

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array


def open_loop(simulator: Simulator, value: Array, starts: Array, actions: Array) -> Array:
    """Observations (n, T + 1, p) from start observations (n, p), which come first, under actions
    (n, T, q), with the parameters (d,).

    Those of a simulation that diverges are NaN from there on. A simulator whose predictions are no
    observations is refused: it compares a rotation by three numbers.
    """
    n, t, q = actions.shape
    p = starts.shape[1]
    if len(simulator.signals) != p:
        raise Incompatible(
            "Predictions of this simulator are no observations (a rotation is compared by "
            "3 numbers). Give trajectories."
        )
    blank = np.repeat(starts, t, axis=0)
    ends = np.tile(np.arange(t) == t - 1, n)
    whole = Trajectories(blank, actions.reshape(n * t, q), blank, ends).segments(reset="start")
    return np.concatenate(
        [starts[:, None], simulator.predict(value[None], whole)[0].reshape(n, t, p)], axis=1
    )
