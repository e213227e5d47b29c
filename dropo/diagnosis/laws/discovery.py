"""Laws for what no known effect explains: proposed by the residual forces, fitted by simulation,
confirmed on data held out in competition with the effects of the registry.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, StepState
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.horizons import horizons
from dropo.diagnosis.laws.forces import ResidualForces, residual_forces, step_errors
from dropo.diagnosis.laws.pursuit import (
    Proposal,
    PursuitSettings,
    different,
    propose,
)
from dropo.diagnosis.laws.shapes import LawTerm, Ranges, ShapeSettings, shapes_at
from dropo.diagnosis.search.confirmation import gain_of, is_confirmed
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    whitener,
)
from dropo.diagnosis.search.review import Review, review
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import Batch, State, Trial, most_plausible_first
from dropo.effects.law import hidden_states, joint_variables, law_instance
from dropo.effects.support.formula_values import Program, evaluate
from dropo.mjmodel.dynamics.forces import motors
from dropo.mjmodel.joints import Joint, joints
from dropo.mjmodel.robot_simulator import RobotSimulator

LETTER = "c"
"""What the constants before the terms are called."""


@dataclass(frozen=True)
class LawSettings:
    """How laws are looked for.

    Attributes
    ----------
    refitted : int
        Formulas that are fitted by simulation for each law.
    laws : int
        Laws that are accepted at most, each at a joint of its own.
    similarity : float
        Cosine from which two formulas do the same to the data.
    worse : float
        Part by which errors after no printed horizon may grow.
    quantiles : int
        Quantiles that say how a joint moves.
    chunk : int
        Terms that are whitened at once.
    shapes : ShapeSettings
        Which terms there are.
    pursuit : PursuitSettings
        How formulas are put together.
    """

    refitted: int = 6
    laws: int = 2
    similarity: float = 0.998
    worse: float = 0.03
    quantiles: int = 41
    chunk: int = 64
    shapes: ShapeSettings = field(default_factory=ShapeSettings)
    pursuit: PursuitSettings = field(default_factory=PursuitSettings)


SETTINGS = LawSettings()
_Tried = tuple[Trial, Proposal, list[Proposal], Library]
"""A refitted law: its trial, its formula, others that do the same, and the library with it."""


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
    """

    called: str
    others: tuple[OtherFormula, ...]


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
        taken = {instance.target for instance in last.accepted if instance.formula}
        forces = residual_forces(selection.library, last, selection.floor)
        searched = {instance.effect for instance in instances}
        pool, proposals = _proposals(selection.library.simulator, forces, taken, searched, settings)
        tried = max(tried, pool)
        count = len(instances) + pool
        selection.progress(0.9, f"fitting laws, of {pool} terms tried")
        found = _confirmed(selection, last, first, proposals, count, settings)
        if found is None:
            break
        law, summary, state, larger = found
        laws[law.label] = summary
        selection, first, last = _extended(selection, larger), _padded(first, larger), state
        # With the law, others may be confirmed, and what stood in for it not be needed any more.
        last, reviews = review(selection, last)
        last = selection.run(first, last, instances)
        last, reviews = review(selection, last)
    present = {instance.label for instance in last.accepted}
    laws = {label: summary for label, summary in laws.items() if label in present}
    if not laws or _some_horizon_is_worse(problem, selection, begun, last, rng, settings):
        return None
    selection.latest = last
    return WithLaws(selection, first, last, reviews, laws, tried)


def _proposals(
    simulator: RobotSimulator,
    forces: ResidualForces,
    taken: set[str | None],
    searched: set[str],
    settings: LawSettings,
) -> tuple[int, list[tuple[Proposal, list[Proposal]]]]:
    """How many terms there are, and the formulas that promise most with others like them."""
    measured = set(simulator.layout.names)
    places = [
        joint
        for joint in joints(simulator.model)
        if {f"qpos.{joint.name}", f"qvel.{joint.name}"} <= measured and joint.name not in taken
    ]
    names = [joint.name for joint in places]
    shapes = {
        joint.name: shapes_at(
            _ranges(simulator, forces, joint, names, searched, settings), settings.shapes
        )
        for joint in places
    }
    pool = sum(map(len, shapes.values()))
    found: list[Proposal] = []
    steps = forces.windows.windows.steps
    for joint in places:
        own = shapes[joint.name]
        columns, full = _columns(simulator, forces, joint, own, settings)
        variance = forces.variance
        found += propose(
            joint.name,
            own,
            columns,
            forces.residuals,
            variance,
            steps,
            pool,
            full,
            settings.pursuit,
        )
    found.sort(key=lambda one: -one.score)
    groups = different(found, settings.similarity)
    # The best, but of each joint and number of terms two at least where there is room.
    chosen: list[tuple[Proposal, list[Proposal]]] = []
    counts: dict[tuple[str, int], int] = {}
    for group in groups:
        key = (group[0].joint, len(group[0].shapes))
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= 2 and len(chosen) < settings.refitted:
            chosen.append(group)
    return pool, chosen


def _ranges(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    measured: Sequence[str],
    searched: set[str],
    settings: LawSettings,
) -> Ranges:
    """How a joint moves in the windows."""
    grid = np.linspace(0, 1, settings.quantiles)
    driven = {one.id for one, _ in motors(simulator.model)}
    return Ranges(
        q=np.quantile(forces.states.qpos[:, joint.qpos], grid),
        v=np.quantile(forces.states.qvel[:, joint.qvel], grid),
        motor=joint.id in driven,
        others=tuple(name for name in measured if name != joint.name),
        seconds=float(forces.past.states[:, 0].max()),
        hinge=joint.kind == "hinge",
        effects=searched,
    )


def _columns(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    shapes: Sequence[LawTerm],
    settings: LawSettings,
) -> tuple[Array, Array]:
    """The whitened responses (K, N) to the terms, and their lengths (K,) with all they have."""
    context = simulator.effect_context
    values = np.empty((len(shapes), len(forces.states.time)))
    shared: dict[tuple[str, str], Array] = {}
    for i, shape in enumerate(shapes):
        own = dict(shape.own) | {LETTER: 1.0}
        text = f"{LETTER} * ({shape.written([name for name, _ in shape.own])})"
        law = law_instance(context, joint.name, text)
        constants = np.array([own[quantity.name] for quantity in law.quantities])
        values[i] = values_at(simulator, forces, joint, program_of(law), constants, shared)
    parts = [
        forces.columns(values[first : first + settings.chunk], joint.qvel)
        for first in range(0, len(values), settings.chunk)
    ]
    columns, lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
    return columns, lengths


def joint_at(simulator: RobotSimulator, name: str) -> Joint:
    """Find a slide or hinge by its name.

    Parameters
    ----------
    simulator : RobotSimulator
        The model.
    name : str
        The joint's name.

    Returns
    -------
    Joint

    Raises
    ------
    StopIteration
        If the model has no such slide or hinge.
    """
    return next(joint for joint in joints(simulator.model) if joint.name == name)


def program_of(law: EffectInstance) -> Program:
    """Return what a law of a joint evaluates.

    Parameters
    ----------
    law : EffectInstance
        A law, as `dropo.effects.law.law_instance` makes it.

    Returns
    -------
    Program
        Its formula, compiled.
    """
    hook = law.force
    program: Program = hook.args[-1]  # type: ignore[union-attr]
    return program


def values_at(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    program: Program,
    constants: Array,
    shared: dict[tuple[str, str], Array],
) -> Array:
    """Evaluate a formula in the states of all windows.

    Parameters
    ----------
    simulator : RobotSimulator
        The model.
    forces : ResidualForces
        The windows.
    joint : Joint
        Where the formula acts.
    program : Program
        The formula.
    constants : (q,) array
        Its constants.
    shared : dict
        Variables that were computed before; those of this formula are added.

    Returns
    -------
    (W (L + 1),) array
    """
    ids = tuple({one.id: own for one, own in motors(simulator.model)}.get(joint.id, ()))
    others = tuple((one.name, one.qpos, one.qvel) for one in joints(simulator.model))

    def variables(state: StepState) -> dict[tuple[str, str], Array]:
        """The variables of the formula."""
        return joint_variables(state, joint, ids, others, program.variables)

    if not program.hidden:
        missing = [one for one in program.variables if one not in shared]
        shared |= joint_variables(forces.states, joint, ids, others, missing)
        if not program.variables:
            return np.broadcast_to(evaluate(program, {}, constants, {}), forces.states.time.shape)
        return evaluate(program, {one: shared[one] for one in program.variables}, constants, {})
    # Hidden states follow the recorded motion from its beginning.
    hidden = hidden_states(program, forces.states, forces.past, variables, constants)
    rows = forces.past.states
    model = simulator.model
    time, qpos, qvel, act = np.split(rows, np.cumsum([1, model.nq, model.nv]), axis=1)
    state = StepState(qpos, qvel, forces.past.commands, 0, act, forces.states.model, time[:, 0])
    whole = evaluate(program, variables(state), constants, dict(hidden))
    after = forces.steps[:, -1:] + 1
    last = np.minimum(after, len(whole) - 1)
    last = np.where(rows[last, 0] == 0, forces.steps[:, -1:], last)
    return whole[np.concatenate([forces.steps, last], axis=1)].ravel()


def formula_of(proposal: Proposal) -> tuple[str, dict[str, float]]:
    """Write a proposal as a formula with first sizes of its constants.

    Parameters
    ----------
    proposal : Proposal
        The terms and the constants before them.

    Returns
    -------
    text : str
        Such as "-c * abs(v) * v", with positive constants.
    sizes : dict of str to float
        By constant.
    """
    sizes: dict[str, float] = {}
    text = ""
    several = len(proposal.shapes) > 1
    for i, (shape, size) in enumerate(zip(proposal.shapes, proposal.sizes.tolist(), strict=True)):
        names = []
        for name, first in shape.own:
            own = f"{name}{i + 1}" if several else name
            sizes[own] = first
            names.append(own)
        letter = f"{LETTER}{i + 1}" if several else LETTER
        sizes[letter] = abs(size)
        sign = "-" if size < 0 else "+"
        term = f"{letter} * {shape.written(names)}".removesuffix(" * 1")
        text += f" {sign} {term}"
    text = text.strip()
    return (text[2:] if text.startswith("+") else f"-{text[2:]}"), sizes


def _confirmed(
    selection: Selection,
    state: State,
    first: State,
    groups: Sequence[tuple[Proposal, list[Proposal]]],
    count: int,
    settings: LawSettings,
) -> tuple[EffectInstance, FoundLaw, State, Library] | None:
    """The law that data held out confirm, what is said of it, the state and library with it."""
    if not groups:
        return None
    trials = [_tried(selection, state, proposal, alike) for proposal, alike in groups]
    ordered = most_plausible_first(
        sorted((trial for trial, *_ in trials), key=lambda one: -one.penalized_gain),
        selection.settings,
    )
    by_trial = {id(one[0]): one for one in trials}
    needed = selection.settings.needed_gain(count)
    for trial in ordered[: selection.settings.maximum_polished]:
        if trial.fitted_gain <= selection.settings.minimum_fitted_gain:
            continue
        _, proposal, alike, library = by_trial[id(trial)]
        own = _extended(selection, library)
        if own.only_by_feedback(trial.state):
            continue
        polished = own.polish(trial.state)
        trial, proposal, library, polished = _pruned(
            selection, state, (trial, proposal, [], library), polished
        )
        if not is_confirmed(state.test, polished.test, needed, selection.settings):
            continue
        if not _of_the_machine(library, state, polished, needed, selection):
            continue
        summary = _summary_of(proposal, alike, trial, polished, by_trial, selection)
        return trial.candidate.instance, summary, polished, library
    return None


def _of_the_machine(
    library: Library, state: State, polished: State, needed: float, selection: Selection
) -> bool:
    """Whether a law is more than what the length of the physics steps does.

    With the model's own steps or with infinitely short ones, it is confirmed against the model
    without it under both: a machine may be a simulation whose steps are the model's.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    own = _padded_side(state.test, library)

    def exact(side: LinearizedWindows) -> LinearizedWindows:
        """The windows as short steps would predict them, under the noise that is then left."""
        errors = step_errors(simulator, side)
        errors[side.lost] = 0.0
        moved = replace(side, residuals=side.residuals - errors)
        noise = estimate_noise(moved, side.whiten.noise, selection.floor)
        whiten = whitener(library, side.windows, side.theta, noise, side.loadings)
        return replace(moved, whiten=whiten)

    without = (own, exact(own))

    def holds(after: LinearizedWindows) -> bool:
        """Whether it is confirmed against the model without it under both."""
        return all(is_confirmed(before, after, needed, selection.settings) for before in without)

    return holds(polished.test) or holds(exact(polished.test))


def _tried(
    selection: Selection, state: State, proposal: Proposal, alike: list[Proposal]
) -> "_Tried":
    """A state refitted with a proposed law, and the library that has the law."""
    context = selection.library.simulator.effect_context  # type: ignore[attr-defined]
    text, sizes = formula_of(proposal)
    law = law_instance(context, proposal.joint, text, typical=sizes)
    library = _larger(selection.library, law)
    own = _extended(selection, library)
    order = np.array([sizes[quantity.name] for quantity in law.quantities])
    candidate = Candidate(law, order, proposal.gain, proposal.signature)
    (trial,) = own.try_candidates(_padded(state, library), [candidate])
    return trial, proposal, alike, library


def _pruned(
    selection: Selection, state: State, tried: "_Tried", polished: State
) -> tuple[Trial, Proposal, Library, State]:
    """A law without the terms that data held out do not ask for, fitted to the end."""
    trial, proposal, alike, library = tried
    for i in range(len(proposal.shapes)):
        if len(proposal.shapes) == 1:
            break
        kept = [k for k in range(len(proposal.shapes)) if k != i]
        shapes = tuple(proposal.shapes[k] for k in kept)
        if all(shape.known for shape in shapes):
            continue
        sizes = _fitted(proposal, trial.candidate.instance, polished, library)
        fewer = replace(proposal, shapes=shapes, sizes=sizes[kept])
        again = _tried(selection, state, fewer, alike)
        whole = _extended(selection, again[3]).polish(again[0].state)
        if gain_of(whole.test, polished.test)[0] < selection.settings.deficit:
            return _pruned(selection, state, (again[0], fewer, alike, again[3]), whole)
    return trial, proposal, library, polished


def _fitted(proposal: Proposal, law: EffectInstance, polished: State, library: Library) -> Array:
    """The constants (k,) before the terms of a proposal as fitted, with their signs."""
    numbers = polished.theta[library.places[law.label]]
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
    trials: Mapping[int, _Tried],
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
    for trial, other, likes, _ in trials.values():
        if trial is accepted or not is_other(other):
            continue
        deficit, z = gain_of(trial.state.test, polished.test)
        if not (z < limit or deficit < selection.settings.deficit):
            continue
        text = formula_of(other)[0]
        why = f"{deficit:.1f} nats worse on held-out data, {z:.1f} standard errors"
        others[f"{other.joint}:{text}"] = OtherFormula(text, other.joint, why)
        for like in filter(is_other, likes[:1]):
            text = formula_of(like)[0]
            why = f"similarity {float(like.signature @ other.signature):.3f} to the one before"
            others.setdefault(f"{like.joint}:{text}", OtherFormula(text, like.joint, why))
    for like in filter(is_other, alike[:3]):
        text = formula_of(like)[0]
        why = f"similarity {float(like.signature @ proposal.signature):.3f}"
        others.setdefault(f"{like.joint}:{text}", OtherFormula(text, like.joint, why))
    return FoundLaw(name_of(proposal), tuple(others.values())[:4])


def name_of(proposal: Proposal) -> str:
    """Name the nearest known law: that of the terms that are no known effects.

    Parameters
    ----------
    proposal : Proposal
        The terms of a formula.

    Returns
    -------
    str
        The laws' names, joined by "and".
    """
    names = [shape.law for shape in proposal.shapes if not shape.known]
    beside = [shape.law for shape in proposal.shapes if shape.known]
    return " and ".join(dict.fromkeys([*names, *beside]))


def _larger(library: Library, law: EffectInstance) -> Library:
    """A library with one more effect, behind all others."""
    simulator = library.simulator.with_effects([law])  # type: ignore[attr-defined]
    simulator.steps = library.simulator.steps
    return Library(simulator, [*library.instances, law], library.declared, library.differences)


def _extended(selection: Selection, library: Library) -> Selection:
    """The search in a larger library, its batches with places for what is new there."""
    batches = {id(one): _padded_batch(one, library) for one in selection.batches}
    own = replace(selection, library=library, batches=list(batches.values()), origins={})
    own.origins.update(
        {label: batches.get(id(one), one) for label, one in selection.origins.items()}
    )
    own.screening.first_responses.update(selection.screening.first_responses)
    own.screening.counted.update(selection.screening.counted)
    own.screening.first_windows = (
        None
        if selection.screening.first_windows is None
        else _padded_side(selection.screening.first_windows, library)
    )
    return own


def _padded_batch(one: Batch, library: Library) -> Batch:
    """A batch with places for what is new in a library."""
    trials = [replace(trial, state=_padded(trial.state, library)) for trial in one.trials]
    return Batch(_padded(one.before, library), one.screened, trials)


def _padded(state: State, library: Library) -> State:
    """A state with places for what is new in a library, which it does not have."""
    return replace(
        state,
        train=_padded_side(state.train, library),
        test=_padded_side(state.test, library),
    )


def _padded_side(side: LinearizedWindows, library: Library) -> LinearizedWindows:
    """Windows with places for what is new in a library."""
    new = len(library.simulator.space) - len(side.theta)
    theta = np.append(side.theta, np.zeros(new))
    at, noise = side.linearized_at
    return replace(side, theta=theta, linearized_at=(np.append(at, np.zeros(new)), noise))


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
    before = _padded(begun, library)
    (draws,) = rng.spawn(1)
    without, with_laws = horizons(problem, library, [before.theta, last.theta], last, draws)
    for old, new in zip(without, with_laws, strict=True):
        if not new.rmse <= (1 + settings.worse) * max(old.rmse, new.noise):
            return True
    return False
