"""What a simulator predicts under commands that nobody has given yet."""

import numpy as np

from dropo.core.checks import Array
from dropo.core.data import Trajectories
from dropo.core.errors import Incompatible
from dropo.core.simulator import Simulator


def open_loop(simulator: Simulator, value: Array, starts: Array, actions: Array) -> Trajectories:
    """The n trajectories of T control steps from start observations (n, p) under actions (n, T, q), with the parameters (d,).

    Rows of a simulation that diverges are NaN from there on. A simulator whose predictions are no observations is refused: it compares
    a rotation by three numbers.
    """
    n, t, q = actions.shape
    p = starts.shape[1]
    if len(simulator.signals) != p:
        raise Incompatible("Predictions of this simulator are no observations (a rotation is compared by 3 numbers). Give trajectories.")
    blank, ends = np.repeat(starts, t, axis=0), np.tile(np.arange(t) == t - 1, n)
    flat = actions.reshape(n * t, q)
    after = simulator.predict(value[None], Trajectories(blank, flat, blank, ends).segments(reset="start"))[0].reshape(n, t, p)
    before = np.concatenate([starts[:, None], after[:, :-1]], axis=1)
    return Trajectories(before.reshape(-1, p), flat, after.reshape(-1, p), ends)
