"""In which states bodies are in contact."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array


def touching(model: mujoco.MjModel, states: Array) -> NDArray[np.bool_]:
    """Find the states in which bodies overlap.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    states : (n, 1 + nq + ...) array
        Full physics states: time, positions and what follows.

    Returns
    -------
    (n,) array of bool
    """
    data = mujoco.MjData(model)
    found = np.zeros(len(states), dtype=bool)
    for i, state in enumerate(states):
        data.qpos[:] = state[1 : 1 + model.nq]
        mujoco.mj_fwdPosition(model, data)
        found[i] = bool(np.any(data.contact.dist < 0)) if data.ncon else False
    return found
