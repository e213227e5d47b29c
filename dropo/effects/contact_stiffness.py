"""How hard contacts are."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import contact_geoms

NUMBERS = ("time constant", "damping ratio")


def contact_stiffness(context: EffectContext) -> Iterator[EffectInstance]:
    """Time constant or damping ratio (MuJoCo's solref) by a factor, or the distance at which
    contacts begin; of all geoms or of one.

    MuJoCo takes a mean of two geoms' solref, and the sum of their margins. Geoms that give
    stiffness and damping themselves (a negative solref) keep theirs.
    """
    geoms = contact_geoms(context.model)
    places: list[tuple[str | None, tuple[int, ...]]] = [(None, ())] if geoms else []
    places += [(name, (geom,)) for geom, name in geoms if len(geoms) > 1]
    for target, ids in places:
        soft = context.model.geom_solref[list(ids) or slice(None), 0] > 0
        for place, name in enumerate(NUMBERS) if np.any(soft) else []:
            size = Quantity(name, "1", -0.8, 5.0, (-0.2, -0.02, 0.02, 0.2), relative=True)
            yield EffectInstance(
                "contact_stiffness",
                target,
                (size,),
                name.replace(" ", "-"),
                model=partial(_scale, place, ids),
            )
        size = Quantity("margin", "m", -0.05, 0.05, (-2e-3, -2e-4, 2e-4, 2e-3), smooth=False)
        yield EffectInstance(
            "contact_stiffness", target, (size,), "margin", model=partial(_widen, ids)
        )


def _scale(place: int, ids: tuple[int, ...], model: Any, magnitudes: Array) -> None:
    """One number of solref, of those geoms, of all geoms and pairs where none are given."""
    for solref in (model.geom_solref[[*ids]],) if ids else (model.geom_solref, model.pair_solref):
        solref[:, place] *= np.where(solref[:, 0] > 0, 1 + magnitudes[0], 1.0)
        if ids:
            model.geom_solref[[*ids]] = solref


def _widen(ids: tuple[int, ...], model: Any, magnitudes: Array) -> None:
    if ids:
        model.geom_margin[[*ids]] += magnitudes[0]
    else:
        model.geom_margin[:] += magnitudes[0] / 2  # the margins of two geoms add up
        model.pair_margin[:] += magnitudes[0]
