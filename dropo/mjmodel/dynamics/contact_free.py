"""What a motion says of its forces where bodies touch: the combinations without contact forces.

Contact forces act along the rows of a contact Jacobian, whatever their size. Projected onto what
these rows do not reach, the equation of motion holds without them [1]_.

References
----------
.. [1] Aghili, A unified approach for inverse and direct dynamics of constrained multibody systems
   based on linear projection operator, IEEE Transactions on Robotics 21, 2005.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array


@dataclass(frozen=True)
class TouchSettings:
    """Which geoms touch.

    Attributes
    ----------
    near : float
        Geoms that are nearer than this fraction of the model's extent count as touching: contacts
        are soft, and measurements noisy.
    farthest : float
        Fraction of the extent beyond which geoms are not compared.
    cutoff : float
        Directions that constraints reach less than this fraction of the one they reach most are not
        counted.
    """

    near: float = 0.005
    farthest: float = 0.1
    cutoff: float = 1e-6


SETTINGS = TouchSettings()


def projectors(
    model: mujoco.MjModel,
    positions: Array,
    velocities: Array,
    held: NDArray[np.bool_],
    time: float,
    settings: TouchSettings = SETTINGS,
) -> Array:
    """Find the projections of generalized forces that unknown forces do not reach.

    Unknown are contact forces, those of limits, and those at degrees of freedom that are held.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    positions : (n, nq) array
        [m, rad].
    velocities : (n, nv) array
        [m/s, rad/s].
    held : (n, nv) array of bool
        Where an unknown force acts at a degree of freedom, as dry friction does where it rests.
    time : float
        Contacts count from so long before they close to so long behind [s].
    settings : TouchSettings

    Returns
    -------
    (n, nv, nv) array
        Of rows of forces [N, N m]: P F = 0 for every F that unknown forces make.
    """
    wide = mujoco.MjModel.__copy__(model)
    extent = float(model.stat.extent)
    wide.geom_margin[:] += settings.farthest * extent
    data = mujoco.MjData(wide)
    n, nv = velocities.shape
    found = np.empty((n, nv, nv))
    scale: Array | None = None
    for i in range(n):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        mujoco.mj_fwdPosition(wide, data)
        if scale is None:
            mass = np.empty((nv, nv))
            mujoco.mj_fullM(wide, data, mass)
            scale = 1 / np.sqrt(np.diagonal(mass))
        rows = [np.eye(nv)[held[i]]]
        rows += _contact_rows(wide, data, settings.near * extent, time)
        unknown = np.concatenate(rows) * scale
        found[i] = np.eye(nv)
        if len(unknown):
            _, size, along = np.linalg.svd(unknown, full_matrices=False)
            along = along[size > settings.cutoff * size[0]]
            found[i] -= (along.T @ along) * scale / scale[:, None]
    return found


def _contact_rows(
    model: mujoco.MjModel, data: mujoco.MjData, near: float, time: float
) -> list[Array]:
    """Jacobians (k, nv) of the relative motion at every contact that closes soon, and at limits."""
    nv = model.nv
    first = np.empty((3, nv))
    second = np.empty((3, nv))
    turn_first = np.empty((3, nv))
    turn_second = np.empty((3, nv))
    found = []
    for contact in data.contact[: data.ncon]:
        bodies = model.geom_bodyid[contact.geom]
        place = contact.pos.copy()
        mujoco.mj_jac(model, data, first, turn_first, place, int(bodies[0]))
        mujoco.mj_jac(model, data, second, turn_second, place, int(bodies[1]))
        relative = second - first
        speed = abs(float(contact.frame[:3] @ relative @ data.qvel))
        if contact.dist > near + speed * time:
            continue
        found.append(relative)
        if contact.dim > 3:
            found.append(turn_second - turn_first)
    limits = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)
    if len(limits):
        own = np.zeros((len(limits), nv))
        for row, j in zip(own, data.efc_id[limits], strict=True):
            row[model.jnt_dofadr[j]] = 1.0
        found.append(own)
    return found
