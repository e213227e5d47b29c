"""Accepted effects evaluated again beside everything that was accepted later.

Each is kept, removed, exchanged for an alternative, or merged with others of its kind into one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.diagnosis.search.confirmation import SETTINGS, SelectionSettings, gain_of, is_confirmed
from dropo.diagnosis.search.linearization import shift_linearization
from dropo.diagnosis.search.refit import settle
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import Batch, State, Trial


@dataclass(frozen=True, eq=False)
class Review:
    """An accepted effect beside its alternatives.

    Attributes
    ----------
    without : State
        The model without the effect, fitted to the end.
    origin : Batch or None
        The batch of candidates that it was accepted from; None where there is none, as of an effect
        that replaced several and that no batch had tried.
    alternatives : sequence of Trial
        Other candidates of that batch, tried in its place.
    """

    without: State
    origin: Batch | None
    alternatives: Sequence[Trial]


def review(selection: Selection, state: State) -> tuple[State, dict[str, Review]]:
    """Evaluate each accepted effect again.

    An effect whose absence costs nothing on windows held out is removed. One that an alternative
    now does better than is exchanged for it. After either, the review begins anew.

    Parameters
    ----------
    selection : Selection
        The search that accepted the effects.
    state : State
        Where it ended.

    Returns
    -------
    state : State
        Where the review ends; the same object if nothing was changed.
    reviews : dict of str to Review
        By the label of each of its effects.
    """
    reviews = {}
    for instance in state.accepted:
        reviewed = _review_effect(selection, state, instance)
        better = _better(selection, state, reviewed)
        if better is not None:
            return review(selection, better)
        reviews[instance.label] = reviewed
    return state, reviews


def reviews_so_far(selection: Selection, state: State) -> dict[str, Review]:
    """Evaluate each accepted effect once, without alternatives, where a search was interrupted.

    Parameters
    ----------
    selection : Selection
        The search that accepted the effects.
    state : State
        How far it came.

    Returns
    -------
    dict of str to Review
        By the label of each of its effects.
    """
    library = selection.library
    reviews = {}
    for instance in state.accepted:
        without = _without_effect(selection, state, instance)
        train = settle(library, without.train, without.free, selection.floor)
        test = shift_linearization(library, state.test, train.theta, train.whiten.noise)
        origin = selection.origins.get(instance.label)
        reviews[instance.label] = Review(replace(without, train=train, test=test), origin, ())
    return reviews


def _review_effect(selection: Selection, state: State, instance: EffectInstance) -> Review:
    """One effect beside its alternatives."""
    origin = selection.origins.get(instance.label)
    if origin is not None and len(state.accepted) == 1 and not origin.before.accepted:
        # The only effect: its batch began without any, and has tried the others in its place.
        others = [
            trial for trial in origin.trials if trial.candidate.instance.label != instance.label
        ]
        return Review(origin.before, origin, others)
    without = _without_effect(selection, state, instance)
    alternatives: list[Trial] = []
    if origin is not None:
        candidates = _candidates_instead(origin, state, instance, selection.settings)
        alternatives = selection.try_candidates(without, candidates)
    return Review(selection.polish(without), origin, alternatives)


def _candidates_instead(
    origin: Batch, state: State, instance: EffectInstance, settings: SelectionSettings
) -> list[Candidate]:
    """The best other candidates of an effect's batch, with the magnitudes fitted there.

    Those count that gained enough beside it and are not in the model.
    """
    accepted = {other.label for other in state.accepted}
    own_trial = next(
        trial for trial in origin.trials if trial.candidate.instance.label == instance.label
    )
    needed_gain = settings.alternative_fraction * own_trial.penalized_gain
    others = []
    for trial in origin.trials:
        is_absent = trial.candidate.instance.label not in accepted
        if is_absent and trial.penalized_gain > needed_gain:
            others.append(trial.fitted_candidate)
    return others[: settings.maximum_alternatives]


def _better(selection: Selection, state: State, reviewed: Review) -> State | None:
    """The model without the effect, or with an alternative in its place; None if neither is better.

    A single effect stays.
    """
    settings = selection.settings
    origin = reviewed.origin
    if len(state.accepted) == 1:
        return None
    held_out_gain, _ = gain_of(reviewed.without.test, state.test)
    if held_out_gain < settings.deficit:
        return reviewed.without
    if origin is None:
        return None
    with_effect = penalized_log_likelihood(state)
    without = penalized_log_likelihood(reviewed.without)
    effect_gain = with_effect - without
    for trial in reviewed.alternatives:
        # As it is, the alternative must gain nearly as much as the effect.
        alternative_gain = penalized_log_likelihood(trial.state) - without
        if not alternative_gain > settings.polished_fraction * effect_gain:
            continue
        # Fitted to the end, it must gain more, and windows held out must confirm that.
        polished = selection.polish(trial.state)
        if not penalized_log_likelihood(polished) > with_effect + settings.deficit:
            continue
        if is_confirmed(state.test, polished.test, settings.deficit, settings):
            selection.origins[trial.candidate.instance.label] = origin
            return polished
    return None


def penalized_log_likelihood(state: State) -> float:
    """Return the log-likelihood of all windows less the BIC penalty.

    Parameters
    ----------
    state : State
        A model.

    Returns
    -------
    float
        [nats].

    References
    ----------
    Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    """
    sides = (state.train, state.test)
    steps = sum(side.windows.steps for side in sides)
    total = float(sum(side.log_likelihood.sum() for side in sides))
    return total - 0.5 * len(state.free) * float(np.log(steps))


def _without_effect(selection: Selection, state: State, instance: EffectInstance) -> State:
    """The model without one of its effects, theta and noise else as they were.

    Its windows held out are still those with the effect: to try candidates, only their order by
    gain is needed, and `Selection.polish` renews them.
    """
    library = selection.library
    place = library.places[instance.label]
    theta = state.theta.copy()
    theta[place] = 0.0
    others = tuple(other for other in state.accepted if other.label != instance.label)
    train = shift_linearization(library, state.train, theta, state.train.whiten.noise)
    return State(train, state.test, np.setdiff1d(state.free, place), others)


def merge(selection: Selection, state: State, instances: Sequence[EffectInstance]) -> State:
    """Replace several effects of a kind by one that acts everywhere alike.

    Parameters
    ----------
    selection : Selection
        The search that accepted the effects.
    state : State
        Where it ended.
    instances : sequence of EffectInstance
        The effects that may be accepted.

    Returns
    -------
    State
        With the one effect if its fewer magnitudes outweigh the loss by BIC, else `state` itself.
    """
    for whole in instances:
        is_everywhere = whole.target is None
        if not is_everywhere or len(whole.quantities) != 1:
            continue
        parts = [
            instance
            for instance in state.accepted
            if instance.effect == whole.effect and instance.target is not None
        ]
        if len(parts) < 2 or whole in state.accepted:
            continue
        merged = _merged(selection, state, parts, whole)
        gain, _ = gain_of(state.train, merged.train)
        magnitudes = sum(len(part.quantities) for part in parts)
        saved_penalty = 0.5 * (magnitudes - 1) * np.log(state.train.windows.steps)
        if -gain < saved_penalty:
            _remember_origin(selection, whole)
            return merged
    return state


def _merged(
    selection: Selection, state: State, parts: Sequence[EffectInstance], whole: EffectInstance
) -> State:
    """The model with one effect in the place of several, fitted to the end."""
    library = selection.library
    places = library.places
    theta = state.theta.copy()
    # It begins with the mean of the parts' first magnitudes, and takes their place.
    theta[places[whole.label]] = np.mean([theta[places[part.label][0]] for part in parts])
    replaced = np.concatenate([places[part.label] for part in parts])
    theta[replaced] = 0.0
    free = np.append(np.setdiff1d(state.free, replaced), places[whole.label])
    train = shift_linearization(library, state.train, theta, state.train.whiten.noise)
    kept = tuple(instance for instance in state.accepted if instance not in parts)
    start = replace(state, train=train, free=free, accepted=(*kept, whole))
    return selection.polish(start)


def _remember_origin(selection: Selection, whole: EffectInstance) -> None:
    """Note the first batch in which an effect was tried as the one that it comes from."""
    for batch in selection.batches:
        if any(trial.candidate.instance.label == whole.label for trial in batch.trials):
            selection.origins[whole.label] = batch
            return


def ambiguity(
    state: State,
    instance: EffectInstance,
    reviewed: Review,
    settings: SelectionSettings = SETTINGS,
) -> list[tuple[Candidate, Candidate, str]]:
    """List the effects that the data cannot distinguish from an accepted one.

    These are effects with the same response, and alternatives that are hardly worse in its place.
    The effect itself with a time profile does not count: it may set in where the data begin.

    Parameters
    ----------
    state : State
        Where the search ended.
    instance : EffectInstance
        One of its effects.
    reviewed : Review
        That effect beside its alternatives.
    settings : SelectionSettings
        When two effects cannot be distinguished.

    Returns
    -------
    list of tuple
        For each, the candidate of the accepted effect, the candidate of the other, and why.
    """
    if reviewed.origin is None:
        return []
    screened = reviewed.origin.screened
    own = next((one for one in screened if one.instance.label == instance.label), None)
    if own is None:
        return []

    # By label, each effect with the reason; the effect itself is among them as yet.
    others: dict[str, tuple[Candidate, str]] = {}
    for candidate in screened:
        cosine = abs(float(candidate.signature @ own.signature))
        if cosine > settings.similarity:
            others[candidate.instance.label] = candidate, f"similarity {cosine:.3f}"
    for trial in reviewed.alternatives:
        label = trial.candidate.instance.label
        deficit, z = gain_of(trial.state.test, state.test)
        is_close = z < settings.indistinguishable_z or deficit < settings.deficit
        if is_close and label not in others:
            why = f"{deficit:.1f} nats worse on held-out data, {z:.1f} standard errors"
            others[label] = trial.fitted_candidate, why

    listed = []
    for candidate, why in others.values():
        # The target of an effect with a time profile is the label of the one without.
        other = candidate.instance
        if instance.label not in (other.label, other.target):
            listed.append((own, candidate, why))
    return listed
