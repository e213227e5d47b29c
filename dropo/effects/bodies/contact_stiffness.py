"""How hard contacts are."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import contact_geoms

NUMBERS = ("time constant", "damping ratio")
"""The two numbers of a positive solref."""


def contact_stiffness(context: EffectContext) -> Iterator[EffectInstance]:
    """Time constant or damping ratio of contacts by a factor, or the distance where they begin.

    They are MuJoCo's solref and margin, of all geoms or of one. MuJoCo takes a mean of two geoms'
    solref, and the sum of their margins. Geoms that give stiffness and damping themselves (a
    negative solref) keep theirs.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        For all geoms, then for each where there are several: a factor of the time constant and of
        the damping ratio, and a change of the margin [m].
    """
    geoms = contact_geoms(context.model)
    places: list[tuple[str | None, tuple[int, ...]]] = [(None, ())] if geoms else []
    if len(geoms) > 1:
        places += [(name, (geom,)) for geom, name in geoms]
    for target, ids in places:
        soft = context.model.geom_solref[list(ids) or slice(None), 0] > 0
        if np.any(soft):
            for place, name in enumerate(NUMBERS):
                probes = (-0.2, -0.02, 0.02, 0.2)
                factor = Quantity(name, "1", -0.8, 5.0, probes, relative=True)
                change = partial(_scale, place, ids)
                variant = name.replace(" ", "-")
                yield EffectInstance("contact_stiffness", target, (factor,), variant, model=change)
        margin = Quantity("margin", "m", -0.05, 0.05, (-2e-3, -2e-4, 2e-4, 2e-3), smooth=False)
        widen = partial(_widen, ids)
        yield EffectInstance("contact_stiffness", target, (margin,), "margin", model=widen)


def _scale(place: int, ids: tuple[int, ...], model: Any, magnitudes: Array) -> None:
    """Scales one number of solref: of the geoms given, or of all geoms and pairs."""
    if ids:
        model.geom_solref[[*ids]] = _scaled(model.geom_solref[[*ids]], place, magnitudes)
    else:
        model.geom_solref[:] = _scaled(model.geom_solref, place, magnitudes)
        model.pair_solref[:] = _scaled(model.pair_solref, place, magnitudes)


def _scaled(solref: Array, place: int, magnitudes: Array) -> Array:
    """The rows of solref with one number scaled; negative rows stay."""
    out = solref.copy()
    out[:, place] *= np.where(solref[:, 0] > 0, 1 + magnitudes[0], 1.0)
    return out


def _widen(ids: tuple[int, ...], model: Any, magnitudes: Array) -> None:
    """Adds to the margin of the geoms given, or to that of all contacts."""
    if ids:
        model.geom_margin[[*ids]] += magnitudes[0]
    else:
        model.geom_margin[:] += magnitudes[0] / 2  # the margins of two geoms add up
        model.pair_margin[:] += magnitudes[0]
