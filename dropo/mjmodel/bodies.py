"""The bodies and geoms of a model, by name."""

import mujoco
import numpy as np

from dropo.mjmodel.names import element_name


def moving_bodies(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """(id, name) of the bodies with mass that can move."""
    moving = (model.body_mass > 0) & (model.body_weldid > 0)
    moving[0] = False  # the world
    return [(body, element_name(model, "body", body)) for body in np.flatnonzero(moving).tolist()]


def contact_geoms(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """(id, name) of the geoms of moving bodies that can be in contact."""
    can = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    found = np.flatnonzero(can & (model.geom_bodyid > 0)).tolist()
    return [(geom, element_name(model, "geom", geom)) for geom in found]
