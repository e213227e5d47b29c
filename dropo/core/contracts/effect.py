"""The contract of effects: what a simulation may lack, each a change in one layer around the
physics, of size 0 where it is absent.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Segments
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known

Model = Any  # a mujoco.MjModel


@dataclass(frozen=True)
class Quantity:
    """One number of an effect; 0 where the effect is absent.

    low, high: its bounds, around or at 0. probes: the sizes at which a screening tries it, of both
    signs where it has both.
    smooth: whether predictions are a smooth function of it, so that slopes can be followed. base:
    the model's own number that it adds to, where there is one; relative: it adds that share of
    `base` instead.
    """

    name: str
    unit: str
    low: float
    high: float
    probes: tuple[float, ...]
    smooth: bool = True
    base: float | None = None
    relative: bool = False


@dataclass(frozen=True, eq=False)
class StepState:
    """Many simulations at one physics step, for effects that depend on the state: qpos (n, nq),
    qvel (n, nv), ctrl (n, nu).

    step: physics steps since the segments' start; act (n, na): states of actuators that have one;
    model: as it is simulated, with all parameters and effects written into it.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    step: int
    act: Array
    model: Model


@dataclass(frozen=True, eq=False)
class EffectInstance:
    """One effect at one place: what is added to a simulation, with the numbers to be found.

    A hook takes the sizes (q,) of the quantities last; it is not called where all of them are 0. It
    leaves what it is given as it is, the model but one. Hooks made of functions of a module
    (functools.partial) can be sent to another process. In the order in which they act:
    declared(values (d,), sizes): the declared parameters' values;
    start(rows (n, p), slopes (n, p) [1/s], sizes) -> offsets (n, p): from measured start signals to
    true ones;
    command(commands (T, nu), sizes): a trajectory's commands, one a control step, before they are
    clamped;
    actuation(commands (T, nu), step [s], sizes): the same, one a physics step, after they were
    clamped;
    drive(moment, sizes) -> (n, nu): commands that depend on the state, each physics step;
    force(moment, sizes) -> (n, nv): generalised forces that depend on the state, each physics step;
    push(steps, sizes) -> (steps, nv): generalised forces that are known beforehand, a row for each
    physics step of a segment;
    wrench(sizes) -> (body, (6,)): a constant force and torque at a body's centre of mass, in the
    world's axes;
    model(model, sizes): changes the fields of a copy of the model; mj_setConst follows;
    sense(signals (n, L, p), sizes): measured signals from true ones; `late` [s] (sizes) -> (p,):
    how much later they are seen. gate(segments, sizes) -> (N,): the share of the sizes that holds
    in each of N segments; left out, it is 1. In a segment it is constant.
    general: whether `model` needs bodies compiled with simple="false", without which MuJoCo ties a
    body's frame to its centre of mass.
    variant: which of an effect's several forms; alike: labels of atoms that no recorded data can
    tell from this one;
    order: of a harmonic; several at one place are one periodic effect where all are multiples of
    the lowest, else a shape of its own;
    trials: sizes (q,) that a screening tries, in sets that are tried together: by default each
    probe alone, of several quantities the largest probes together.
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
    trials: tuple[tuple[tuple[float, ...], ...], ...] = ()

    def __post_init__(self) -> None:
        if not self.trials:
            object.__setattr__(self, "trials", _trials(self.quantities))

    @property
    def label(self) -> str:
        """ "joint_damping:leg_joint", "body_com:torso.x", "actuator_delay"."""
        place = "" if self.target is None else f":{self.target}"
        return f"{self.effect}{place}{'.' + self.variant if self.variant else ''}"

    @property
    def parameters(self) -> list[Parameter]:
        """The quantities as parameters of a simulator, called "<label>/<quantity>"."""
        return [
            Parameter(f"{self.label}/{q.name}", q.low, q.high, q.unit, lower=q.low, upper=q.high)
            for q in self.quantities
        ]


def _trials(quantities: tuple[Quantity, ...]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    if len(quantities) == 1:
        return tuple(((probe,),) for probe in quantities[0].probes)
    unit = np.eye(len(quantities))
    return (
        tuple(
            tuple((q.probes[-1] * row).tolist()) for q, row in zip(quantities, unit, strict=True)
        ),
    )


@dataclass(frozen=True)
class EffectContext:
    """What effects are offered for: the model, the compared signals by name and unit, and how long
    a command is held [s].

    parameters: those that the simulator declares; source: whether the model can be compiled anew
    (see `Atom.general`).
    """

    model: Model
    signals: tuple[tuple[str, str], ...]
    control_step: float
    parameters: tuple[Parameter, ...] = ()
    source: bool = True


ActiveEffects = Sequence[tuple[EffectInstance, Array]]
"""The effects that are there, with their sizes."""

Effect = Callable[[EffectContext], Iterable[EffectInstance]]
"""A plug-in of kind "effects": the atoms of one effect at every place of a robot where it can be.
"""


def magnitudes_of(
    instances: Sequence[EffectInstance], values: Array
) -> list[tuple[EffectInstance, Array]]:
    """The atoms that are present, with their sizes, from all sizes in a row (sum of q,)."""
    owner = np.repeat(
        np.arange(len(instances)), [len(instance.quantities) for instance in instances]
    )
    return [(instances[i], values[owner == i]) for i in np.unique(owner[values != 0]).tolist()]


def instances_of(context: EffectContext, effect: str, place: str = "") -> list[EffectInstance]:
    """An effect's atoms on a robot, at every place or at one.

    Raises UnknownName for an effect or a place that does not exist, with the nearest valid one.
    """
    found = list(find("effects", effect)(context))
    if not place:
        return found
    places = [instance.label.partition(":")[2] for instance in found]
    known(f"place for {effect}", place, sorted({p for p in places if p}))
    return [instance for instance, own in zip(found, places, strict=True) if own == place]
