"""Laws for what no known effect explains: proposed by the residual forces, fitted by simulation,
confirmed on data held out in competition with the effects of the registry.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.horizons import horizons
from dropo.diagnosis.laws.extension import (
    extended,
    padded,
    places_of_laws,
    with_laws,
)
from dropo.diagnosis.laws.forces import ResidualForces, residual_forces, step_errors
from dropo.diagnosis.laws.ideas import (
    LETTER,
    Idea,
    IdeaSettings,
    Terms,
    formula_of,
    ideas_from,
    joint_at,
    name_of,
    program_of,
    stand_ins,
    terms_of,
    without_law,
)
from dropo.diagnosis.laws.pursuit import Proposal
from dropo.diagnosis.laws.shapes import LawTerm, Ranges, shapes_at
from dropo.diagnosis.search.confirmation import SelectionSettings, gain_of, is_confirmed
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    whitener,
)
from dropo.diagnosis.search.review import Review, review
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import (
    State,
    Trial,
    most_plausible_first,
    penalized_log_likelihood,
)
from dropo.effects.law import law_instance
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class LawSettings:
    """How laws are looked for.

    Attributes
    ----------
    recovered : float
        Fraction of what effects explain that were accepted at a joint that a formula in their place
        must explain before it is fitted to the end.
    beyond : float
        How many times as much as it promised the best formula must gain for others to be looked for
        from there: the forces were found far from the motion then.
    laws : int
        Laws that are accepted at most, each at a joint of its own.
    worse : float
        Part by which errors after no printed horizon may grow.
    ideas : IdeaSettings
        Which formulas are proposed.
    """

    recovered: float = 0.95
    beyond: float = 1.5
    laws: int = 2
    worse: float = 0.03
    ideas: IdeaSettings = field(default_factory=IdeaSettings)


SETTINGS = LawSettings()
_Tried = tuple[Trial, Proposal, list[Proposal], Library]
"""A refitted law: its trial, its formula, others that do the same, and the library with it."""
_Views = tuple[LinearizedWindows, LinearizedWindows]
"""Windows under a model's own physics steps, and as infinitely short ones would predict them."""


@dataclass(frozen=True)
class OtherFormula:
    """A formula that the data cannot tell from a law.

    Attributes
    ----------
    formula : str
        Its text.
    target : str
        Its joint.
    why : str
        Why not.
    """

    formula: str
    target: str
    why: str


@dataclass(frozen=True)
class FoundLaw:
    """What is said of a law beside its sizes.

    Attributes
    ----------
    called : str
        The nearest law that has a name.
    others : tuple of OtherFormula
        Other formulas that the data cannot tell from it.
    shapes : tuple of LawTerm
        Its terms.
    curve : str
        The variable over which its terms, and known effects beside it, draw one curve together:
        another sum may draw the same, and none of them is a cause by itself. "" where each stands
        alone.
    """

    called: str
    others: tuple[OtherFormula, ...]
    shapes: tuple[LawTerm, ...] = ()
    curve: str = ""


@dataclass(frozen=True, eq=False)
class WithLaws:
    """A search that went on with laws.

    Attributes
    ----------
    selection : Selection
        The search, whose library has the laws.
    first, last : State
        As they were, with places for the laws' constants; and the model with the laws.
    reviews : mapping of str to Review
        Of each accepted effect, by its label.
    laws : mapping of str to FoundLaw
        By the label of each law.
    tried : int
        How many formulas were tried.
    """

    selection: Selection
    first: State
    last: State
    reviews: Mapping[str, Review]
    laws: Mapping[str, FoundLaw]
    tried: int


def find_laws(
    problem: Problem,
    selection: Selection,
    first: State,
    last: State,
    instances: Sequence[EffectInstance],
    rng: np.random.Generator,
    settings: LawSettings = SETTINGS,
) -> WithLaws | None:
    """Look for laws of force at the joints in what a search left unexplained.

    Parameters
    ----------
    problem : Problem
        That is diagnosed.
    selection : Selection
        The search that ended.
    first, last : State
        The model as it is, and where the search ended.
    instances : sequence of EffectInstance
        The effects that were looked for, which compete with laws.
    rng : numpy.random.Generator
        Draws the starts of windows by which horizons are compared.
    settings : LawSettings
        How laws are looked for.

    Returns
    -------
    WithLaws or None
        None where no law is confirmed.
    """
    if not isinstance(selection.library.simulator, RobotSimulator):
        return None
    begun = last
    tried = 0
    laws: dict[str, FoundLaw] = {}
    for _ in range(settings.laws):
        taken = places_of_laws(selection.library)
        forces = residual_forces(selection.library, last, selection.floor)
        searched = {instance.effect for instance in instances}
        simulator: RobotSimulator = selection.library.simulator
        terms = terms_of(simulator, forces, taken, searched, settings.ideas)
        tried = max(tried, terms.count)
        selection.progress(0.9, f"fitting laws, of {terms.count} terms tried")
        refitted = _refitted(selection, last, forces, terms, settings)
        count = len(instances) + terms.count
        found = _confirmed(selection, last, refitted, count, settings.recovered)
        if found is None:
            break
        law, summary, state, larger = found
        laws[law.label] = summary
        selection, first, last = extended(selection, larger), padded(first, larger), state
        # With the law, others may be confirmed, and what stood in for it not be needed any more.
        last, reviews = review(selection, last)
        last = selection.run(first, last, instances)
        last, reviews = _without_what_steps_do(selection, last)
    laws = {
        one.label: replace(laws[one.label], curve=_curve(selection.library, last, one, laws))
        for one in last.accepted
        if one.label in laws
    }
    if not laws or _some_horizon_is_worse(problem, selection, begun, last, rng, settings):
        return None
    selection.latest = last
    return WithLaws(selection, first, last, reviews, laws, tried)


def _curve(
    library: Library, state: State, law: EffectInstance, laws: Mapping[str, FoundLaw]
) -> str:
    """The variable over which a law and what stands beside it draw one curve together.

    A sine and a cosine of one angle are one shape.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    joint = joint_at(simulator, str(law.target))
    every = shapes_at(Ranges(np.ones(2), np.ones(2), True, (), 1.0, True))
    beside = {one.effect for one in stand_ins(simulator, state, joint, every)}
    pieces: dict[tuple[str, str], set[str]] = {}

    def note(shape: LawTerm, called: str) -> None:
        """A piece of the curve over the one variable that a term has."""
        text = f"{LETTER} * ({shape.written([name for name, _ in shape.own])})"
        program = program_of(law_instance(simulator.effect_context, joint.name, text))
        if len(program.variables) == 1 and not program.hidden:
            pieces.setdefault(program.variables[0], set()).add(called)

    for i, shape in enumerate(laws[law.label].shapes):
        ripple = shape.text.replace("sin(", "cos(")
        note(shape, ripple if "cos(" in ripple else f"{i}")
    for shape in every:
        for effect in beside.intersection(shape.effects):
            note(shape, effect)
    for (name, owner), called in pieces.items():
        if len(called) > 1:
            field = {"q": "qpos", "v": "qvel"}.get(name, name)
            return f"{field}.{owner or joint.name}"
    return ""


def _refitted(
    selection: Selection,
    state: State,
    forces: ResidualForces,
    terms: Terms,
    settings: LawSettings,
) -> list[tuple[_Tried, State]]:
    """The formulas that promise most, refitted by simulation, each with the model it is added to.

    Where the best gains more than the forces promised, those were found too far from the motion:
    more are proposed by the forces that are found with it, and what it explains.
    """
    library = selection.library

    def fitted(idea: Idea) -> tuple[_Tried, State]:
        """A formula refitted; in the place of effects to the end, since it begins far off."""
        far = idea.base is not state
        return _tried(selection, idea.base, idea.proposal, idea.alike, far), idea.base

    ideas = ideas_from(selection, library, state, forces, terms, settings.ideas)
    tried = [fitted(one) for one in ideas]
    if not tried:
        return []
    best, base = max(tried, key=lambda one: penalized_log_likelihood(one[0][0].state))
    trial, proposal, _, larger = best
    if trial.fitted_gain < settings.beyond * proposal.gain:
        return tried
    again = without_law(
        larger, residual_forces(larger, trial.state, selection.floor), trial.candidate.instance
    )
    there = terms.at(proposal.joint)
    known = {_named(one) for one in ideas}
    more = ideas_from(selection, larger, base, again, there, settings.ideas)
    return tried + [fitted(one) for one in more if _named(one) not in known]


def _named(idea: Idea) -> tuple[str, str, frozenset[str]]:
    """The joint and formula of an idea, and the effects beside it."""
    beside = frozenset(one.label for one in idea.base.accepted)
    return idea.proposal.joint, formula_of(idea.proposal)[0], beside


def _confirmed(
    selection: Selection,
    state: State,
    tried: Sequence[tuple[_Tried, State]],
    count: int,
    recovered: float,
) -> tuple[EffectInstance, FoundLaw, State, Library] | None:
    """The law that data held out confirm, what is said of it, the state and library with it.

    One with fewer numbers, in the place of effects, is chosen unless the first is better by more
    than what the length of the physics steps does.

    count: formulas and effects that were tried; recovered: as of `LawSettings`.
    """
    if not tried:
        return None
    settings = selection.settings
    ranked = _ranked(selection, state, tried)
    needed = settings.needed_gain(count)
    before = _views(selection.library, state, selection)
    chosen: tuple[EffectInstance, FoundLaw, State, Library] | None = None
    views: _Views | None = None
    left = settings.maximum_polished
    for one, base in ranked:
        if not left:
            break
        if chosen is not None and len(one[0].state.free) >= len(chosen[2].free):
            continue
        gain, _ = gain_of(state.train, one[0].state.train)
        needed_fit = settings.minimum_fitted_gain
        added = len(base.accepted) == len(state.accepted)
        if not added:
            # What it stands for need not be explained better, with fewer numbers.
            lost, _ = gain_of(base.train, state.train)
            needed_fit = -max((1 - recovered) * lost, settings.usual_margin)
        if gain <= needed_fit:
            continue
        left -= 1
        own = extended(selection, one[3])
        if own.only_by_feedback(one[0].state):
            continue
        polished = own.polish(one[0].state) if added else one[0].state
        held_out, _ = gain_of(state.test, polished.test)
        if added and held_out < settings.polished_fraction * needed:
            continue
        trial, proposal, library, polished = _pruned(selection, base, one, polished, not added)
        after = _views(library, polished, selection)
        better = is_confirmed(state.test, polished.test, needed, settings)
        better = better and _is_of_the_machine(before, after, needed, settings)
        if not better and not _is_simpler(state, polished, selection):
            continue
        if views is not None and _is_of_the_machine(after, views, needed, settings):
            continue
        refitted = [each for each, _ in tried]
        summary = _summary_of(proposal, one[2], trial, polished, refitted, selection)
        chosen = trial.candidate.instance, summary, polished, library
        views = after
    return chosen


def _ranked(
    selection: Selection, state: State, tried: Sequence[tuple[_Tried, State]]
) -> list[tuple[_Tried, State]]:
    """The refitted formulas with their bases, the most plausible first, compared as short physics
    steps would predict where the best is better so.

    Several terms can do what the length of the steps does.
    """
    by_trial: dict[int, tuple[_Tried, State]] = {}
    views: list[list[Trial]] = []
    for short in (False, True):
        fitted_before = _view(selection.library, state.train, selection, short)
        held_out_before = _view(selection.library, state.test, selection, short)
        trials = []
        for one, base in tried:
            train = _view(one[3], one[0].state.train, selection, short)
            test = _view(one[3], one[0].state.test, selection, short)
            after = replace(one[0].state, train=train, test=test)
            fitted, _ = gain_of(fitted_before, train)
            held_out, z = gain_of(held_out_before, test)
            trial = replace(one[0], state=after, fitted_gain=fitted, held_out_gain=held_out, z=z)
            by_trial[id(trial)] = one, base
            trials.append(trial)
        views.append(sorted(trials, key=lambda trial: -trial.penalized_gain))
    heights = [
        max(float(trial.state.test.log_likelihood.sum()) for trial in trials) for trials in views
    ]
    short = heights[1] > heights[0]
    ordered = most_plausible_first(views[short], selection.settings)
    return [by_trial[id(trial)] for trial in ordered]


def _view(
    library: Library, side: LinearizedWindows, selection: Selection, short: bool
) -> LinearizedWindows:
    """Windows as they are, or as short physics steps would predict them."""
    return _with_short_steps(library, side, selection) if short else side


def _with_short_steps(
    library: Library, side: LinearizedWindows, selection: Selection
) -> LinearizedWindows:
    """The windows as short physics steps would predict them, under the noise that is then left."""
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    errors = step_errors(simulator, side)
    errors[side.lost] = 0.0
    moved = replace(side, residuals=side.residuals - errors)
    noise = estimate_noise(moved, side.whiten.noise, selection.floor)
    whiten = whitener(library, side.windows, side.theta, noise, side.loadings)
    return replace(moved, whiten=whiten)


def _is_simpler(state: State, polished: State, selection: Selection) -> bool:
    """Whether a law does better with fewer numbers than the effects in whose place it is."""
    gain = penalized_log_likelihood(polished) - penalized_log_likelihood(state)
    return len(polished.free) < len(state.free) and gain > selection.settings.negligible_gain


def _views(library: Library, state: State, selection: Selection) -> _Views:
    """The windows held out, with a model's own physics steps and with infinitely short ones."""
    return state.test, _with_short_steps(library, state.test, selection)


def _is_of_the_machine(
    before: _Views, after: _Views, needed: float, settings: SelectionSettings
) -> bool:
    """Whether a model is better than another by more than what the length of physics steps does.

    With its own steps or with infinitely short ones, it is confirmed against the other under both:
    a machine may be a simulation whose steps are the model's.
    """
    return any(all(is_confirmed(old, new, needed, settings) for old in before) for new in after)


def _without_what_steps_do(selection: Selection, state: State) -> tuple[State, dict[str, Review]]:
    """A model with laws, reviewed, without effects that do what the length of the steps does.

    A law's force is held over a physics step, which its own drive's gain may seem to make up for.
    Such an effect gains nothing as short steps would predict.
    """
    library = selection.library
    while True:
        state, reviews = review(selection, state)
        exact = _with_short_steps(library, state.test, selection)
        idle = []
        for one in state.accepted:
            without = reviews[one.label].without
            gain, _ = gain_of(_with_short_steps(library, without.test, selection), exact)
            if not one.formula and gain < selection.settings.negligible_gain:
                idle.append(without)
        if not idle:
            return state, reviews
        state = max(idle, key=penalized_log_likelihood)


def _tried(
    selection: Selection, state: State, proposal: Proposal, alike: list[Proposal], far: bool
) -> "_Tried":
    """A state refitted with a proposed law, to the end if that is far, and the library with it."""
    context = selection.library.simulator.effect_context  # type: ignore[attr-defined]
    text, sizes = formula_of(proposal)
    law = law_instance(context, proposal.joint, text, typical=sizes)
    library = with_laws(selection.library, [law])
    own = extended(selection, library)
    order = np.array([sizes[quantity.name] for quantity in law.quantities])
    candidate = Candidate(law, order, proposal.gain, proposal.signature)
    (trial,) = own.try_candidates(padded(state, library), [candidate])
    if far:
        trial = replace(trial, state=own.polish(trial.state))
    return trial, proposal, alike, library


def _pruned(
    selection: Selection, state: State, tried: "_Tried", polished: State, far: bool
) -> tuple[Trial, Proposal, Library, State]:
    """A law without the terms that data held out do not ask for, fitted to the end.

    They ask for one if it gains something with the model's own physics steps and with short ones.

    far: whether the state is far from that with the law.
    """
    trial, proposal, alike, library = tried
    settings = selection.settings
    if len(proposal.shapes) == 1:
        return trial, proposal, library, polished
    as_tried = _views(library, trial.state, selection)
    whole = _views(library, polished, selection)
    for i in range(len(proposal.shapes)):
        kept = [k for k in range(len(proposal.shapes)) if k != i]
        shapes = tuple(proposal.shapes[k] for k in kept)
        if all(shape.known for shape in shapes):
            continue
        sizes = _fitted(proposal, trial.candidate.instance, polished, library)
        fewer = replace(proposal, shapes=shapes, sizes=sizes[kept])
        again = _tried(selection, state, fewer, alike, far)
        without = _views(again[3], again[0].state, selection)
        of_the_others = (1 - settings.polished_fraction) * max(0.0, trial.held_out_gain)
        if _gained(without, as_tried) > settings.negligible_gain + of_the_others:
            continue
        refitted = again[0].state
        if not far:
            refitted = extended(selection, again[3]).polish(refitted)
        without = _views(again[3], refitted, selection)
        if _gained(without, whole) < settings.negligible_gain:
            return _pruned(selection, state, again, refitted, far)
    return trial, proposal, library, polished


def _gained(before: _Views, after: _Views) -> float:
    """What a model gains over another [nats], in the view in which that is less."""
    return min(gain_of(old, new)[0] for old, new in zip(before, after, strict=True))


def _fitted(proposal: Proposal, law: EffectInstance, polished: State, library: Library) -> Array:
    """The constants (k,) before the terms of a proposal as fitted, with their signs."""
    numbers = polished.theta[library.indices_of[law.label]]
    by_name = dict(zip([q.name for q in law.quantities], numbers.tolist(), strict=True))
    names = [LETTER]
    if len(proposal.shapes) > 1:
        names = [f"{LETTER}{k + 1}" for k in range(len(proposal.shapes))]
    return np.array([np.sign(s) * by_name[n] for n, s in zip(names, proposal.sizes, strict=True)])


def _summary_of(
    proposal: Proposal,
    alike: Sequence[Proposal],
    accepted: Trial,
    polished: State,
    trials: Sequence[_Tried],
    selection: Selection,
) -> FoundLaw:
    """The name of a law, and the formulas that cannot be distinguished from it.

    One with more terms beside those of the law is no other one.
    """
    own = {shape.text for shape in proposal.shapes}

    def is_other(one: Proposal) -> bool:
        """Whether a formula lacks a term of the law, or is of another joint."""
        return one.joint != proposal.joint or not own <= {shape.text for shape in one.shapes}

    others: dict[str, OtherFormula] = {}
    limit = selection.settings.indistinguishable_z
    for trial, other, likes, _ in trials:
        if trial is accepted or not is_other(other):
            continue
        loss, z = gain_of(trial.state.test, polished.test)
        if not (z < limit or loss < selection.settings.negligible_gain):
            continue
        text = formula_of(other)[0]
        why = f"{loss:.1f} nats worse on held-out data, {z:.1f} standard errors"
        others[f"{other.joint}:{text}"] = OtherFormula(text, other.joint, why)
        for like in filter(is_other, likes[:1]):
            text = formula_of(like)[0]
            why = f"similarity {float(like.signature @ other.signature):.3f} to the one before"
            others.setdefault(f"{like.joint}:{text}", OtherFormula(text, like.joint, why))
    for like in filter(is_other, alike[:3]):
        text = formula_of(like)[0]
        why = f"similarity {float(like.signature @ proposal.signature):.3f}"
        others.setdefault(f"{like.joint}:{text}", OtherFormula(text, like.joint, why))
    return FoundLaw(name_of(proposal), tuple(others.values())[:4], proposal.shapes)


def _some_horizon_is_worse(
    problem: Problem,
    selection: Selection,
    begun: State,
    last: State,
    rng: np.random.Generator,
    settings: LawSettings,
) -> bool:
    """Whether errors after some printed horizon are larger with the laws than without them."""
    library = selection.library
    before = padded(begun, library)
    (draws,) = rng.spawn(1)
    without, later = horizons(problem, library, [before.theta, last.theta], last, draws)
    for old, new in zip(without, later, strict=True):
        if not new.rmse <= (1 + settings.worse) * max(old.rmse, new.noise):
            return True
    return False
