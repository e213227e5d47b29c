"""The options of a model: its physics step, integrator and gravity."""

import mujoco
import numpy as np

from dropo.core.services.validation import Array

_CAPITALS = {"euler": "Euler", "rk4": "RK4"}
"""Names of integrators that MJCF does not write in small letters."""


def physics_step(model: mujoco.MjModel) -> float:
    """Return the physics step of a model.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    float
        In s.
    """
    return float(model.opt.timestep)


def integrator(model: mujoco.MjModel) -> str:
    """Return the name of a model's integrator.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    str
        As in MJCF, such as "Euler".
    """
    name = mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_").lower()
    return _CAPITALS.get(name, name)


def gravity(model: mujoco.MjModel) -> Array:
    """Return a model's gravity.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (3,) array
        In the world's axes [m/s^2].
    """
    return np.array(model.opt.gravity)


def disabled(model: mujoco.MjModel) -> int:
    """Return what a model leaves out.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    int
        The bits `disableflags` of mjOption.
    """
    return int(model.opt.disableflags)
