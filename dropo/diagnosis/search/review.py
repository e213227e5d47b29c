"""Accepted effects evaluated again beside everything that was accepted later.

Each is kept, removed, exchanged for an alternative, or merged with others of its kind into one. As
in a search, theta (m,) holds the declared parameters, then the magnitudes of all effects, 0 where
an effect is absent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.confirmation import SETTINGS, SelectionSettings, gain_of, is_confirmed
from dropo.diagnosis.search.linearization import Library, shift_linearization
from dropo.diagnosis.search.refit import settle
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import Batch, State, Trial, penalized_log_likelihood
from dropo.mjmodel.bodies import mass_centre, moving_bodies
from dropo.mjmodel.joints import joints
from dropo.mjmodel.robot_simulator import RobotSimulator

OF_A_BODY = ("body_mass", "body_inertia")
"""Effects of one body that something which it carries has both of."""


@dataclass(frozen=True, eq=False)
class Review:
    """An accepted effect beside its alternatives.

    Attributes
    ----------
    without : State
        The model without the effect, fitted to the end.
    origin : Batch or None
        The batch of candidates that it was accepted from; None where there is none, as of an effect
        that several were merged into and that no batch had tried.
    alternatives : sequence of Trial
        Other candidates of that batch, refitted in its place.
    similar : mapping of str to float
        By the label of another effect, how alike its response and this one's are: the cosine of
        both, what the other accepted effects explain projected out. Empty where there are none.
    others : tuple of (EffectInstance, str)
        What else the data do not tell from it, and why: what does the same as one of several
        numbers, or what whole motions bear out as well.
    """

    without: State
    origin: Batch | None
    alternatives: Sequence[Trial]
    similar: Mapping[str, float] = field(default_factory=dict)
    others: tuple[tuple[EffectInstance, str], ...] = ()


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
        better = _better_model(selection, state, instance, reviewed)
        if better is not None:
            # The other effects stand beside a different model now: review all of them anew.
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
        without = without_effects(selection, state, [instance])
        # A quick fit, with the linearization in the noise of the windows' start states as it is.
        train = settle(library, without.train, without.free, selection.floor)
        test = shift_linearization(library, state.test, train.theta, train.whiten.noise)
        without = replace(without, train=train, test=test)
        origin = selection.origins.get(instance.label)
        reviews[instance.label] = Review(without, origin, alternatives=())
    return reviews


def _review_effect(selection: Selection, state: State, instance: EffectInstance) -> Review:
    """One effect beside its alternatives."""
    origin = selection.origins.get(instance.label)
    is_only_effect = len(state.accepted) == 1
    if origin is not None and is_only_effect and not origin.before.accepted:
        # Its batch began without any effect, and has tried the others in its place already.
        others = [
            trial for trial in origin.trials if trial.candidate.instance.label != instance.label
        ]
        return Review(origin.before, origin, others)
    without = without_effects(selection, state, [instance])
    alternatives: list[Trial] = []
    if origin is not None:
        candidates = _alternatives_to_try(origin, state, instance, selection.settings)
        alternatives = selection.try_candidates(without, candidates)
    return Review(selection.polish(without), origin, alternatives)


def _alternatives_to_try(
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


def _better_model(
    selection: Selection, state: State, instance: EffectInstance, reviewed: Review
) -> State | None:
    """The model without the effect, or with an alternative in its place; None if neither is better.

    A single effect stays.
    """
    if len(state.accepted) == 1:
        return None
    held_out_gain, _ = gain_of(reviewed.without.test, state.test)
    if held_out_gain < selection.settings.negligible_gain:
        return reviewed.without
    return _better_alternative(selection, state, instance, reviewed)


def _better_alternative(
    selection: Selection, state: State, instance: EffectInstance, reviewed: Review
) -> State | None:
    """The model with the first alternative that is better than the effect, or more usual where
    windows held out do not say that it is worse; None if none is.
    """
    settings = selection.settings
    if reviewed.origin is None:
        return None
    with_effect = penalized_log_likelihood(state)
    without = penalized_log_likelihood(reviewed.without)
    effect_gain = with_effect - without
    for trial in reviewed.alternatives:
        # As it was tried, the alternative must gain nearly as much as the effect.
        alternative_gain = penalized_log_likelihood(trial.state) - without
        if not alternative_gain > settings.polished_fraction * effect_gain:
            continue
        polished = selection.polish(trial.state)
        alternative = trial.candidate.instance
        more_usual = settings.more_usual_by([alternative.effect], [instance.effect])
        margin = settings.margin(more_usual)
        if more_usual >= settings.more_usual:
            better = not _is_better(polished, state, margin, settings)
        else:
            better = _is_better(state, polished, margin, settings)
        if better:
            selection.origins[alternative.label] = reviewed.origin
            return polished
    return None


def _is_better(before: State, after: State, margin: float, settings: SelectionSettings) -> bool:
    """Whether a model is the better one by a margin, which windows held out confirm."""
    gain = penalized_log_likelihood(after) - penalized_log_likelihood(before)
    return gain > margin and is_confirmed(
        before.test, after.test, settings.negligible_gain, settings
    )


def without_effects(
    selection: Selection, state: State, instances: Sequence[EffectInstance]
) -> State:
    """Return the model without some of its effects, theta and noise else as they were.

    Parameters
    ----------
    selection : Selection
        The search that accepted the effects.
    state : State
        The model with them.
    instances : sequence of EffectInstance
        Some of its effects.

    Returns
    -------
    State
        Its windows held out are still those with the effects: to try candidates, only their order
        by gain is needed, and `Selection.polish` renews them.
    """
    library = selection.library
    left_out = {instance.label for instance in instances}
    indices = np.concatenate([library.indices_of[label] for label in sorted(left_out)])
    theta = state.theta.copy()
    theta[indices] = 0.0
    train = shift_linearization(library, state.train, theta, state.train.whiten.noise)
    free = np.setdiff1d(state.free, indices)
    others = tuple(other for other in state.accepted if other.label not in left_out)
    return State(train, state.test, free, others)


def merge(selection: Selection, state: State, instances: Sequence[EffectInstance]) -> State:
    """Replace several effects of a kind by fewer.

    They are one that acts everywhere alike in place of local ones, or local ones at the other
    places in place of one that acts everywhere and of those that undo it.

    Parameters
    ----------
    selection : Selection
        The search that accepted the effects.
    state : State
        Where it ended.
    instances : sequence of EffectInstance
        The effects that may be accepted, among them those that act everywhere.

    Returns
    -------
    State
        With the fewer effects if their fewer magnitudes outweigh the loss by BIC, else `state`
        itself.
    """
    for everywhere in instances:
        replacement = _replacement(selection.library, state, everywhere, instances)
        if replacement is None:
            continue
        merged = _merged(selection, state, replacement)
        # Fewer magnitudes take the place of several: is the loss less than BIC asks for them?
        gain, _ = gain_of(state.train, merged.train)
        magnitudes_before = sum(len(instance.quantities) for instance in replacement.replaced)
        magnitudes_after = len(replacement.fewer)
        fewer_magnitudes = magnitudes_before - magnitudes_after
        saved_penalty = 0.5 * fewer_magnitudes * np.log(state.train.windows.steps)
        if -gain < saved_penalty:
            for instance in replacement.fewer:
                selection.set_origin_to_first_batch(instance)
            return merged
    return state


def with_payload(selection: Selection, state: State, instances: Sequence[EffectInstance]) -> State:
    """Replace a body's mass, and inertia beside it, by a payload that the body carries.

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
        With the payload, which is one cause, if it is not worse by a margin; else `state` itself.
    """
    settings = selection.settings
    for payload in instances:
        replacement = _by_payload(selection.library, state, payload)
        if replacement is None:
            continue
        merged = _merged(selection, state, replacement)
        if not _is_better(merged, state, settings.usual_margin, settings):
            selection.set_origin_to_first_batch(payload)
            return merged
    return state


def _by_payload(library: Library, state: State, payload: EffectInstance) -> "_Replacement | None":
    """A payload in place of its body's larger mass and of a rotor or inertia; None of another
    effect, or where the body has not both.

    It begins on the line from the body's origin through its centre, where it has the mass times
    place, and the inertia of a rotor beside it.
    """
    simulator = library.simulator
    of_robot = isinstance(simulator, RobotSimulator)
    if not of_robot or payload.effect != "payload" or payload.variant or payload in state.accepted:
        return None
    model = simulator.model
    body = {name: body for body, name in moving_bodies(model)}[str(payload.target)]
    turning = {joint.name for joint in joints(model) if joint.body == body}
    sizes = {}
    replaced = []
    for one in state.accepted:
        at_joint = one.effect == "joint_armature" and one.target in turning
        if at_joint or (one.effect in OF_A_BODY and one.target == payload.target):
            replaced.append(one)
            sizes[one.effect] = _first_magnitude(library, state, one)
    mass = sizes.get("body_mass", 0.0)
    if not mass > 0 or len(replaced) < 2:
        return None
    centre = mass_centre(model, body)
    own = mass * float(centre @ centre)
    farther = 1 + max(0.0, sizes.get("joint_armature", 0.0)) / max(own, 1e-12)
    return _Replacement(replaced, [payload], np.array([mass / farther, *(farther * centre)]))


@dataclass(frozen=True, eq=False)
class _Replacement:
    """Accepted effects, fewer ones that may replace them, and the magnitudes that each of these
    begins with.
    """

    replaced: Sequence[EffectInstance]
    fewer: Sequence[EffectInstance]
    magnitudes: Array


def _replacement(
    library: Library, state: State, everywhere: EffectInstance, instances: Sequence[EffectInstance]
) -> _Replacement | None:
    """What may replace the accepted effects of one kind; None where `everywhere` is no effect that
    acts everywhere, no local one of its kind is accepted, or what may replace them is not fewer.
    """
    if everywhere.target is not None or len(everywhere.quantities) != 1:
        return None
    local = _local_effects(everywhere.effect, state.accepted)
    if not local:
        return None
    if everywhere in state.accepted:
        found = _by_local_ones_elsewhere(library, state, everywhere, local, instances)
    else:
        found = _by_one_everywhere(library, state, everywhere, local)
    return found if 0 < len(found.fewer) < len(found.replaced) else None


def _by_one_everywhere(
    library: Library, state: State, everywhere: EffectInstance, local: Sequence[EffectInstance]
) -> _Replacement:
    """One effect that acts everywhere in place of local ones: it begins with the mean of these."""
    first = [_first_magnitude(library, state, instance) for instance in local]
    return _Replacement(local, [everywhere], np.array([np.mean(first)]))


def _by_local_ones_elsewhere(
    library: Library,
    state: State,
    everywhere: EffectInstance,
    local: Sequence[EffectInstance],
    instances: Sequence[EffectInstance],
) -> _Replacement:
    """Local effects in place of one that acts everywhere and of local ones, which undo it there: so
    it may hold at the other places alone, as large as everywhere.
    """
    undone = {instance.target for instance in local}
    elsewhere = []
    for instance in _local_effects(everywhere.effect, instances):
        if instance.target not in undone and len(instance.quantities) == 1:
            elsewhere.append(instance)
    magnitude = _first_magnitude(library, state, everywhere)
    return _Replacement([everywhere, *local], elsewhere, np.array([magnitude]))


def _local_effects(effect: str, instances: Sequence[EffectInstance]) -> list[EffectInstance]:
    """Those of one kind that act at one place each."""
    return [one for one in instances if one.effect == effect and one.target is not None]


def _first_magnitude(library: Library, state: State, instance: EffectInstance) -> float:
    """The first of an effect's magnitudes in a model."""
    return float(state.theta[library.indices_of[instance.label][0]])


def _merged(selection: Selection, state: State, replacement: _Replacement) -> State:
    """The model with a few effects in the place of several of their kind, fitted to the end."""
    library = selection.library
    replaced = replacement.replaced
    fewer = replacement.fewer
    space = library.simulator.space
    of_fewer = np.concatenate([library.indices_of[instance.label] for instance in fewer])
    of_replaced = np.concatenate([library.indices_of[instance.label] for instance in replaced])
    theta = state.theta.copy()
    begun = np.tile(replacement.magnitudes, len(fewer))
    theta[of_fewer] = np.clip(begun, space.low[of_fewer], space.high[of_fewer])
    theta[of_replaced] = 0.0
    train = shift_linearization(library, state.train, theta, state.train.whiten.noise)
    free = np.append(np.setdiff1d(state.free, of_replaced), of_fewer)
    kept = tuple(instance for instance in state.accepted if instance not in replaced)
    initial = replace(state, train=train, free=free, accepted=(*kept, *fewer))
    return selection.polish(initial)


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

    # By label, the effects with the same response, and why; the effect itself is among them as yet.
    others: dict[str, tuple[Candidate, str]] = {}
    for candidate in screened:
        label = candidate.instance.label
        cosine = abs(float(candidate.signature @ own.signature))
        beside = "" if label not in reviewed.similar else " beside the rest"
        cosine = reviewed.similar.get(label, cosine)
        if cosine > settings.similarity:
            others[label] = (candidate, f"similarity {cosine:.3f}{beside}")

    # Alternatives that are hardly worse on windows held out.
    for trial in reviewed.alternatives:
        label = trial.candidate.instance.label
        loss_without_it, z = gain_of(trial.state.test, state.test)
        is_close = z < settings.indistinguishable_z or loss_without_it < settings.negligible_gain
        if is_close and label not in others:
            why = f"{loss_without_it:.1f} nats worse on held-out data, {z:.1f} standard errors"
            if label in reviewed.similar:
                why += f"; similarity {reviewed.similar[label]:.3f} beside the rest"
            others[label] = (trial.fitted_candidate, why)

    # All but the effect itself, with a time profile or without.
    listed = []
    for candidate, why in others.values():
        other = candidate.instance
        is_itself = other.label == instance.label
        # The target of an effect with a time profile is the label of the one without.
        is_its_profile = other.target == instance.label
        if not is_itself and not is_its_profile:
            listed.append((own, candidate, why))
    return listed
