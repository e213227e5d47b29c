"""The contract of effects: what a simulation may lack.

Each is a change in one layer around the physics. An effect whose magnitudes are all 0 is absent:
the simulation is then the model's own, bit for bit.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require

Model = Any  # a mujoco.MjModel


@dataclass(frozen=True)
class Quantity:
    """One number of an effect; its magnitude is 0 where the effect is absent.

    Attributes
    ----------
    name : str
        What it is called in results, such as "damping".
    unit : str
        Its unit; "1" of a pure number.
    low, high : float
        Bounds of its magnitude, with 0 between them or at one of them.
    probes : tuple of float
        The magnitudes at which a screening tries it, of both signs where it can have both.
    smooth : bool
        Whether predictions are a smooth function of it, so that they can be differentiated by it.
    base : float or None
        The model's own number to which the magnitude is added, where there is one.
    relative : bool
        Whether the magnitude is a fraction of `base`.

    Raises
    ------
    BadArgument
        If the probes are no tuple.
    """

    name: str
    unit: str
    low: float
    high: float
    probes: tuple[float, ...]
    smooth: bool = True
    base: float | None = None
    relative: bool = False

    def __post_init__(self) -> None:
        rule = "a tuple of numbers, such as (0.1,)"
        is_tuple = isinstance(self.probes, tuple)
        require(is_tuple, "probes", rule, self.probes, f"Quantity {self.name}")


@dataclass(frozen=True, eq=False)
class RecordedPast:
    """What was recorded before n simulations begin, for effects that remember.

    Attributes
    ----------
    states : (T, 1 + nq + nv + na) array
        The time in its trajectory [s] and the measured state of each row of the data.
    commands : (T, nu) array
        The commands of each row.
    start : (n,) array of int
        The row at which each simulation begins.
    cache : dict
        What was computed from it.
    """

    states: Array
    commands: Array
    start: Ints
    cache: dict[Any, Any]


@dataclass(frozen=True, eq=False)
class StepState:
    """n simulations at one physics step, for effects that depend on the state.

    Attributes
    ----------
    qpos : (n, nq) array
        Positions.
    qvel : (n, nv) array
        Velocities.
    ctrl : (n, nu) array
        Commands.
    step : int
        Physics steps since the start of the segments.
    act : (n, na) array
        States of the actuators that have one.
    model : MjModel
        The model as it is simulated, with all parameters and effects written into it.
    time : (n,) array
        The time since the beginning of each trajectory [s].
    memory : dict
        What effects note from one physics step to the next, each under a key of its own; empty
        where simulations begin.
    past : RecordedPast or None
        What was recorded before the simulations began; None where nothing was.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    step: int
    act: Array
    model: Model
    time: Array
    memory: dict[Any, Any] = field(default_factory=dict)
    past: RecordedPast | None = None


@dataclass(frozen=True, eq=False)
class EffectInstance:
    """One effect at one place of a robot, with magnitudes to be found.

    It acts through hooks: functions that take the magnitudes (q,) of its q quantities as their last
    argument. A simulator calls them in the order of this table, each only where some magnitude is
    not 0.

    ==================== ============================================= ===================
    hook                 arguments before the magnitudes               result
    ==================== ============================================= ===================
    ``time_profile``     segments                                      (N,) factors
    ``declared``         values (d,)                                   (d,) values
    ``model``            model                                         None
    ``start``            signals (n, p), their speeds (n, p) [1/s]     (n, p) offsets
    ``command``          commands (T, nu), one a control step          (T, nu) commands
    (the clamp)          commands are clamped to their control ranges
    ``actuation``        commands (T, nu), one a physics step; step    (T, nu) commands
                         [s]
    ``command_feedback`` StepState of n simulations                    (n, nu) commands
    ``force``            StepState of n simulations                    (n, nv) forces
    ``friction``         StepState of n simulations                    (n, nv) forces
    ``applied_force``    number of physics steps                       (steps, nv) forces
    ``wrench``           none                                          body, (6,) wrench
    ``sensor_delay``     none                                          (p,) delays [s]
    ``measurement``      true signals (n, L, p)                        (n, L, p) signals
    ==================== ============================================= ===================

    Attributes
    ----------
    effect : str
        The name by which the effect is registered, such as "joint_damping".
    target : str or None
        The body, joint, actuator, geom or signal; None where the effect is global.
    quantities : tuple of Quantity
        The q numbers whose magnitudes are to be found.
    variant : str
        Which of the effect's several forms at that place; "" where there is one.
    model : callable or None
        Changes the fields of a copy of the model in place; mj_setConst follows. What makes up
        meshes and pictures (vertices, faces, pixels) cannot be changed, and is not there where it
        is only seen.
    command : callable or None
        Changes the commands of a trajectory, one a control step, before they are clamped.
    actuation : callable or None
        Changes the commands of a trajectory, one a physics step, after they were clamped.
    command_feedback : callable or None
        Changes the commands of each physics step in dependence on the state.
    force : callable or None
        Generalised forces [N, N m] that depend on the state, in each physics step.
    friction : callable or None
        Dry friction [N, N m] that is added to the joints' own, in dependence on the state, in each
        physics step. It holds what is at rest.
    applied_force : callable or None
        Generalised forces [N, N m] known beforehand, a row for each physics step of a segment. They
        belong to recorded motion and cannot act in new episodes.
    wrench : callable or None
        A body's id, and a constant force and torque at its centre of mass in the world's axes
        [N, N m].
    start : callable or None
        Offsets from measured start signals to true ones.
    measurement : callable or None
        Measured signals from true ones.
    sensor_delay : callable or None
        The time by which each signal is measured late.
    declared : callable or None
        Changes the values of the declared parameters.
    time_profile : callable or None
        The factor of the magnitudes in each segment, constant within it; 1 where it is left out.
    general : bool
        Whether `model` needs bodies compiled with simple="false": else MuJoCo ties the frame of a
        body to its centre of mass.
    alike : tuple of str
        Labels of effects that no recorded data can distinguish from this one.
    order : int
        The order of a harmonic, else 0. Several harmonics at one place are one periodic effect
        where all orders are multiples of the lowest, else each has a shape of its own.
    formula : str
        The text of a law (`dropo.effects.law`), else "".
    remembers : bool
        Whether its hooks need what was recorded before a segment (`StepState.past`).
    trials : tuple
        The magnitudes (q,) that a screening tries, in sets that are tried together. By default each
        probe is a set; of several quantities, the last probes of each make one set.
    linear_in : callable or None
        Numbers (..., k) that magnitudes (..., q) stand for, and in which small responses are linear
        where they are not in the magnitudes themselves: in proportion to the first, and smooth
        where that is not 0. There is one set of at least k trials then, which span them; the first
        q span enough of them for a first choice.
    scaled : bool
        Whether the first magnitude is the effect's size and the others its shape, so that it is
        nothing where the first is 0; so it is if there is `linear_in`.

    Raises
    ------
    BadArgument
        If the quantities are no tuple.

    Notes
    -----
    A hook leaves its arguments as they are; `model` alone changes its own. Hooks made of module
    functions (with `functools.partial`) can be sent to another process.
    """

    effect: str
    target: str | None
    quantities: tuple[Quantity, ...]
    variant: str = ""
    model: Callable[[Model, Array], None] | None = None
    command: Callable[[Array, Array], Array] | None = None
    actuation: Callable[[Array, float, Array], Array] | None = None
    command_feedback: Callable[[StepState, Array], Array] | None = None
    force: Callable[[StepState, Array], Array] | None = None
    friction: Callable[[StepState, Array], Array] | None = None
    applied_force: Callable[[int, Array], Array] | None = None
    wrench: Callable[[Array], tuple[int, Array]] | None = None
    start: Callable[[Array, Array, Array], Array] | None = None
    measurement: Callable[[Array, Array], Array] | None = None
    sensor_delay: Callable[[Array], Array] | None = None
    declared: Callable[[Array, Array], Array] | None = None
    time_profile: Callable[[Segments, Array], Array] | None = None
    general: bool = False
    alike: tuple[str, ...] = ()
    order: int = 0
    formula: str = ""
    remembers: bool = False
    trials: tuple[tuple[tuple[float, ...], ...], ...] = ()
    linear_in: Callable[[Array], Array] | None = None
    scaled: bool = False

    def __post_init__(self) -> None:
        rule = "a tuple of Quantity, such as (size,)"
        is_tuple = isinstance(self.quantities, tuple)
        caller = f"EffectInstance {self.label}"
        require(is_tuple, "quantities", rule, self.quantities, caller)
        if not self.trials:
            object.__setattr__(self, "trials", _trials(self.quantities))
        object.__setattr__(self, "scaled", self.scaled or self.linear_in is not None)

    @property
    def label(self) -> str:
        """The name of the instance: "joint_damping:leg_joint", "body_com:torso.x"."""
        place = "" if self.target is None else f":{self.target}"
        variant = f".{self.variant}" if self.variant else ""
        return f"{self.effect}{place}{variant}"

    @property
    def parameters(self) -> list[Parameter]:
        """The q quantities as parameters of a simulator, called "<label>/<quantity>"."""
        return [
            Parameter(f"{self.label}/{q.name}", q.low, q.high, q.unit, lower=q.low, upper=q.high)
            for q in self.quantities
        ]


def _trials(quantities: tuple[Quantity, ...]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """Each probe of one quantity as a set, or the last probes of several as one set."""
    if not all(quantity.probes for quantity in quantities):
        return ()
    if len(quantities) == 1:
        return tuple(((probe,),) for probe in quantities[0].probes)
    largest = np.diag([quantity.probes[-1] for quantity in quantities])
    return (tuple(tuple(row) for row in largest.tolist()),)


@dataclass(frozen=True)
class EffectContext:
    """The robot for which effects are offered.

    Attributes
    ----------
    model : MjModel
        The compiled model, without parameters and effects written into it.
    signals : tuple of (str, str)
        Name and unit of each of the p compared signals.
    control_step : float
        The time for which a command is held [s].
    parameters : tuple of Parameter
        The parameters that the simulator declares.
    source : bool
        Whether the model can be compiled anew (see `EffectInstance.general`).
    """

    model: Model
    signals: tuple[tuple[str, str], ...]
    control_step: float
    parameters: tuple[Parameter, ...] = ()
    source: bool = True


ActiveEffects = Sequence[tuple[EffectInstance, Array]]
"""The effects that a simulation has, each with its magnitudes (q,)."""

Effect = Callable[[EffectContext], Iterable[EffectInstance]]
"""A plug-in of kind "effects": the instances of one effect at every place where it can be."""


def offered(effect: Effect, context: EffectContext) -> list[EffectInstance]:
    """List what an effect offers for a robot.

    Parameters
    ----------
    effect : callable
        The plug-in.
    context : EffectContext
        The robot.

    Returns
    -------
    list of EffectInstance
        One for each of its places; empty where the robot has none.

    Raises
    ------
    BadArgument
        If it gives anything else.
    """
    found = effect(context)
    name = getattr(effect, "__name__", type(effect).__name__)
    if not isinstance(found, Iterable):
        raise BadArgument(
            f"The effect {name} must be a function that yields instances. Got"
            f" {type(found).__name__}: write `yield EffectInstance(...)`, or give a list of them."
        )
    instances = list(found)
    for one in instances:
        if not isinstance(one, EffectInstance):
            raise BadArgument(
                f"The instances of the effect {name} must be EffectInstance each. Got {one!r}."
            )
    return instances


def magnitudes_of(
    instances: Sequence[EffectInstance], values: Array
) -> list[tuple[EffectInstance, Array]]:
    """Select the effects that are present, with their magnitudes.

    Parameters
    ----------
    instances : sequence of EffectInstance
        Effects with q_1, q_2, ... quantities.
    values : (q_1 + q_2 + ...,) array
        The magnitudes of all of them in a row.

    Returns
    -------
    list of (EffectInstance, (q,) array)
        The effects with a magnitude other than 0, in the given order.
    """
    counts = [len(instance.quantities) for instance in instances]
    owner = np.repeat(np.arange(len(instances)), counts)
    present = np.unique(owner[values != 0]).tolist()
    return [(instances[i], values[owner == i]) for i in present]


def instances_of(context: EffectContext, effect: str, place: str = "") -> list[EffectInstance]:
    """List the instances of one effect on a robot, at every place or at one.

    Parameters
    ----------
    context : EffectContext
        The robot.
    effect : str
        The name of an effect.
    place : str
        The label of an instance without the effect's name, such as "torso.x"; "" for all places.

    Returns
    -------
    list of EffectInstance

    Raises
    ------
    UnknownName
        If there is no such effect, or none at that place; with the nearest valid name.
    BadArgument
        If the effect gives anything but instances of its name.
    """
    found = offered(find("effects", effect), context)
    check_names(found, effect)
    if not place:
        return found
    places = [instance.label.partition(":")[2] for instance in found]
    known(f"place for {effect}", place, sorted({p for p in places if p}))
    return [instance for instance, own in zip(found, places, strict=True) if own == place]


def check_names(instances: Iterable[EffectInstance], effect: str) -> None:
    """Refuse instances that have another name than their effect.

    Files and results name an instance by its own name, and find its effect by it.

    Parameters
    ----------
    instances : iterable of EffectInstance
        What the effect offers.
    effect : str
        The name by which it is registered.

    Raises
    ------
    BadArgument
        If one has another name.
    """
    for instance in instances:
        if instance.effect != effect:
            raise BadArgument(
                f"The effect registered as {effect!r} gives instances called {instance.effect!r}."
                f" Give both one name: EffectInstance({effect!r}, ...)."
            )
