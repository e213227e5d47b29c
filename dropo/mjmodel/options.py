"""The options of a model: its physics step, integrator and gravity."""

import mujoco
import numpy as np

from dropo.core.services.validation import Array

_CAPITALS = {"euler": "Euler", "rk4": "RK4"}
"""Names of integrators that MJCF does not write in small letters."""


def physics_step(model: mujoco.MjModel) -> float:
    """Return the physics step of a `model` [s]."""
    return float(model.opt.timestep)


def integrator(model: mujoco.MjModel) -> str:
    """Return the name in MJCF of the integrator of a `model`."""
    name = mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_").lower()
    return _CAPITALS.get(name, name)


def gravity(model: mujoco.MjModel) -> Array:
    """Return the gravity (3,) of a `model` in the world's axes [m/s^2]."""
    return np.array(model.opt.gravity)


def disabled(model: mujoco.MjModel) -> int:
    """Return what a `model` leaves out, as the bits `disableflags` of mjOption."""
    return int(model.opt.disableflags)
