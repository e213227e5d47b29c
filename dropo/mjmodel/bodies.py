"""The bodies and geoms of a model, by name."""

import mujoco
import numpy as np

from dropo.core.services.validation import Array
from dropo.mjmodel.names import element_name, element_names


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


def body_masses(model: mujoco.MjModel) -> Array:
    """Return the masses of all bodies.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (nbody,) array
        The world first [kg].
    """
    return np.array(model.body_mass)


def moving_mass(model: mujoco.MjModel) -> float:
    """Return the mass of all bodies that can move.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    float
        In kg.
    """
    masses = body_masses(model)
    return float(sum(masses[body] for body, _ in moving_bodies(model)))


def mass_centre(model: mujoco.MjModel, body: int) -> Array:
    """Return the centre of mass of a body.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        Its number.

    Returns
    -------
    (3,) array
        In the body's own frame [m].
    """
    return np.array(model.body_ipos[body])


def principal_inertia(model: mujoco.MjModel, body: int) -> Array:
    """Return the principal moments of inertia of a body.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        Its number.

    Returns
    -------
    (3,) array
        In kg m^2.
    """
    return np.array(model.body_inertia[body])


def body_place(model: mujoco.MjModel, body: int) -> Array:
    """Return where a body's frame is while nothing moves.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        Its number.

    Returns
    -------
    (3,) array
        In its parent's frame [m].
    """
    return np.array(model.body_pos[body])


def contact_margin(model: mujoco.MjModel, geom: int) -> float:
    """Return the distance at which contacts of a geom begin.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    geom : int
        Its number.

    Returns
    -------
    float
        In m.
    """
    return float(model.geom_margin[geom])


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


def extent(model: mujoco.MjModel, body: int) -> float:
    """Return how far a body reaches from its origin [m].

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        The body's id.

    Returns
    -------
    float
        The distance of its centre of mass, of its children or of the far side of its geoms,
        whichever is largest; at least 2 cm.
    """
    distances = [0.02, float(np.linalg.norm(model.body_ipos[body]))]
    for child in np.flatnonzero(model.body_parentid == body).tolist():
        distances.append(float(np.linalg.norm(model.body_pos[child])))
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        centre = float(np.linalg.norm(model.geom_pos[geom]))
        distances.append(centre + float(model.geom_rbound[geom]))
    return max(distances)


def body_sites(model: mujoco.MjModel, body: int) -> list[tuple[str, Array]]:
    """List the named sites of a body.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        The body's id.

    Returns
    -------
    list of (str, (3,) array)
        Name of each, and its place in the body's frame [m].
    """
    sites = element_names(model, "site")
    return [
        (name, model.site_pos[site].copy())
        for name, site in sites.items()
        if model.site_bodyid[site] == body
    ]


def inertia_matrix(model: mujoco.MjModel, body: int) -> Array:
    """Return the rotational inertia of a body about its centre of mass, in its own frame.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        The body's id.

    Returns
    -------
    (3, 3) array
        In kg m^2.
    """
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    return np.asarray((axes * model.body_inertia[body]) @ axes.T)


def write_inertia(model: mujoco.MjModel, body: int, inertia: Array) -> None:
    """Write the rotational inertia of a body into a model.

    Parameters
    ----------
    model : MjModel
        The model, which is changed in place.
    body : int
        The body's id.
    inertia : (3, 3) array
        About its centre of mass, in its own frame [kg m^2].
    """
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    model.body_inertia[body] = moments
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())


def write_mass(model: mujoco.MjModel, body: int, mass: float) -> None:
    """Write the mass of a body into a model.

    Parameters
    ----------
    model : MjModel
        Changed in place.
    body : int
        Its number.
    mass : float
        In kg.
    """
    model.body_mass[body] = mass
