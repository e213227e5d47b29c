"""The search for effects, in all its turns: other noise, other steps, other sets."""

from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import chain

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.numerics.tails import student_quantile
from dropo.core.records.trajectories import Ints
from dropo.core.services.tables import number, steps_text
from dropo.core.services.validation import Array
from dropo.data.outliers.without_disturbances import WithoutDisturbances
from dropo.diagnosis.findings.accuracy.every_horizon import Beyond
from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.findings.limits.scale_of_forces import untold_scales, with_known_scale
from dropo.diagnosis.findings.premises.numerics import refused_delay, short_delay
from dropo.diagnosis.findings.remains.unexplained_forces import impulses_of, unexplained_force
from dropo.diagnosis.parts import Leader
from dropo.diagnosis.search.arithmetic import (
    UNCHANGED,
    Arithmetic,
    ArithmeticAlternatives,
    alternatives_of,
)
from dropo.diagnosis.search.bounds import totals_of
from dropo.diagnosis.search.confirmation import gain_of, is_confirmed
from dropo.diagnosis.search.known_causes import begin_with
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import (
    Library,
    shift_linearization,
    with_other_noise,
)
from dropo.diagnosis.search.refit import other_noise
from dropo.diagnosis.search.review import Review, merge, review, reviews_so_far, with_payload
from dropo.diagnosis.search.selection import STOPPING, Selection
from dropo.diagnosis.search.sets import SetSearch, SetSettings
from dropo.diagnosis.search.trials import Batch, State, penalized_log_likelihood
from dropo.diagnosis.search.whitening import WhitenessSettings, WindowNoise, white
from dropo.diagnosis.setup import SearchedEffects, SearchSetup
from dropo.mjmodel.dynamics.dry_friction import FrictionKind, friction_kind, rubs
from dropo.mjmodel.options import integrator, physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator

FRICTION = ("joint_friction", "tendon_friction")
"""Effects that are dry friction, that of joints first."""
FALLING = "joint_stribeck"
"""Dry friction that falls with speed."""
FEW_EFFECTS = 3
"""So many effects at least are looked for in the model's own steps beside more exact ones."""
SMALL = 0.01
"""Fraction of a number of the model below which its change is hardly a cause."""
MAY_BE_NOTHING = "its size may be 0"
"""Why an effect is no cause that data held out ask for."""
FEWEST_DEGREES = 3.0
"""Degrees of freedom below which a standard error says little."""


def with_noise_left(
    setup: SearchSetup, before: State | None, settings: WhitenessSettings
) -> SearchSetup:
    """Return a setup with noise that is coloured, where the model before says so of its windows.

    Parameters
    ----------
    setup : SearchSetup
        What a search works on.
    before : State or None
        What a search of more data ended with.
    settings : WhitenessSettings
        When noise is not taken to be white.

    Returns
    -------
    SearchSetup
    """
    if before is None or setup.explained is not None:
        return setup
    # Impulses, which come last, may be others; they are 0.
    size = min(len(before.theta), len(setup.library.simulator.space))
    theta = setup.padded(before.theta[:size])
    plain = white(before.train.whiten.sigma)
    state = setup.selection.without_fitting(
        setup.train, setup.test, theta, plain, before.free, before.accepted
    )
    noise = _noise_of_sensors(setup, state, settings)
    if noise is None:
        return setup
    return _coloured(setup, noise)


def _noise_of_sensors(
    setup: SearchSetup, state: State, settings: WhitenessSettings
) -> WindowNoise | None:
    """A noise that is not white; where nothing was found, if that explains more of the windows held
    out than forces do.

    What is missing from a model makes errors that follow each other, too: as noise of sensors it
    would hide.
    """
    library, floor = setup.library, setup.selection.floor
    noise = other_noise(library, state.train, floor, settings)
    if noise is None or state.accepted or not impulses_of(library):
        return noise
    gain, _ = gain_of(state.test, with_other_noise(library, state.test, noise))
    forces = unexplained_force(library, state.train, state.test, floor, gain_of)
    return None if forces.present and forces.gain > gain else noise


def solved(
    setup: SearchSetup,
    settings: WhitenessSettings,
    disturbed: Callable[[SearchSetup, SearchedEffects], WithoutDisturbances | None],
) -> tuple[SearchSetup, SearchedEffects, WithoutDisturbances | None]:
    """Look for effects, and anew with noise that is coloured where errors follow each other.

    They may have been taken for causes, unless there are disturbances to be left out first.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    settings : WhitenessSettings
        When noise is not taken to be white.
    disturbed : callable
        Gives what is left where the end of a search shows disturbances, else None.

    Returns
    -------
    setup : SearchSetup
        That of the search which counts.
    searched : SearchedEffects
        What it ends with.
    left : WithoutDisturbances or None
        What is left without disturbances.
    """
    setup, found = search_effects(setup)
    if found.interrupted:
        return setup, found, None
    try:
        setup, found = _with_other_friction(setup, found)
        if found.interrupted:
            return setup, found, None
        left = disturbed(setup, found)
        if left is not None or setup.noise is not None:
            return setup, found, left
        noise = _noise_of_sensors(setup, found.last, settings)
        if noise is None:
            return setup, found, None
        coloured = _coloured(setup, noise)
        if np.abs(noise.rho).max() < settings.weak:
            coloured = replace(coloured, begun=_begun_with(coloured, found.last))
            coloured.selection.origins = dict(setup.selection.origins)
        again, anew = _with_other_friction(*search_effects(coloured))
        if anew.interrupted:
            # What was found before is whole; half a search under other premises is not.
            return setup, replace(found, interrupted=True), None
        return again, anew, disturbed(again, anew)
    except KeyboardInterrupt:
        setup.selection.progress(0.9, STOPPING)
        return setup, replace(found, interrupted=True), None


def _anew(setup: SearchSetup, under: str) -> Selection:
    """A search that has not begun, under other premises."""
    selection = _further(setup, under)
    selection.batches = []
    selection.origins = {}
    return selection


def _further(setup: SearchSetup, under: str) -> Selection:
    """A search that goes on where it is, under premises that are said."""
    progress = setup.selection.progress

    def further(share: float, text: str) -> None:
        """Progress does not run backward."""
        progress(0.9, f"{text}, {under}")

    selection = replace(setup.selection, progress=further)
    selection.screening = setup.selection.screening
    return selection


def _coloured(setup: SearchSetup, noise: WindowNoise) -> SearchSetup:
    """A setup with noise that is not white, whose search has not begun."""
    return replace(setup, selection=_anew(setup, "noise that is not white"), noise=noise)


def _begun_with(setup: SearchSetup, last: State) -> tuple[State, State]:
    """The model as it is, and one that another search ended with, under a setup's noise."""
    first = setup.first()
    noise = first.train.whiten.noise
    selection = setup.selection
    state = selection.without_fitting(
        setup.train, setup.test, last.theta, noise, last.free, last.accepted
    )
    return first, selection.polish(state)


def _with_other_friction(
    setup: SearchSetup, found: SearchedEffects
) -> tuple[SearchSetup, SearchedEffects]:
    """A search that goes on with dry friction of another kind, if the end of one asks for it.

    MuJoCo's creeps and turns early, which in a gearbox's data looks like laws, lags and damping;
    friction that falls with speed turns with it, and may stand for one that does not fall.
    """
    last = found.last
    library = setup.library
    simulator = robot_of(setup.problem)
    kinds = {one.effect for one in last.accepted}
    rubbing = rubs(simulator.model) or not kinds.isdisjoint((*FRICTION, FALLING))
    if found.interrupted or setup.explained is not None or not rubbing:
        return setup, found
    settings = setup.selection.settings
    needed = settings.needed_gain(1)
    theta, free, accepted = _without_falling(library, last)
    chosen: SearchSetup | None = None
    best = last
    for arithmetic in _steps_of_other_friction(setup):
        other, begun = _going_on(setup, arithmetic, theta, free, accepted)
        library.simulator.steps = other.library.simulator.steps
        gain = penalized_log_likelihood(begun) - penalized_log_likelihood(best)
        # What is more usual than friction that falls need not be better.
        usual = FALLING in kinds and chosen is None and gain > -settings.usual_margin
        if usual or (gain > needed and is_confirmed(best.test, begun.test, needed, settings)):
            chosen = other
            best = begun
    if chosen is None:
        return setup, found
    chosen.library.simulator.steps = library.simulator.steps
    return search_effects(chosen)


def _steps_of_other_friction(setup: SearchSetup) -> list[Arithmetic]:
    """The steps in which other dry friction is tried: the model's, and more exact ones.

    How friction turns may show only where the drives' damping is not that of Euler's steps; over
    how little velocity, in those of Runge and Kutta alone.
    """
    simulator = robot_of(setup.problem)
    own = integrator(simulator.model)
    kind = friction_kind(simulator.model)
    found = []
    for steps in (UNCHANGED,) if setup.exact else (UNCHANGED, alternatives_of(simulator)[0]):
        if kind is FrictionKind.CREEPING:
            found.append(replace(steps, friction=FrictionKind.HOLDING))
        if kind is not FrictionKind.TURNING and (steps.integrator or own) == "RK4":
            found.append(replace(steps, friction=FrictionKind.TURNING))
    return found


def _without_falling(
    library: Library, state: State
) -> tuple[Array, Ints, tuple[EffectInstance, ...]]:
    """A model's numbers (m,), which of them are fitted, and its effects, with plain dry friction in
    the place of one that falls with speed.
    """
    theta = state.theta.copy()
    free = set(state.free.tolist())
    accepted = []
    plain = {one.target: one for one in library.instances if one.effect == FRICTION[0]}
    for instance in state.accepted:
        other = plain.get(instance.target)
        if instance.effect != FALLING or other is None:
            accepted.append(instance)
            continue
        own = library.indices_of[instance.label]
        its = library.indices_of[other.label]
        if other not in state.accepted:
            accepted.append(other)
        theta[its[0]] += theta[own[0]]
        theta[own] = 0.0
        free = free.difference(own.tolist()).union(its.tolist())
    return theta, np.array(sorted(free), dtype=np.int64), tuple(accepted)


def _stepped(setup: SearchSetup, arithmetic: Arithmetic) -> SearchSetup:
    """A setup whose simulations are stepped otherwise, and whose search has not begun."""
    library = arithmetic.in_place_of(setup.library)
    library.simulator.steps = setup.library.simulator.steps
    under = ["exact physics steps"] if arithmetic.is_exact else []
    under += [] if arithmetic.friction is None else [f"{arithmetic.friction} friction"]
    selection = replace(_anew(setup, ", ".join(under)), library=library)
    shown = selection.progress

    def progress(share: float, text: str) -> None:
        """The steps that are told are counted by the simulator that all began with."""
        setup.library.simulator.steps = library.simulator.steps
        shown(share, text)

    selection.progress = progress
    problem = replace(setup.problem, simulator=arithmetic.of(robot_of(setup.problem)))
    return replace(
        setup,
        problem=problem,
        library=library,
        selection=selection,
        exact=setup.exact or arithmetic.is_exact,
        begun=None,
    )


def _going_on(
    setup: SearchSetup,
    arithmetic: Arithmetic,
    theta: Array,
    free: Ints,
    accepted: tuple[EffectInstance, ...],
) -> tuple[SearchSetup, State]:
    """A setup that is stepped otherwise, and the model that its search begins with, fitted."""
    other = _stepped(setup, arithmetic)
    other.selection.origins = dict(setup.selection.origins)
    first = other.first()
    noise = first.train.whiten.noise
    state = other.selection.without_fitting(other.train, other.test, theta, noise, free, accepted)
    begun = other.selection.polish(state)
    return replace(other, begun=(first, begun)), begun


def _alternatives(setup: SearchSetup, first: State) -> ArithmeticAlternatives:
    """More exact steps than a setup has, beside what its search accepts."""
    selection = setup.selection
    return ArithmeticAlternatives(
        setup.library,
        selection.floor,
        selection.settings,
        selection.log,
        first,
        setup.exact,
    )


def search_effects(setup: SearchSetup) -> tuple[SearchSetup, SearchedEffects]:
    """Look for effects; where that is interrupted, return what was accepted so far.

    Where more exact physics steps are the better explanation, all is done anew with them.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects
        With the steps that were the better ones.
    """
    explained = setup.explained
    if explained is not None:
        return setup, SearchedEffects(*setup.evaluated(), explained.interrupted)
    selection = setup.selection
    first = setup.first() if setup.begun is None else setup.begun[0]
    try:
        if setup.begun is None:
            begun = begin_with(selection, first, setup.instances, setup.known)
        else:
            begun = setup.begun[1]
        selection.latest = begun
        alternatives = _alternatives(setup, first)
        chosen = setup.exact or setup.steps_chosen
        if not chosen and alternatives.is_preferred(begun):
            return _in_either(replace(setup, begun=(first, begun)), alternatives)
        if begun is first or not alternatives(first, begun):
            last, reviews = explain(setup, first, begun, alternatives)
            if alternatives.winner in (None, setup.tried) or alternatives.reached < setup.to_beat:
                return setup, SearchedEffects(first, last, reviews)
        elif alternatives.winner == setup.tried or alternatives.reached < setup.to_beat:
            return setup, SearchedEffects(first, begun, reviews_so_far(selection, begun))
        assert alternatives.winner is not None
        return search_effects(_stepped(setup, alternatives.winner))
    except KeyboardInterrupt:
        selection.progress(0.9, STOPPING)
        last = selection.latest or first
        reviews = reviews_so_far(selection, last)
        return setup, SearchedEffects(first, last, reviews, interrupted=True)


def _in_either(
    setup: SearchSetup, alternatives: ArithmeticAlternatives
) -> tuple[SearchSetup, SearchedEffects]:
    """A search in more exact steps; if it finds something, also one in the model's own.

    A machine has no steps, and another simulation may have the model's own. As with effects that do
    nearly the same, what is less usual must be better by a margin, and so must another effect.
    """
    assert alternatives.winner is not None
    exact, found = search_effects(_stepped(setup, alternatives.winner))
    if found.interrupted or not found.last.accepted:
        return exact, found
    setup.library.simulator.steps = exact.library.simulator.steps
    selection = _further(setup, "the model's own physics steps")
    usual = selection.settings
    # What needs many more effects in these steps does not explain the data better.
    most = max(FEW_EFFECTS, len(found.last.accepted) + 1)
    selection.settings = replace(usual, maximum_effects=min(most, usual.maximum_effects))
    own = replace(setup, selection=selection, steps_chosen=True, tried=alternatives.winner)
    own = replace(own, to_beat=penalized_log_likelihood(found.last))
    own, other = search_effects(own)
    exact.library.simulator.steps = own.library.simulator.steps
    if other.interrupted:
        return exact, replace(found, interrupted=True)
    more = len(other.last.accepted) - len(found.last.accepted)
    gain = penalized_log_likelihood(other.last) - penalized_log_likelihood(found.last)
    if gain <= (1 + more) * usual.usual_margin:
        return exact, found
    own = replace(own, begun=None)
    own.selection.settings = usual
    if len(other.last.accepted) < most:
        return own, other
    last, reviews = explain(own, other.first, other.last)
    return own, replace(other, last=last, reviews=reviews)


def explain(
    setup: SearchSetup,
    first: State,
    begun: State,
    alternatives: ArithmeticAlternatives | None = None,
) -> tuple[State, dict[str, Review]]:
    """Accept effects, and exchange them, until nothing changes.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    first, begun : State
        The model as it is, and the one to begin with.
    alternatives : ArithmeticAlternatives, optional
        The search ends early where one of them is better.

    Returns
    -------
    last : State
        The model that the search ends with.
    reviews : dict of str to Review
        By the labels of its effects, what it is without each.
    """
    selection = setup.selection
    instances = setup.instances
    last, reviews = review(selection, begun)
    while True:
        found = selection.run(first, last, instances, alternatives)
        if alternatives is not None and alternatives.winner is not None:
            return last, reviews
        if found is last:
            break
        # After an exchange, others may be confirmed.
        last, reviews = review(selection, found)
        selection.latest = last
        if last is found:
            break
    merged = with_payload(selection, merge(selection, last, instances), instances)
    if merged is not last:
        _, reviews = review(selection, merged)
    return merged, reviews


def without_short_delays(
    setup: SearchSetup, searched: SearchedEffects
) -> tuple[SearchSetup, SearchedEffects] | None:
    """Go on without delays shorter than a physics step.

    They are what else is wrong looks like: a model says little of what happens within its steps.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects or None
        None where there are none.
    """
    library, last = setup.library, searched.last
    step = physics_step(robot_of(setup.problem).model)
    refused: dict[str, str] = {}
    indices: list[int] = []
    for instance, size in _short_delays(library, last):
        without = searched.reviews[instance.label].without
        refused[instance.label] = refused_delay(instance, size, step, without.test, last.test)
        indices += library.indices_of[instance.label].tolist()
    if not refused:
        return None
    selection = _without(setup.selection, refused)
    setup = replace(setup, selection=selection, refused={**setup.refused, **refused})
    theta = last.theta.copy()
    theta[indices] = 0.0
    train = shift_linearization(library, last.train, theta, last.train.whiten.noise)
    kept = tuple(one for one in last.accepted if one.label not in refused)
    begun = State(train, last.test, np.setdiff1d(last.free, indices), kept)
    # More exact steps were tried beside them, and were not better.
    further, reviews = explain(setup, searched.first, selection.polish(begun))
    return setup, replace(searched, last=further, reviews=reviews)


def _short_delays(library: Library, last: State) -> list[tuple[EffectInstance, float]]:
    """The effects of a model that delay something by less than a physics step, and by how much."""
    if not isinstance(library.simulator, RobotSimulator):
        return []
    step = physics_step(library.simulator.model)
    found = []
    for instance in last.accepted:
        size = short_delay(instance, last.theta[library.indices_of[instance.label]], step)
        if size is not None:
            found.append((instance, size))
    return found


def in_exact_steps(
    setup: SearchSetup, searched: SearchedEffects
) -> tuple[SearchSetup, SearchedEffects] | None:
    """Go on in more exact physics steps, where these explain as much as a delay within a step.

    When the delay was accepted, what was missing else may have hidden that.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects or None
        None where there is no such delay, or it is the better explanation.
    """
    if setup.exact or setup.steps_chosen:
        return None
    library, last = setup.library, searched.last
    for instance, _ in _short_delays(library, last):
        alternatives = _alternatives(setup, searched.first)
        others = tuple(one for one in last.accepted if one.label != instance.label)
        with_delay = replace(last, accepted=(*others, instance))
        if alternatives(searched.reviews[instance.label].without, with_delay):
            assert alternatives.winner is not None
            assert alternatives.fitted is not None
            there = alternatives.fitted
            other, _ = _going_on(
                setup, alternatives.winner, there.theta, there.free, there.accepted
            )
            return search_effects(other)
    return None


def in_shorter_steps(
    setup: SearchSetup, searched: SearchedEffects, settings: WhitenessSettings
) -> tuple[SearchSetup, SearchedEffects] | None:
    """Go on in shorter physics steps, where these explain what remains beside all that was found.

    What was missing hid that: of a force that turns suddenly, as a stop does, even exact steps must
    be short. What coarse steps left may have been taken for noise that is not white.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.
    settings : WhitenessSettings
        When noise is not taken to be white.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects or None
        None where steps explain nothing more, or this was done before.
    """
    if setup.shortened or setup.steps_chosen:
        return None
    last = searched.last
    alternatives = _alternatives(setup, searched.first)
    if setup.exact:
        shorter = alternatives.shorter(last)
    else:
        alternatives(last, None)
        shorter = alternatives.winner or UNCHANGED
    if shorter == UNCHANGED:
        return None
    end = last.theta, last.free, last.accepted
    setup = replace(setup, noise=None, shortened=True)
    other, begun = _going_on(setup, shorter, *end)
    noise = _noise_of_sensors(other, begun, settings)
    if noise is not None:
        other, _ = _going_on(replace(setup, noise=noise), shorter, *end)
    other, found = search_effects(other)
    return other, replace(found, laws=searched.laws)


def with_another_set(
    setup: SearchSetup, searched: SearchedEffects, settings: SetSettings
) -> tuple[SearchSetup, SearchedEffects] | None:
    """Go on with a set of effects that is better.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.
    settings : SetSettings
        Which sets are compared.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects or None
        None where none is.
    """
    sets = SetSearch(setup.selection, searched.first, setup.instances, settings)
    better = sets.run(searched.last)
    if better is searched.last:
        return None
    last, reviews = explain(setup, searched.first, better)
    return replace(setup, compared=True), replace(searched, last=last, reviews=reviews)


def with_known_scales(
    setup: SearchSetup, searched: SearchedEffects
) -> tuple[SearchSetup, SearchedEffects] | None:
    """Go on with masses as they came, and a drive's gain, where other effects do the same.

    The data do not tell which: motions tell only ratios of forces. A mass is known better than a
    gain, and a gain that is far off is less usual than a rotor that is missing.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects or None
        None where the data tell the gain, or it is not far off, or this was done before.
    """
    if setup.scaled:
        return None
    selection, last = setup.selection, searched.last
    library = setup.library
    for scale in untold_scales(library, last):
        known = with_known_scale(library, last, scale)
        if known is None:
            continue
        replaced, theta = known
        other = selection.polish(selection.try_set(last, theta, (replaced,), (scale.other,)))
        lost = penalized_log_likelihood(last) - penalized_log_likelihood(other)
        if lost < selection.settings.negligible_gain:
            # What was tried in its place before was tried beside another gain or mass.
            selection.origins.pop(scale.other.label, None)
            selection.set_origin_to_first_batch(scale.other)
            further, reviews = explain(setup, searched.first, other)
            return replace(setup, scaled=True), replace(searched, last=further, reviews=reviews)
    return None


def without_worse(
    setup: SearchSetup, searched: SearchedEffects, label: str, leader: Leader, most: int
) -> tuple[SearchSetup, SearchedEffects]:
    """Go on without an effect that is no cause, though windows ask for it.

    Where its size may be nothing, and one of which the same was found explained no less, both stand
    for what no effect explains: others that may be in its place are not looked for.

    Parameters
    ----------
    setup : SearchSetup
        What the search works on.
    searched : SearchedEffects
        What it ended with.
    label : str
        Of the effect.
    leader : Leader
        What is said of it.
    most : int
        After so many such effects no others are looked for either.

    Returns
    -------
    tuple of SearchSetup and SearchedEffects
    """
    earlier = setup.worse
    worse = {**earlier, label: leader}
    setup = replace(setup, selection=_without(setup.selection, [label]), worse=worse)
    without = searched.reviews[label].without
    before = [one.gain for one in earlier.values() if one.why == MAY_BE_NOTHING]
    alike = leader.why == MAY_BE_NOTHING and leader.gain <= max(before, default=-np.inf)
    if alike or len(earlier) >= most:
        further, reviews = review(setup.selection, without)
    else:
        further, reviews = explain(setup, searched.first, without)
    return setup, replace(searched, last=further, reviews=reviews)


def worse_leader(searched: SearchedEffects, instance: EffectInstance, beyond: Beyond) -> Leader:
    """Return what is said of an effect with which errors after some horizon are larger.

    Parameters
    ----------
    searched : SearchedEffects
        What a search ended with.
    instance : EffectInstance
        One of its effects.
    beyond : Beyond
        By how much errors are larger, and after which horizon.

    Returns
    -------
    Leader
    """
    after = f"errors after {steps_text(beyond.steps)} are {number(beyond.ratio, 3)} times"
    why = f"{after} those without it ({beyond.unit})"
    return _refused(searched, instance, why, beyond.steps)


def that_may_be_nothing(
    library: Library, searched: SearchedEffects, level: float
) -> tuple[str, Leader] | None:
    """Return the effect whose size is least distinguished from nothing, where it may be nothing.

    Such an effect is what a misfit of another kind makes: all that is known of it is that something
    else is better explained with it. What changes a number of the model by less than a percent must
    be twice as far from nothing.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    searched : SearchedEffects
        What a search ended with.
    level : float
        Of the intervals of its sizes that all hold nothing.

    Returns
    -------
    tuple of str and Leader, or None
        Its label, and what is said of it. Of an effect that is so many times a shape, the first
        size alone counts. One on its bound is left alone, and so is one whose errors have few
        degrees of freedom, if it is new to the model; numbers that the model has matter in every
        motion, and so does its physics step, for which a delay that is shorter may stand. None
        where declared parameters are fitted: with a free mass, a size may only grow with it.
    """
    last = searched.last
    if not last.accepted or bool(np.any(last.free < library.declared)):
        return None
    errors, degrees = standard_errors(library, last)
    counted = np.maximum(degrees, FEWEST_DEGREES)
    widths = errors * student_quantile(0.5 + level / 2, counted)
    # Without what the effects add, totals are what the model has.
    nothing = np.zeros(len(last.theta))
    own = np.abs(totals_of(library, nothing, last.accepted))[last.free]
    widths = np.where(np.abs(last.theta[last.free]) < SMALL * own, 2.0, 1.0) * widths
    short = [library.indices_of[one.label] for one, _ in _short_delays(library, last)]
    told = (degrees >= FEWEST_DEGREES) | (own > 0) | np.isin(last.free, [*chain(*short)])
    # The data ask for more than a bound allows.
    space, sizes = library.simulator.space, last.theta[last.free]
    told &= (sizes == 0) | ((sizes > space.low[last.free]) & (sizes < space.high[last.free]))
    half = dict(zip(last.free[told].tolist(), widths[told], strict=True))
    found = []
    for instance in last.accepted:
        indices = library.indices_of[instance.label].tolist()
        scaling = indices[:1] if instance.scaled else indices
        if all(index in half for index in scaling):
            least = np.finfo(float).tiny
            most = max(abs(float(last.theta[i])) / max(half[i], least) for i in scaling)
            found.append((most, instance))
    if not found:
        return None
    most, instance = min(found, key=lambda one: one[0])
    if most >= 1:
        return None
    return instance.label, _refused(searched, instance, MAY_BE_NOTHING)


def _refused(
    searched: SearchedEffects, instance: EffectInstance, why: str, steps: int = 0
) -> Leader:
    """An effect that data held out ask for and that is no cause all the same."""
    gain, z = gain_of(searched.reviews[instance.label].without.test, searched.last.test)
    return Leader(
        effect=instance.effect,
        target=instance.target,
        variant=instance.variant,
        gain=gain,
        gain_se=gain / z if z > 0 else np.nan,
        times=np.nan,
        why=why,
        steps=steps,
    )


def _without(selection: Selection, labels: Collection[str]) -> Selection:
    """A search whose batches lack the trials of some effects."""
    left = replace(
        selection,
        origins={
            label: _without_trials(batch, labels) for label, batch in selection.origins.items()
        },
        batches=[_without_trials(batch, labels) for batch in selection.batches],
    )
    left.screening = selection.screening
    return left


def _without_trials(batch: Batch, refused: Collection[str]) -> Batch:
    """A batch without the trials of some effects, by their labels."""
    kept = [trial for trial in batch.trials if trial.candidate.instance.label not in refused]
    return replace(batch, trials=kept)
