"""A search that begins with what regression is certain of, where windows held out confirm it."""

from collections.abc import Sequence

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.diagnosis.search.confirmation import is_confirmed
from dropo.diagnosis.search.review import without_effects
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import State, penalized_log_likelihood


def begin_with(
    selection: Selection, first: State, instances: Sequence[EffectInstance], known: ActiveEffects
) -> State:
    """Accept effects together, before any is looked for.

    Windows of a few steps may take an effect for another, which regression over whole logs does
    not. But forces are not all that may be wrong: where one effect explains the windows better than
    all that regression is certain of, such as signals that are late, the search begins with that.

    Parameters
    ----------
    selection : Selection
        A search that has not begun.
    first : State
        The model as it is.
    instances : sequence of EffectInstance
        The effects that may be accepted.
    known : sequence of (EffectInstance, (q,) array)
        Those that are certain, and their sizes.

    Returns
    -------
    State
        `first` itself where windows held out do not confirm them, or one effect explains more.
    """
    library = selection.library
    space = library.simulator.space
    sizes = {instance.label: magnitudes for instance, magnitudes in known}
    added = [one for one in instances if one.label in sizes]
    if not added:
        return first
    theta = first.theta.copy()
    for instance in added:
        own = library.indices_of[instance.label]
        theta[own] = np.clip(sizes[instance.label], space.low[own], space.high[own])
    named = ", ".join(one.label for one in added)
    selection.progress(0.0, f"fitting {named} together")
    together = selection.try_set(first, theta, (), added, scanned=())
    needed = len(added) * selection.settings.needed_gain(len(instances))
    if not is_confirmed(first.test, together.test, needed, selection.settings):
        return first
    together = selection.polish(together)
    if not is_confirmed(first.test, together.test, needed, selection.settings):
        return first
    alone = selection.step(first, instances, first)
    if alone is not None and penalized_log_likelihood(alone) > penalized_log_likelihood(together):
        return first
    if len(added) == 1 and added[0].label in selection.origins:
        return together
    for instance in added:
        without = first
        if len(added) > 1:
            # What was tried beside no other effect may look like another than it does here.
            without = selection.polish(without_effects(selection, together, [instance]))
        fitted = together.theta[library.indices_of[instance.label]]
        selection.try_in_place_of(without, instance, fitted, instances)
    return together
