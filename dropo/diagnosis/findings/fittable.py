"""What was found as parameters, so that a fit gives it a distribution."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.search.library import robot_of


@dataclass(frozen=True)
class FittableSettings:
    """How wide the bounds of what was found are.

    Attributes
    ----------
    errors : float
        Standard errors to either side, at least.
    share : float
        Fraction of a size to either side, at least.
    """

    errors: float = 6.0
    share: float = 0.5


SETTINGS = FittableSettings()


def fittable(
    problem: Problem, causes: Sequence[Cause], settings: FittableSettings = SETTINGS
) -> Problem | None:
    """Make a problem whose parameters are the sizes of the causes, beside the declared ones.

    Parameters
    ----------
    problem : Problem
        The extended one, whose simulator has the causes.
    causes : sequence of Cause
        What was named.
    settings : FittableSettings
        How wide the bounds are.

    Returns
    -------
    Problem or None
        None without causes that have a size in the model.
    """
    if not causes:
        return None
    robot = robot_of(problem)
    named = {(cause.effect, cause.target, cause.variant): cause for cause in causes}
    free = {}
    for instance, sizes in robot.fixed:
        cause = named.get((instance.effect, instance.target, instance.variant))
        if cause is not None:  # of one that the problem had too, what was found is the last
            free[instance.label] = _bounded(instance, sizes, cause, settings)
    if not free:
        return None
    return replace(problem, simulator=robot.with_fitted(list(free.values())))


def _bounded(
    instance: EffectInstance, sizes: Array, cause: Cause, settings: FittableSettings
) -> EffectInstance:
    """An effect whose quantities have bounds around their sizes, their own where none is known.

    Own bounds are where a search by simulation ends; a regression may have found more than that.
    """
    quantities = []
    for quantity, size in zip(instance.quantities, sizes.tolist(), strict=True):
        estimate = cause.estimate.get(quantity.name)
        se = np.nan if estimate is None else estimate.se
        is_inside = quantity.low <= size <= quantity.high
        least = settings.share * abs(size)
        if np.isfinite(se):
            half = max(settings.errors * se, least)
        else:
            half = np.inf if is_inside else least
        low = size - half
        high = size + half
        if is_inside:
            low = max(quantity.low, low)
            high = min(quantity.high, high)
        quantities.append(replace(quantity, low=low, high=high))
    return replace(instance, quantities=tuple(quantities))
