"""What a simulator predicts under commands that nobody has given yet."""

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array


def open_loop(simulator: Simulator, value: Array, starts: Array, actions: Array) -> Array:
    """Simulate whole trajectories from start observations.

    Parameters
    ----------
    simulator : Simulator
        With d parameters.
    value : (d,) array
        The parameters.
    starts : (n, p) array
        Start observations.
    actions : (n, T, q) array
        Commands.

    Returns
    -------
    (n, T + 1, p) array
        Observations, the start first; NaN from where a simulation diverges.

    Raises
    ------
    Incompatible
        If predictions are no observations, as where a rotation is compared by 3 numbers.
    """
    n, t, q = actions.shape
    p = starts.shape[1]
    if len(simulator.signals) != p:
        raise Incompatible(
            "Predictions of this simulator are no observations (a rotation is compared by "
            "3 numbers). Give trajectories."
        )
    # Trajectories whose measurements are blank but for their start.
    blank = np.repeat(starts, t, axis=0)
    ends = np.tile(np.arange(t) == t - 1, n)
    whole = Trajectories(blank, actions.reshape(n * t, q), blank, ends).segments(reset="start")
    predicted = simulator.predict(value[None], whole)[0].reshape(n, t, p)
    return np.concatenate([starts[:, None], predicted], axis=1)
