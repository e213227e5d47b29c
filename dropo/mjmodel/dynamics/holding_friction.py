"""Dry friction that holds what rests.

MuJoCo's friction is a soft constraint: under a load F below the friction, a joint does not rest but
creeps with the speed (1 - d) F T / (2 m), with the constraint's impedance d = 0.9 and time constant
T = 20 ms by default, and the joint's inertia m. A servo that holds 0.3 N m on 0.03 kg m^2 moves by
10 mrad in a second, where a gearbox stays.

References
----------
MuJoCo documentation, "Computation: Constraint model", solver parameters.
"""

import mujoco
import numpy as np

IMPEDANCE = float(mujoco.mjMAXIMP)
"""The hardest constraint that MuJoCo computes: what creeps is a thousandth of its default."""


def hold_friction(model: mujoco.MjModel) -> None:
    """Make the dry friction of all joints and tendons hold what rests.

    Parameters
    ----------
    model : MjModel
        Changed in place: the impedances of the friction of joints and tendons.
    """
    model.dof_solimp[:, :2] = IMPEDANCE
    model.tendon_solimp_fri[:, :2] = IMPEDANCE


def holds(model: mujoco.MjModel) -> bool:
    """Tell whether dry friction of every joint and tendon holds what rests, if there is any.

    Parameters
    ----------
    model : MjModel
        Any.

    Returns
    -------
    bool
    """
    impedances = np.concatenate([model.dof_solimp[:, :2], model.tendon_solimp_fri[:, :2]])
    return bool(np.all(impedances >= IMPEDANCE))


def impedance(model: mujoco.MjModel) -> float:
    """Return the impedance of the dry friction of a model's joints.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    float
        The first number of `solimpfriction`.
    """
    return float(model.dof_solimp[0, 0])
