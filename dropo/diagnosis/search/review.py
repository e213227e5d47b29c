"""Accepted effects evaluated again beside everything that was accepted later.

Each is kept, removed, exchanged for an alternative, or merged with others of its kind into one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.diagnosis.search.linearization import shift_linearization
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import (
    SETTINGS,
    Round,
    Selection,
    SelectionSettings,
    State,
    Trial,
    gain_of,
    is_confirmed,
)


@dataclass(frozen=True, eq=False)
class Review:
    """An accepted effect beside its alternatives.

    Attributes
    ----------
    without : State
        The model without the effect.
    origin : Round or None
        The batch that it was accepted from; None where it was not accepted in one.
    alternatives : sequence of Trial
        Others of that batch, tried in its place.
    """

    without: State
    origin: Round | None
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
        found = _review_effect(selection, state, instance)
        better = _better(selection, state, found)
        if better is not None:
            return review(selection, better)
        reviews[instance.label] = found
    return state, reviews


def _review_effect(selection: Selection, state: State, instance: EffectInstance) -> Review:
    """One effect beside its alternatives."""
    origin = selection.origins.get(instance.label)
    if origin is not None and len(state.accepted) == 1 and not origin.before.accepted:
        # The only effect: the batch itself says what the others do in its place.
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
    origin: Round, state: State, instance: EffectInstance, settings: SelectionSettings
) -> list[Candidate]:
    """The best other candidates of an effect's batch, with the magnitudes fitted there.

    Those count that gained nearly as much and are not in the model.
    """
    accepted = {other.label for other in state.accepted}
    own = next(t for t in origin.trials if t.candidate.instance.label == instance.label)
    least_gain = settings.alternative * own.penalized_gain
    others = []
    for trial in origin.trials:
        absent = trial.candidate.instance.label not in accepted
        if absent and trial.penalized_gain > least_gain:
            others.append(trial.sized)
    return others[: settings.alternatives]


def _better(selection: Selection, state: State, found: Review) -> State | None:
    """The model without the effect, or with an alternative in its place; None if neither is better.

    A single effect stays.
    """
    settings = selection.settings
    origin = found.origin
    if len(state.accepted) == 1:
        return None
    if gain_of(found.without.test, state.test)[0] < settings.deficit:
        return found.without
    if origin is None:
        return None
    present = penalized_log_likelihood(state)
    without = penalized_log_likelihood(found.without)
    for trial in found.alternatives:
        # As it is, the alternative must gain nearly as much as the effect.
        gain = penalized_log_likelihood(trial.state) - without
        if not gain > settings.nearly * (present - without):
            continue
        # Fitted to the end, it must gain more, and windows held out must confirm that.
        polished = selection.polish(trial.state)
        if not penalized_log_likelihood(polished) > present + settings.deficit:
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
    """The model without one of its effects, the rest as it was; its windows held out are old."""
    library = selection.library
    place = library.places[instance.label]
    theta = state.theta.copy()
    theta[place] = 0.0
    others = tuple(other for other in state.accepted if other.label != instance.label)
    train = shift_linearization(library, state.train, theta, state.train.whiten.sigma)
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
        if whole.target is not None or len(whole.quantities) != 1:
            continue
        parts = [
            instance
            for instance in state.accepted
            if instance.effect == whole.effect and instance.target is not None
        ]
        if len(parts) < 2 or whole in state.accepted:
            continue
        merged = _merged(selection, state, parts, whole)
        loss = -gain_of(state.train, merged.train)[0]
        magnitudes = sum(len(part.quantities) for part in parts)
        penalty = 0.5 * (magnitudes - 1) * np.log(state.train.windows.steps)
        if loss < penalty:
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
    theta[places[whole.label]] = np.mean([theta[places[part.label][0]] for part in parts])
    gone = np.concatenate([places[part.label] for part in parts])
    theta[gone] = 0.0
    free = np.append(np.setdiff1d(state.free, gone), places[whole.label])
    train = shift_linearization(library, state.train, theta, state.train.whiten.sigma)
    kept = tuple(instance for instance in state.accepted if instance not in parts)
    start = replace(state, train=train, free=free, accepted=(*kept, whole))
    return selection.polish(start)


def _remember_origin(selection: Selection, whole: EffectInstance) -> None:
    """Note the first batch in which an effect was tried as the one that it comes from."""
    for batch in selection.rounds:
        if any(trial.candidate.instance.label == whole.label for trial in batch.trials):
            selection.origins[whole.label] = batch
            return


def ambiguity(
    state: State,
    instance: EffectInstance,
    found: Review,
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
    found : Review
        Of that effect.
    settings : SelectionSettings
        When two effects cannot be distinguished.

    Returns
    -------
    list of tuple
        For each, the candidate of the accepted effect, the candidate of the other, and why.
    """
    if found.origin is None:
        return []
    own = None
    for candidate in found.origin.screened:
        if candidate.instance.label == instance.label:
            own = candidate
            break
    if own is None:
        return []

    others: dict[str, tuple[Candidate, str]] = {}
    for candidate in found.origin.screened:
        cosine = abs(float(candidate.signature @ own.signature))
        if cosine > settings.similarity:
            others[candidate.instance.label] = candidate, f"similarity {cosine:.3f}"
    for trial in found.alternatives:
        label = trial.candidate.instance.label
        deficit, z = gain_of(trial.state.test, state.test)
        close = z < settings.indistinguishable_z or deficit < settings.deficit
        if close and label not in others:
            why = f"{deficit:.1f} nats worse on held-out data, {z:.1f} standard errors"
            others[label] = trial.sized, why

    listed = []
    for candidate, why in others.values():
        # An effect with a time profile has the label of the one without as its target.
        other = candidate.instance
        if instance.label not in (other.label, other.target):
            listed.append((own, candidate, why))
    return listed
