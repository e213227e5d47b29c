"""Accepted effects judged again beside all that came later: kept, taken out, exchanged for another,
or several of a kind made one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.diagnosis.search.linearization import shift_linearization
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import (
    ALIKE,
    DEFICIT,
    Round,
    Selection,
    State,
    Trial,
    is_confirmed,
    gain_of,
)

UNTOLD = 2.0  # another within so many standard errors, or DEFICIT nats, cannot be told from it
# share of the winner's worth from which others of its round are tried in its place, and how many
RIVAL = 0.5
RIVALS = 2
NEARLY = 0.9  # share of what an effect brings, from which another in its place is fitted to the end


@dataclass(frozen=True, eq=False)
class Review:
    """An accepted effect beside all others: the state without it, the round that it was accepted
    from, and others of that round tried in its place.
    """

    without: State
    origin: Round | None
    alternatives: Sequence[Trial]


def review(selection: Selection, state: State) -> tuple[State, dict[str, Review]]:
    """The state that judging again leads to, and each of its effects' review, by label.

    An effect whose absence costs nothing on data held out is taken out, and one that another of its
    round does better than, now that the rest is there, is exchanged for that.
    """
    found = {}
    for instance in state.accepted:
        found[instance.label] = one = _review(selection, state, instance)
        better = _better(selection, state, one)
        if better is not None:
            return review(selection, better)
    return state, found


def _review(selection: Selection, state: State, instance: EffectInstance) -> Review:
    origin = selection.origins.get(instance.label)
    if origin is not None and len(state.accepted) == 1 and not origin.before.accepted:
        return Review(
            origin.before,
            origin,
            [t for t in origin.trials if t.candidate.instance.label != instance.label],
        )
    bare = _bare(selection, state, instance)
    alternatives = [] if origin is None else selection.try_candidates(bare, _rivals(origin, state, instance))
    return Review(selection.polish(bare), origin, alternatives)


def _rivals(origin: Round, state: State, instance: EffectInstance) -> list[Candidate]:
    """What else its round would have accepted for nearly as much, and what is not there already; of
    the sizes that it would have had.
    """
    taken = {other.label for other in state.accepted}
    penalized_gain = next(t.penalized_gain for t in origin.trials if t.candidate.instance.label == instance.label)
    others = [
        t
        for t in origin.trials
        if t.candidate.instance.label not in taken and t.penalized_gain > RIVAL * penalized_gain
    ]
    return [trial.sized for trial in others[:RIVALS]]


def _better(selection: Selection, state: State, found: Review) -> State | None:
    """The state without the effect, where nothing is lost, or with another in its place, where
    windows held out confirm that it gains.
    """
    if len(state.accepted) > 1 and gain_of(found.without.test, state.test)[0] < DEFICIT:
        return found.without
    nothing = value(found.without)
    for trial in found.alternatives if len(state.accepted) > 1 else ():
        if value(trial.state) - nothing > NEARLY * (value(state) - nothing):
            polished = selection.polish(trial.state)
            if (
                found.origin
                and value(polished) > value(state) + DEFICIT
                and is_confirmed(state.test, polished.test, DEFICIT)
            ):
                selection.origins[trial.candidate.instance.label] = found.origin
                return polished
    return None


def value(state: State) -> float:
    """[nats] of all windows, less what each number fitted gains by chance (Schwarz 1978)."""
    sides = (state.train, state.test)
    return float(sum(s.log_likelihood.sum() for s in sides)) - 0.5 * len(state.free) * float(
        np.log(sum(s.windows.steps for s in sides))
    )


def _bare(selection: Selection, state: State, instance: EffectInstance) -> State:
    """The state with one accepted effect taken out, the rest as it was."""
    place = selection.library.places[instance.label]
    theta = state.theta.copy()
    theta[place] = 0.0
    left = tuple(other for other in state.accepted if other.label != instance.label)
    begun = shift_linearization(selection.library, state.train, theta, state.train.whiten.sigma)
    return State(begun, state.test, np.setdiff1d(state.free, place), left)


def merge(selection: Selection, state: State, instances: Sequence[EffectInstance]) -> State:
    """The state with one effect that acts everywhere alike in the place of several of its kind,
    where it needs fewer numbers for as much (Schwarz 1978).
    """
    for whole in (
        instance
        for instance in instances
        if instance.target is None and len(instance.quantities) == 1
    ):
        single = [
            instance
            for instance in state.accepted
            if (instance.effect, instance.target is None) == (whole.effect, False)
        ]
        if len(single) < 2 or whole in state.accepted:
            continue
        theta = state.theta.copy()
        places = selection.library.places
        theta[places[whole.label]] = np.mean(
            [theta[places[instance.label][0]] for instance in single]
        )
        gone = np.concatenate([places[instance.label] for instance in single])
        theta[gone] = 0.0
        free = np.append(np.setdiff1d(state.free, gone), places[whole.label])
        begun = shift_linearization(selection.library, state.train, theta, state.train.whiten.sigma)
        kept = tuple(instance for instance in state.accepted if instance not in single)
        fewer = selection.polish(replace(state, train=begun, free=free, accepted=(*kept, whole)))
        if -gain_of(state.train, fewer.train)[0] < 0.5 * (len(gone) - 1) * np.log(
            state.train.windows.steps
        ):
            for tried in reversed(selection.rounds):  # the first that it was tried in stays
                if any(trial.candidate.instance.label == whole.label for trial in tried.trials):
                    selection.origins[whole.label] = tried
            return fewer
    return state


def ambiguity(
    state: State, instance: EffectInstance, found: Review
) -> list[tuple[Candidate, Candidate, str]]:
    """An accepted effect's candidate, another that the data cannot tell from it, and why: others
    tried in its place, and those that move the predictions in the same way. Not that it sets in
    at a moment, which may be the data's beginning.
    """
    own = (
        next((c for c in found.origin.screened if c.instance.label == instance.label), None)
        if found.origin
        else None
    )
    if own is None or found.origin is None:
        return []
    told: dict[str, tuple[Candidate, str]] = {}
    for candidate in found.origin.screened:
        same = abs(float(candidate.signature @ own.signature))
        if same > ALIKE:
            told[candidate.instance.label] = candidate, f"similarity {same:.3f}"
    for rival in found.alternatives:
        deficit, z = gain_of(rival.state.test, state.test)
        if rival.candidate.instance.label not in told and (z < UNTOLD or deficit < DEFICIT):
            told[rival.candidate.instance.label] = (
                rival.sized,
                f"{deficit:.1f} nats worse on held-out data, {z:.1f} standard errors",
            )
    return [
        (own, other, why)
        for other, why in told.values()
        if instance.label not in (other.instance.label, other.instance.target)
    ]
