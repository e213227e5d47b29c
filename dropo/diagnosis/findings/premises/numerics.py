"""What of the differences is the simulation's own arithmetic: its step, and how friction holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Cause, effect_in_words
from dropo.diagnosis.search.arithmetic import shift_in_time
from dropo.diagnosis.search.confirmation import gain_of, is_confirmed
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import Library, LinearizedWindows, shift_linearization
from dropo.diagnosis.search.refit import settle
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.windows import spread_of
from dropo.mjmodel.dynamics.dry_friction import (
    FrictionKind,
    friction_kind,
    impedance,
    time_constant,
)
from dropo.mjmodel.options import integrator, physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class NumericsSettings:
    """When the arithmetic is spoken of.

    Attributes
    ----------
    share : float
        Change of the predictions under physics steps of half the length, as a fraction of what the
        causes change, from which it is said.
    windows : int
        Windows, spread over the data, that are simulated with half the step.
    false_alarm : float
        Another step or integrator must explain data held out better by log(1 / false_alarm) nats.
    """

    share: float = 0.5
    windows: int = 24
    false_alarm: float = 0.01


SETTINGS = NumericsSettings()
OTHER_INTEGRATOR = {"Euler": "implicitfast", "implicit": "Euler", "implicitfast": "Euler"}
"""By a model's integrator, one that damps otherwise; Runge-Kutta has none."""

DOES = {
    FrictionKind.HOLDING: "holds what rests here and turns with the velocity",
    FrictionKind.TURNING: "turns here over little velocity",
}
"""What dry friction does that is not MuJoCo's own."""


def numerics(
    given: Problem,
    found: Problem,
    library: Library,
    first: State,
    last: State,
    causes: Sequence[Cause],
    floor: Array,
    unexplained: bool,
    settings: NumericsSettings = SETTINGS,
) -> tuple[str, ...]:
    """Say where the model's arithmetic, not its physics, decides.

    Parameters
    ----------
    given : Problem
        With the model as it came.
    found : Problem
        With the model that was found.
    library : Library
        The simulator with every effect.
    first, last : State
        Where the search began, and where it ended.
    causes : sequence of Cause
        What was named.
    floor : (p,) array
        Lower bound of the noise.
    unexplained : bool
        Whether numbers that were fitted to these windows leave something unexplained: then finer
        steps and another integrator are tried, with numbers fitted anew.
    settings : NumericsSettings
        Numbers that decide.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    sentences = []
    came, own = robot_of(given).model, robot_of(found).model
    kind = friction_kind(own)
    if kind in DOES and kind is not friction_kind(came):
        sentences.append(
            f"Dry friction {DOES[kind]}, where MuJoCo's creeps and turns early: the"
            f" extended model has solimpfriction {impedance(own):.4f} and solreffriction"
            f" {time_constant(own):.4f}, which predicts data held out better."
        )
    step = physics_step(robot_of(found).model)
    sentences += _other_steps(came, own)
    sentences += [_below_step(cause, step) for cause in causes if _is_below_step(cause, step)]
    moved = _moved_by_step(library, first, last, settings) if causes else 0.0
    if moved > settings.share:
        sentences.append(
            f"Physics steps of half the length ({500 * step:.3g} ms) change predictions by"
            f" {moved:.2g} of what the causes change: their sizes are those of this step."
        )
    if unexplained:
        sentences += _better_arithmetic(library, last, floor, settings)
    return tuple(sentences)


def _other_steps(came: mujoco.MjModel, used: mujoco.MjModel) -> list[str]:
    """That all was evaluated with other steps than those of the model that came."""
    before, after = (physics_step(model) for model in (came, used))
    other = integrator(used)
    own = integrator(came)
    if after == before and other == own:
        return []
    times = round(before / after)
    by = "" if other == own else f" by {other}"
    typed = f'timestep="{after:.3g}"' + ("" if other == own else f' integrator="{other}"')
    return [
        f"The model's physics steps of {1e3 * before:.3g} ms by {own} act like delays, inertia and"
        f" damping here: steps of {1e3 * after:.3g} ms{by} explain the data better, and all"
        f" was evaluated with these. Type {typed} in the model's option"
        f"{f', and {times} times the frame_skip' if times > 1 else ''}."
    ]


def _better_arithmetic(
    library: Library, last: State, floor: Array, settings: NumericsSettings
) -> list[str]:
    """Whether shorter steps, or else another integrator, explain what the last model does not."""
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return []
    half = 500 * physics_step(simulator.model)
    tried = {f"physics steps of half the length ({half:.3g} ms)": simulator.with_finer_steps(2)}
    name = OTHER_INTEGRATOR.get(integrator(simulator.model))
    if name is not None:
        tried[f"the integrator {name}"] = simulator.with_integrator(name)
    needed = float(np.log(len(tried) / settings.false_alarm))
    for what, other in tried.items():
        after = _held_out_with(library, other, last, floor)
        simulator.steps += other.steps
        if is_confirmed(last.test, after, needed):
            gain, z = gain_of(last.test, after)
            return [
                f"With {what} data held out are explained better, by {gain:.0f} +- {gain / z:.0f}"
                " nats: part of what remains is the simulation's own arithmetic. Change the"
                " model's option and diagnose again."
            ]
    return []


def _held_out_with(
    library: Library, other: RobotSimulator, last: State, floor: Array
) -> LinearizedWindows:
    """The windows held out by another simulator, its numbers fitted to the others."""
    there = Library(other, library.instances, library.declared, library.differences)
    train = shift_linearization(there, last.train, last.theta, last.train.whiten.noise)
    train = settle(there, train, last.free, floor)
    return shift_linearization(there, last.test, train.theta, train.whiten.noise)


def _is_below_step(cause: Cause, step: float) -> bool:
    """Whether a cause is a delay of less than a physics step."""
    if not cause.effect.endswith("_delay"):
        return False
    return any(one.unit == "s" and 0 < abs(one.value) < step for one in cause.estimate.values())


def _below_step(cause: Cause, step: float) -> str:
    """That a delay may be the step's."""
    return (
        f"The {cause.place} is less than a physics step of {1e3 * step:.3g} ms: a machine whose"
        " own loop is faster than the model's looks like that. Shorten the timestep first."
    )


def short_delay(instance: EffectInstance, magnitudes: Array, step: float) -> float | None:
    """Return how late something is by an effect, if that is less than a physics step.

    Parameters
    ----------
    instance : EffectInstance
        Any effect.
    magnitudes : (q,) array
        Its numbers.
    step : float
        The physics step [s].

    Returns
    -------
    float or None
        [s]; None where it is later, and of effects that shift nothing in time.
    """
    late = shift_in_time(instance, magnitudes)
    return late if late is not None and 0 < late < step else None


def refused_delay(
    instance: EffectInstance,
    size: float,
    step: float,
    without: LinearizedWindows,
    last: LinearizedWindows,
) -> str:
    """Say why a delay is no cause.

    Parameters
    ----------
    instance : EffectInstance
        The delay.
    size : float
        How late it is [s].
    step : float
        The physics step [s].
    without, last : LinearizedWindows
        The windows held out, without it and with it.

    Returns
    -------
    str
    """
    gain, z = gain_of(without, last)
    error = f" +- {gain / z:.0f}" if z else ""
    place = effect_in_words(instance.effect, instance.target, instance.variant)
    return (
        f"The {place} of {1e3 * size:.2g} ms would gain {gain:.0f}{error} nats and is not named:"
        f" it is less than a physics step of {1e3 * step:.3g} ms, and with it something remains,"
        " which may look like such a delay."
    )


def _moved_by_step(
    library: Library, first: State, last: State, settings: NumericsSettings
) -> float:
    """How far half the step moves predictions, as a fraction of what the causes move them."""
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return 0.0
    windows = last.train.windows
    index = np.unique(np.linspace(0, len(windows) - 1, settings.windows).round().astype(np.int64))
    some = windows.take(index)
    usual = simulator.predict(np.stack([first.theta, last.theta]), some.segments)
    finer = simulator.with_finer_steps(2)
    half = finer.predict(last.theta[None], some.segments)
    simulator.steps += finer.steps
    return _share_of_step(half[0], usual[0], usual[1], spread_of(simulator, some))


def _share_of_step(finer: Array, came: Array, found: Array, spread: Array) -> float:
    """How far finer steps move predictions (W, L p), as a fraction of what the causes do.

    Where the model that came diverges, causes change more than any step does: that is left out.
    """
    of_step = ((finer - found).reshape(-1, len(spread)) / spread) ** 2
    of_causes = ((came - found).reshape(-1, len(spread)) / spread) ** 2
    known = np.isfinite(of_step) & np.isfinite(of_causes)
    change = float(of_causes[known].sum())
    return float(np.sqrt(of_step[known].sum() / change)) if change else 0.0
