"""A mass that a body carries."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import (
    body_sites,
    extent,
    inertia_matrix,
    moving_bodies,
    write_inertia,
)
from dropo.mjmodel.dynamics.body_regressors import point_mass

TRIED = np.array(
    [
        [0, 0, 0],
        [1, 0, 0],
        [0, 1, 0],
        [0, 0, 1],
        [-1, 0, 0],
        [0, -1, 0],
        [0, 0, -1],
        [1, 1, 0],
        [1, 0, 1],
        [0, 1, 1],
    ]
)
"""Ten places, in half the body's reach from its centre, whose inertial numbers span all ten."""

FAR = 1.5
"""How far from a body's origin it may carry something, in how far it reaches itself."""


def payload(context: EffectContext) -> Iterator[EffectInstance]:
    """A point mass that a body carries: at a place of its frame to be found, or at a named site.

    The body's mass, centre of mass and rotational inertia change together. It is left out for
    bodies whose centre of mass cannot be moved (see `body_com`).

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        For each body that can move one with its mass [kg] and its place [m], and one with its mass
        alone for each named site of the body.
    """
    for body, name in moving_bodies(context.model):
        simple = bool(context.model.body_simple[body])
        if simple and not context.source:
            continue
        mass = float(context.model.body_mass[body])
        reach = extent(context.model, body)
        far = FAR * reach
        quantities = (
            Quantity("mass", "kg", 0.0, 5 * mass, (0.1 * mass,)),
            *(Quantity(axis, "m", -far, far, (0.5 * reach,), smooth=False) for axis in "xyz"),
        )
        # Mass times place is no smooth function of both where the mass is 0.
        centre = np.clip(context.model.body_ipos[body], -0.5 * reach, 0.5 * reach)
        places = centre + 0.5 * reach * TRIED
        trial = tuple((0.1 * mass, *map(float, place)) for place in places)
        yield EffectInstance(
            "payload",
            name,
            quantities,
            model=partial(_add, body),
            general=simple,
            trials=(trial,),
            linear_in=_inertial,
        )
        for site, place in body_sites(context.model, body):
            yield EffectInstance(
                "payload",
                name,
                quantities[:1],
                variant=site,
                model=partial(_add_at, body, place),
                general=simple,
            )


def _inertial(magnitudes: Array) -> Array:
    """The ten inertial numbers (..., 10) of a mass at a place (..., 4)."""
    return np.asarray(magnitudes[..., :1] * point_mass(magnitudes[..., 1:]))


def _add_at(body: int, place: Array, model: Any, magnitudes: Array) -> None:
    """Adds a point mass to a body at a known place."""
    _add(body, model, np.append(magnitudes, place))


def _add(body: int, model: Any, magnitudes: Array) -> None:
    """Adds a point mass to a body."""
    mass = float(model.body_mass[body])
    added = float(magnitudes[0])
    centre = np.array(model.body_ipos[body])
    place = magnitudes[1:]
    total = mass + added
    moved = (mass * centre + added * place) / total
    inertia = inertia_matrix(model, body)
    for share, at in ((mass, centre), (added, place)):
        away = at - moved
        inertia = inertia + share * (away @ away * np.eye(3) - np.outer(away, away))
    model.body_mass[body] = total
    model.body_ipos[body] = moved
    write_inertia(model, body, inertia)
