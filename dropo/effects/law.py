"""A formula that was found in data, or written down."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import (
    EffectContext,
    EffectInstance,
    Quantity,
    RecordedPast,
    StepState,
)
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known
from dropo.effects.support.formula import Units, read_formula
from dropo.effects.support.formula_values import Node, Program, evaluate, evaluate_with, followed
from dropo.mjmodel.dynamics.forces import joint_loads, motor_force, motors
from dropo.mjmodel.joints import Joint, actuators, joints
from dropo.mjmodel.kinematics import centre_motion
from dropo.mjmodel.names import element_names
from dropo.mjmodel.options import physics_step

COMMAND = "command"
"""The variant of a law of an actuator's command."""
AXES = ("x", "y", "z")
"""The variants of a law of a body: the world's axis that its force is along."""
WIDTH = 100.0
"""The bounds of a constant, in multiples of its typical size."""
Variables = Callable[[StepState], dict[tuple[str, str], Array]]
"""Gives the variables of a law in n states."""
KEPT = 32
"""How many pasts of hidden states are kept."""


def law(context: EffectContext) -> Iterator[EffectInstance]:
    """A law has a place and numbers once it has a formula: see `law_instance`.

    Parameters
    ----------
    context : EffectContext
        The robot, which is not looked at.

    Returns
    -------
    iterator of EffectInstance
        Empty.
    """
    del context
    return iter(())


def law_instance(
    context: EffectContext,
    target: str | None,
    text: str,
    variant: str = "",
    *,
    constants: Collection[str] | None = None,
    typical: Mapping[str, float] | None = None,
) -> EffectInstance:
    """Make the effect of a formula at a place.

    Parameters
    ----------
    context : EffectContext
        The robot.
    target : str
        A slide or hinge, where the value is a force; an actuator for the variant "command", where
        it is added to its command behind the clamp; a body for "x", "y" and "z", where it is a
        force at its centre of mass along that axis of the world.
    text : str
        The formula.
    variant : str
        "", "command", "x", "y" or "z".
    constants : collection of str, optional
        The names that are constants; all that are no variables if None.
    typical : mapping of str to float, optional
        Sizes of the constants; 1 where they are not given.

    Returns
    -------
    EffectInstance
        Its magnitudes are the constants.

    Raises
    ------
    BadArgument
        If the text is no formula, or its units do not go together.
    UnknownName
        If the place, a variable or a function does not exist; with the nearest one.
    """
    place = _place(context, target, variant)
    formula = read_formula(text, place.units, place.unit, constants)
    wanted = typical or {}
    quantities = []
    for name, unit, scale in zip(
        formula.program.constants, formula.units, formula.scales, strict=True
    ):
        size = abs(wanted.get(name, 1.0)) or 1.0
        low = 0.0 if scale else -WIDTH * size
        quantities.append(Quantity(name, unit, low, WIDTH * size, (0.1 * size,)))
    together = tuple(abs(wanted.get(q.name, 1.0)) or 1.0 for q in quantities)
    hook: dict[str, Any] = {place.hook: partial(place.act, *place.arguments, formula.program)}
    return EffectInstance(
        "law",
        target,
        tuple(quantities),
        variant,
        **hook,
        formula=formula.text,
        remembers=bool(formula.program.hidden),
        trials=(((together),),),
    )


def places(context: EffectContext, variant: str = "") -> list[str]:
    """List the places of laws of a variant.

    Parameters
    ----------
    context : EffectContext
        The robot.
    variant : str
        As of `law_instance`.

    Returns
    -------
    list of str
        Joints, actuators or bodies.
    """
    if variant == "":
        return [joint.name for joint in joints(context.model)]
    if variant == COMMAND:
        return [actuator.name for actuator in actuators(context.model)]
    return list(element_names(context.model, "body"))


def units_at(context: EffectContext, target: str | None, variant: str = "") -> tuple[Units, str]:
    """List the variables of laws at a place.

    Parameters
    ----------
    context, target, variant
        As of `law_instance`.

    Returns
    -------
    variables : mapping of (str, str) to str
        The unit of each variable, by its name and joint.
    unit : str
        The unit of the law's value.
    """
    place = _place(context, target, variant)
    return place.units, place.unit


def law_of_text(context: EffectContext, text: str) -> EffectInstance:
    """Make the effect of a place and a formula as on the command line.

    Parameters
    ----------
    context : EffectContext
        The robot.
    text : str
        "PLACE:FORMULA", the place followed by ".variant" where there is one.

    Returns
    -------
    EffectInstance

    Raises
    ------
    BadArgument
        If there is no formula.
    UnknownName
        As of `law_instance`.
    """
    place, _, formula = text.partition(":")
    if not formula:
        raise BadArgument(f"A law is named as law:PLACE:FORMULA. Got law:{text}.")
    target, dot, variant = place.rpartition(".")
    if not dot or variant not in (COMMAND, *AXES):
        target = place
    variant = ""
    return law_instance(context, target, formula, variant)


class _LawPlace:
    """Where a law acts: its variables, the unit of its value, and the hook."""

    def __init__(
        self, units: Units, unit: str, hook: str, act: Callable[..., Array], *arguments: object
    ):
        self.units = units
        self.unit = unit
        self.hook = hook
        self.act = act
        self.arguments = arguments


def _place(context: EffectContext, target: str | None, variant: str) -> _LawPlace:
    """The place of that name."""
    model = context.model
    every = {joint.name: joint for joint in joints(model)}
    if variant == "":
        joint = every[known("joint for law", str(target), every)]
        ids = tuple({one.id: own for one, own in motors(model)}.get(joint.id, ()))
        units = _joint_units(joint, ids, every)
        return _LawPlace(units, joint.force, "force", _joint_force, joint, ids, _others(every))
    if variant == COMMAND:
        drives = {actuator.name: actuator for actuator in actuators(model)}
        drive = drives[known("actuator for law", str(target), drives)]
        units = {("u", ""): "command", ("t", ""): "s"}
        own = drive.joint
        if own is not None and own.name in every:
            units |= {("q", ""): own.length, ("v", ""): f"{own.length}/s"}
        else:
            own = None
        return _LawPlace(units, "command", "command_feedback", _command, drive.id, own)
    if variant in AXES:
        bodies = element_names(model, "body")
        body = bodies[known("body for law", str(target), bodies)]
        units = {("t", ""): "s"}
        units |= {(axis, ""): "m" for axis in AXES} | {(f"v{axis}", ""): "m/s" for axis in AXES}
        units["speed", ""] = "m/s"
        return _LawPlace(units, "N", "force", _body_force, body, AXES.index(variant))
    known("variant of law", variant, (COMMAND, *AXES))
    raise AssertionError("unknown variants are refused")


def _others(every: Mapping[str, Joint]) -> tuple[tuple[str, int, int], ...]:
    """Each joint's name and the places of its position and velocity."""
    return tuple((name, joint.qpos, joint.qvel) for name, joint in every.items())


def _joint_units(joint: Joint, ids: Sequence[int], every: Mapping[str, Joint]) -> Units:
    """The variables of a law of a joint."""
    units = {("q", ""): joint.length, ("v", ""): f"{joint.length}/s", ("t", ""): "s"}
    units |= {("load", ""): joint.force, ("contact", ""): joint.force}
    if ids:
        units["motor", ""] = joint.force
    if len(ids) == 1:
        units["u", ""] = "command"
    for name, other in every.items():
        units["q", name] = other.length
        units["v", name] = f"{other.length}/s"
    return units


def joint_variables(
    state: StepState,
    joint: Joint,
    ids: Sequence[int],
    others: Sequence[tuple[str, int, int]],
    wanted: Collection[tuple[str, str]],
) -> dict[tuple[str, str], Array]:
    """Compute the variables of laws of a joint in n states.

    Parameters
    ----------
    state : StepState
        The states.
    joint : Joint
        A slide or hinge.
    ids : sequence of int
        Its motors.
    others : sequence of (str, int, int)
        All joints by name, with the places of their positions and velocities.
    wanted : collection of (str, str)
        Which variables, each with the name of the joint; "" for the own one.

    Returns
    -------
    dict of (str, str) to (n,) array
    """
    found = {}
    places = {name: (qpos, qvel) for name, qpos, qvel in others}
    for name, owner in wanted:
        qpos, qvel = places[owner] if owner else (joint.qpos, joint.qvel)
        if name == "q":
            found[name, owner] = state.qpos[:, qpos]
        elif name == "v":
            found[name, owner] = state.qvel[:, qvel]
        elif name == "t":
            found[name, owner] = state.time
        elif name == "u":
            found[name, owner] = state.ctrl[:, ids[0]]
        elif name == "motor":
            found[name, owner] = motor_force(state, joint, ids)
        else:
            loads = joint_loads(state.model, state, name == "contact")
            found[name, owner] = loads[:, joint.qvel]
    return found


def _joint_force(
    joint: Joint,
    ids: Sequence[int],
    others: Sequence[tuple[str, int, int]],
    program: Program,
    state: StepState,
    magnitudes: Array,
) -> Array:
    """The force of a law at a joint."""
    variables = partial(
        joint_variables, joint=joint, ids=ids, others=others, wanted=program.variables
    )
    out = np.zeros_like(state.qvel)
    out[:, joint.qvel] = _value_of(program, state, variables, ("law", joint.name), magnitudes)
    return out


def _command(
    place: int, joint: Joint | None, program: Program, state: StepState, magnitudes: Array
) -> Array:
    """The commands with what a law adds to one of them."""
    variables = partial(_command_variables, place=place, joint=joint)
    out = state.ctrl.copy()
    out[:, place] += _value_of(program, state, variables, ("law", "command", place), magnitudes)
    return out


def _command_variables(
    state: StepState, place: int, joint: Joint | None
) -> dict[tuple[str, str], Array]:
    """The variables of a law of a command."""
    found = {("u", ""): state.ctrl[:, place], ("t", ""): state.time}
    if joint is not None:
        found["q", ""] = state.qpos[:, joint.qpos]
        found["v", ""] = state.qvel[:, joint.qvel]
    return found


def _body_force(
    body: int, axis: int, program: Program, state: StepState, magnitudes: Array
) -> Array:
    """The generalised forces of a law's force at a body's centre of mass."""
    points, jacobians = centre_motion(state, body)
    speeds = np.einsum("nij,nj->ni", jacobians, state.qvel)
    values = {("t", ""): state.time, ("speed", ""): np.linalg.norm(speeds, axis=1)}
    for i, name in enumerate(("x", "y", "z")):
        values[name, ""] = points[:, i]
        values[f"v{name}", ""] = speeds[:, i]
    force = evaluate(program, values, magnitudes, {})
    return jacobians[:, axis] * force[:, None]


def _value_of(
    program: Program, state: StepState, variables: Variables, key: object, magnitudes: Array
) -> Array:
    """The value of a law in n states, its hidden states remembered under a key."""
    memory = state.memory.setdefault(key, {})
    if program.hidden and not memory and state.past is not None:
        memory.update(_recalled(program, state, state.past, variables, key, magnitudes))
    return evaluate(program, variables(state), magnitudes, memory)


def _recalled(
    program: Program,
    state: StepState,
    past: RecordedPast,
    variables: Variables,
    key: object,
    magnitudes: Array,
) -> dict[int, Any]:
    """The hidden states at the starts, from what was recorded before them."""
    known_at = (key, program, np.asarray(magnitudes).tobytes())
    if known_at not in past.cache:
        while len(past.cache) >= KEPT:
            past.cache.pop(next(iter(past.cache)), None)
        past.cache[known_at] = hidden_states(program, state, past, variables, magnitudes)
    whole = past.cache[known_at]
    return {i: tuple(part[past.start] for part in parts) for i, parts in whole.items()}


def hidden_states(
    program: Program, state: StepState, past: RecordedPast, variables: Variables, magnitudes: Array
) -> dict[int, tuple[Array, ...]]:
    """Compute the hidden states of a formula in every row of the data.

    Parameters
    ----------
    program : Program
        The formula.
    state : StepState
        Its model is taken.
    past : RecordedPast
        The data.
    variables : callable
        Gives the variables of the formula in n states.
    magnitudes : (q,) array
        Its constants.

    Returns
    -------
    dict of int to tuple of (T,) array
        Of each hidden state what `evaluate` remembers.
    """
    model = state.model
    sizes = np.cumsum([1, model.nq, model.nv])
    time, qpos, qvel, act = np.split(past.states, sizes, axis=1)
    rows = StepState(qpos, qvel, past.commands, 0, act, model, time[:, 0])
    values = variables(rows)
    # Until the next row's command, this row's is held.
    held = variables(_held_ends(rows, physics_step(model)))
    along = {name: np.stack([values[name], held[name]], axis=1).ravel() for name in values}
    begins = np.repeat(time[:, 0] == 0, 2)
    begins[1::2] = False
    found: dict[int, tuple[Array, ...]] = {}

    def remembered(node: Node, inside: list[Any], along: dict[tuple[str, str], Array]) -> Array:
        """A hidden state along all rows, noted at each."""
        whole = followed(node, inside, along, begins)
        found[node[3]] = tuple(part[::2] for part in whole)
        return whole[0]

    evaluate_with(program, along, magnitudes, remembered)
    return found


def _held_ends(rows: StepState, step: float) -> StepState:
    """The states one physics step before the next rows, under the commands of these.

    At a trajectory's last row, that row.
    """
    passed = np.append(np.diff(rows.time), 0.0)
    ends = passed <= 0
    part = np.where(ends, 0.0, 1 - step / np.where(ends, 1.0, passed))
    part = np.clip(part, 0.0, 1.0)

    def moved(values: Array) -> Array:
        """Values between these rows and the next ones."""
        after = np.append(values[1:], values[-1:], axis=0)
        share = part.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values + share * (after - values))

    return StepState(
        moved(rows.qpos),
        moved(rows.qvel),
        rows.ctrl,
        0,
        moved(rows.act),
        rows.model,
        moved(rows.time),
    )
