"""Formulas that the residual forces at the joints ask for, each with the model it is added to."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, StepState
from dropo.core.services.validation import Array
from dropo.diagnosis.laws.forces import ResidualForces
from dropo.diagnosis.laws.pursuit import Proposal, PursuitSettings, different, propose
from dropo.diagnosis.laws.shapes import LawTerm, Ranges, ShapeSettings, shapes_at
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import without_effects
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import State
from dropo.effects.law import hidden_states, joint_variables, law_instance
from dropo.effects.support.formula_values import Program, evaluate
from dropo.mjmodel.dynamics.forces import motors
from dropo.mjmodel.joints import Joint, actuators, joints
from dropo.mjmodel.robot_simulator import RobotSimulator

LETTER = "c"
"""What the constants before the terms are called."""


@dataclass(frozen=True)
class IdeaSettings:
    """Which formulas are proposed.

    Attributes
    ----------
    added : int
        Formulas that are fitted by simulation beside all that was accepted.
    replacing : int
        Formulas that are so fitted in the place of effects that were accepted at a joint.
    similarity : float
        Cosine from which two formulas do the same to the data.
    quantiles : int
        Quantiles that say how a joint moves.
    chunk : int
        Terms that are whitened at once.
    shapes : ShapeSettings
        Which terms there are.
    pursuit : PursuitSettings
        How formulas are put together.
    """

    added: int = 6
    replacing: int = 3
    similarity: float = 0.998
    quantiles: int = 41
    chunk: int = 64
    shapes: ShapeSettings = field(default_factory=ShapeSettings)
    pursuit: PursuitSettings = field(default_factory=PursuitSettings)


@dataclass(frozen=True, eq=False)
class Idea:
    """A proposed formula, others that do the same, and the model that it is added to.

    Attributes
    ----------
    proposal : Proposal
        The formula.
    alike : list of Proposal
        Others.
    base : State
        The model.
    """

    proposal: Proposal
    alike: list[Proposal]
    base: State


@dataclass(frozen=True, eq=False)
class Terms:
    """The terms that are tried.

    Attributes
    ----------
    joints : tuple of Joint
        Where laws are looked for.
    shapes : tuple of list of LawTerm
        Those of each.
    count : int
        Of all joints together.
    """

    joints: tuple[Joint, ...]
    shapes: tuple[list[LawTerm], ...]
    count: int

    def at(self, name: str) -> "Terms":
        """Return those of one joint, of as many.

        Parameters
        ----------
        name : str
            The joint's.

        Returns
        -------
        Terms
        """
        (place,) = (i for i, joint in enumerate(self.joints) if joint.name == name)
        return replace(self, joints=(self.joints[place],), shapes=(self.shapes[place],))


def terms_of(
    simulator: RobotSimulator,
    forces: ResidualForces,
    taken: set[str | None],
    searched: set[str],
    settings: IdeaSettings,
) -> Terms:
    """List the terms that are tried at each joint whose state is measured.

    Parameters
    ----------
    simulator : RobotSimulator
        The model.
    forces : ResidualForces
        The windows, in which the joints move.
    taken : set of str or None
        Joints that have a law already.
    searched : set of str
        The effects that are looked for too.
    settings : IdeaSettings
        Which terms there are.

    Returns
    -------
    Terms
    """
    measured = set(simulator.layout.names)
    places = [
        joint
        for joint in joints(simulator.model)
        if {f"qpos.{joint.name}", f"qvel.{joint.name}"} <= measured and joint.name not in taken
    ]
    names = [joint.name for joint in places]
    shapes = [
        shapes_at(_ranges(simulator, forces, joint, names, searched, settings), settings.shapes)
        for joint in places
    ]
    return Terms(tuple(places), tuple(shapes), sum(map(len, shapes)))


def ideas_from(
    selection: Selection,
    library: Library,
    state: State,
    forces: ResidualForces,
    terms: Terms,
    settings: IdeaSettings,
) -> list[Idea]:
    """Propose the formulas that promise most.

    They are added to the model, or to the model without the effects at their joint that they may
    stand for: several of these look like one law, and leave too little of it to be seen.

    Parameters
    ----------
    selection : Selection
        The search.
    library : Library
        In which the forces were found: the search's own, or one with a law more.
    state : State
        The model, in the search's own library.
    forces : ResidualForces
        That it lacks.
    terms : Terms
        Of which formulas are made.
    settings : IdeaSettings
        Which formulas are proposed.

    Returns
    -------
    list of Idea
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    added: list[Proposal] = []
    replacing: list[tuple[Proposal, list[EffectInstance]]] = []
    for joint, own in zip(terms.joints, terms.shapes, strict=True):
        rows = _rows(simulator, forces, joint, own, settings)
        replaced = stand_ins(simulator, state, joint, own)
        # A term beside the effect that it stands for would take back what is too much of that.
        there = {one.effect for one in replaced}
        new = [i for i, shape in enumerate(own) if there.isdisjoint(shape.effects)]
        beside = [own[i] for i in new]
        added += _proposals(joint, beside, rows[new], forces, terms.count, settings)
        if replaced:
            bare = _without_known(library, forces, replaced)
            found = _proposals(joint, own, rows, bare, terms.count, settings)
            replacing += [(proposal, replaced) for proposal in found]
    ideas = [Idea(first, alike, state) for first, alike in _chosen(added, settings.added, settings)]
    by_joint = {proposal.joint: replaced for proposal, replaced in replacing}
    bases = {name: without_effects(selection, state, own) for name, own in by_joint.items()}
    proposals = [proposal for proposal, _ in replacing]
    for first, alike in _chosen(proposals, settings.replacing, settings):
        ideas.append(Idea(first, alike, bases[first.joint]))
    return ideas


def _without_known(
    library: Library, forces: ResidualForces, effects: Sequence[EffectInstance]
) -> ResidualForces:
    """The forces that are missing without some known effects.

    An effect that is so many times a shape is taken to be as its first number is.
    """
    side = forces.windows
    sizes = []
    for one in effects:
        own = library.indices_of[one.label]
        sizes.append(own[:1] if one.scaled else own)
    numbers = np.concatenate(sizes)
    slopes = library.jacobian(side.theta, numbers, side.windows)
    every = np.concatenate([library.indices_of[one.label] for one in effects])
    return forces.without(every, np.tensordot(side.theta[numbers], slopes, axes=1))


def without_law(library: Library, forces: ResidualForces, law: EffectInstance) -> ResidualForces:
    """Return the forces that are missing without a law.

    Parameters
    ----------
    library : Library
        That has the law.
    forces : ResidualForces
        That are missing with it.
    law : EffectInstance
        As `law_instance` makes it.

    Returns
    -------
    ResidualForces
        In the states, and by the responses, that the model with the law has.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    joint = joint_at(simulator, str(law.target))
    numbers = library.indices_of[law.label]
    constants = forces.windows.theta[numbers]
    values = values_at(simulator, forces, joint, program_of(law), constants, {})
    return forces.without(numbers, forces.changes(values[None], joint.qvel)[0])


def stand_ins(
    simulator: RobotSimulator, state: State, joint: Joint, shapes: Sequence[LawTerm]
) -> list[EffectInstance]:
    """Return the accepted effects at a joint, or of its drives, for which terms of laws stand.

    Parameters
    ----------
    simulator : RobotSimulator
        The model.
    state : State
        With the effects.
    joint : Joint
        The joint.
    shapes : sequence of LawTerm
        The terms.

    Returns
    -------
    list of EffectInstance
    """
    kinds = {effect for shape in shapes for effect in shape.effects}
    places = {joint.name}
    for drive in actuators(simulator.model):
        if drive.joint is not None and drive.joint.id == joint.id:
            places.add(drive.name)
    return [one for one in state.accepted if one.effect in kinds and one.target in places]


def may_stand_for_one_law(library: Library, state: State) -> bool:
    """Say whether several effects that were accepted at one joint may be one law.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    state : State
        The model with the effects.

    Returns
    -------
    bool
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return False
    every = shapes_at(Ranges(np.ones(2), np.ones(2), True, (), 1.0, True))
    found = (stand_ins(simulator, state, joint, every) for joint in joints(simulator.model))
    return any(len(one) > 1 for one in found)


def _proposals(
    joint: Joint,
    shapes: list[LawTerm],
    rows: Array,
    forces: ResidualForces,
    pool: int,
    settings: IdeaSettings,
) -> list[Proposal]:
    """The formulas of a joint that promise something.

    rows: (K, N) the whitened responses to its K terms; pool: terms at all joints.
    """
    columns, full = forces.unexplained(rows)
    return propose(
        joint.name,
        shapes,
        columns,
        forces.residuals,
        forces.variance,
        forces.windows.windows.steps,
        pool,
        full,
        settings.pursuit,
    )


def _chosen(
    proposals: list[Proposal], most: int, settings: IdeaSettings
) -> list[tuple[Proposal, list[Proposal]]]:
    """The best that differ, but of each joint and number of terms two at most, each with others
    like it.
    """
    ordered = sorted(proposals, key=lambda one: -one.score)
    chosen: list[tuple[Proposal, list[Proposal]]] = []
    counts: dict[tuple[str, int], int] = {}
    for group in different(ordered, settings.similarity):
        key = (group[0].joint, len(group[0].shapes))
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= 2 and len(chosen) < most:
            chosen.append(group)
    return chosen


def _ranges(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    measured: Sequence[str],
    searched: set[str],
    settings: IdeaSettings,
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


def _rows(
    simulator: RobotSimulator,
    forces: ResidualForces,
    joint: Joint,
    shapes: Sequence[LawTerm],
    settings: IdeaSettings,
) -> Array:
    """The whitened responses (K, N) to the terms."""
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
        forces.rows(values[first : first + settings.chunk], joint.qvel)
        for first in range(0, len(values), settings.chunk)
    ]
    return np.concatenate(parts)


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
