"""Which measured states touch something."""

import mujoco
import numpy as np

from dropo.core.services.validation import Array


def touching(model: mujoco.MjModel, states: Array) -> np.ndarray:
    """(n,) whether bodies overlap in full physics states (n, 1 + nq + ...)."""
    data = mujoco.MjData(model)
    found = np.zeros(len(states), dtype=bool)
    for i, state in enumerate(states):
        data.qpos[:] = state[1 : 1 + model.nq]
        mujoco.mj_fwdPosition(model, data)
        found[i] = bool(np.any(data.contact.dist < 0)) if data.ncon else False
    return found
