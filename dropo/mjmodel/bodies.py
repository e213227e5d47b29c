"""The bodies and geoms of a model, by name."""

import mujoco
import numpy as np

from dropo.mjmodel.names import element_name


def moving_bodies(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """List the bodies with mass that can move.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (int, str)
        Id and name of each.
    """
    moving = (model.body_mass > 0) & (model.body_weldid > 0)
    moving[0] = False  # the world
    return [(body, element_name(model, "body", body)) for body in np.flatnonzero(moving).tolist()]


def contact_geoms(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """List the geoms of bodies, the world left out, that can be in contact.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (int, str)
        Id and name of each.
    """
    can = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    found = np.flatnonzero(can & (model.geom_bodyid > 0)).tolist()
    return [(geom, element_name(model, "geom", geom)) for geom in found]
