"""Checks that every effect must pass."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import (
    Effect,
    EffectInstance,
    Quantity,
    StepState,
    check_names,
    offered,
)
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.registry import registered
from dropo.core.services.validation import Array

HOOKS = (
    "declared",
    "start",
    "command",
    "actuation",
    "command_feedback",
    "force",
    "friction",
    "applied_force",
    "wrench",
    "model",
    "measurement",
    "sensor_delay",
    "time_profile",
)
"""Names of the functions that an effect instance may have."""


@dataclass(frozen=True, kw_only=True)
class EffectCheckSettings:
    """Magnitudes at which an effect is simulated, and tolerances of its responses.

    Attributes
    ----------
    tiny : float
        Fraction of a trial at which the response must have vanished.
    small : float
        Fraction of a trial at which the response of smooth quantities must be linear.
    max_tiny_response : float
        Largest response at `tiny`, as a fraction of that to the whole trial.
    max_curvature : float
        Largest deviation from a linear response at `small`, as a fraction of the response.
    """

    tiny: float = 1e-6
    small: float = 1e-2
    max_tiny_response: float = 1e-2
    max_curvature: float = 0.2


DEFAULTS = EffectCheckSettings()


def check_effect(
    effect: Effect,
    simulator: Any,
    segments: Segments,
    settings: EffectCheckSettings = DEFAULTS,
) -> None:
    """Check that an effect keeps to the contract of effects on a simulator's robot.

    Checked are names, labels, bounds and trials; that magnitude 0 is the base model bit for bit,
    and tiny magnitudes are close to it; that responses to small magnitudes are proportional to them
    where the quantities are declared smooth; that no simulation fails at a trial; and that hooks
    return what they must and do not change their arguments.

    Parameters
    ----------
    effect : callable
        The plug-in: from an `EffectContext` to its effect instances.
    simulator : Simulator
        A simulator with `effect_context` and `with_effects`, such as MujocoSimulator.
    segments : Segments
        Segments on which no simulation of the base model fails.
    settings : EffectCheckSettings
        Magnitudes and tolerances.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which. Also if the robot has no place for the effect,
        so that nothing can be checked.
    """
    instances = _instances(effect, simulator)
    labels = [instance.label for instance in instances]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    assert not repeated, f"labels appear twice: {repeated}"
    effect_names = sorted({instance.effect for instance in instances})
    assert len(effect_names) <= 1, (
        f"effect instances of one plug-in have several names: {effect_names}"
    )
    for instance in instances:
        hooks = [name for name in HOOKS if getattr(instance, name) is not None]
        assert set(hooks) - {"time_profile"}, f"{instance.label} does nothing: it has no hook"
        assert instance.quantities, f"{instance.label} has no quantity to be found"
        for quantity in instance.quantities:
            _check_quantity(instance.label, quantity)
        _check_trials(instance)
    _check_responses(instances, simulator, segments, settings)


def _instances(effect: Effect, simulator: Any) -> list[EffectInstance]:
    """What an effect offers for the simulator's robot, under the name of the effect."""
    try:
        instances = offered(effect, simulator.effect_context)
        for (kind, name), plugin in registered().items():
            if kind == "effects" and plugin is effect:
                check_names(instances, name)
    except BadArgument as error:
        raise AssertionError(str(error)) from error
    name = getattr(effect, "__name__", type(effect).__name__)
    assert instances, (
        f"{name} offers no instance on this robot, so nothing was checked. Give a simulator whose"
        " robot has a place for it"
    )
    return instances


def _check_quantity(label: str, q: Quantity) -> None:
    """A quantity has finite bounds around 0, probes within them, and a unit."""
    name = f"{label}/{q.name}"
    assert np.isfinite([q.low, q.high]).all(), (
        f"{name} has bounds that are not finite: {q.low}, {q.high}"
    )
    assert q.low <= 0 <= q.high, f"{name} has bounds {q.low}, {q.high}, without 0 between them"
    assert q.low < q.high, f"{name} has an empty interval: {q.low}, {q.high}"
    assert q.probes, f"{name} has no probes"
    outside = [probe for probe in q.probes if not q.low <= probe <= q.high or probe == 0]
    assert not outside, (
        f"{name} has probes {outside} that are 0 or outside of its bounds {q.low}, {q.high}"
    )
    assert q.unit, f"{name} has no unit; a pure number's is '1'"


def _check_trials(instance: EffectInstance) -> None:
    """Trials are within the bounds, and not 0."""
    low = np.array([q.low for q in instance.quantities])
    high = np.array([q.high for q in instance.quantities])
    for trials in instance.trials:
        for trial in trials:
            assert len(trial) == len(low), (
                f"{instance.label} has a trial {trial} for {len(low)} quantities"
            )
            assert np.any(trial), f"{instance.label} has a trial of size 0"
            inside = np.all((low <= trial) & (trial <= high))
            assert inside, (
                f"{instance.label} has a trial {trial} outside of its bounds "
                f"{low.tolist()}, {high.tolist()}"
            )


def _check_responses(
    instances: list[EffectInstance],
    simulator: Any,
    segments: Segments,
    settings: EffectCheckSettings,
) -> None:
    """Responses vanish with the magnitude, are smooth where declared so, and never fail."""
    extended = simulator.with_effects([_watched(instance) for instance in instances])
    centre = 0.5 * (simulator.space.low + simulator.space.high)
    base = simulator.predict(centre[None], segments)[0]
    trials = _all_trials(instances, len(simulator.space))

    def responses(fraction: float) -> Array:
        """Changes of the predictions (T, R, p) under a fraction of each trial; (1, R, p) under
        none of it, which is the same for all.
        """
        values = np.zeros((len(trials), len(extended.space)))
        values[:, : len(centre)] = centre
        for row, (_, first, trial) in zip(values, trials, strict=True):
            row[first : first + len(trial)] = fraction * trial
        if fraction == 0:
            values = values[:1]
        return np.asarray(extended.predict(values, segments) - base)

    zero = responses(0.0)
    full = responses(1.0)
    smooth = [all(q.smooth for q in instance.quantities) for instance, _, _ in trials]
    if any(smooth):
        small = responses(settings.small)
        half = responses(settings.small / 2)
    tiny = responses(settings.tiny)
    rounding = 1e-9 * (1 + np.abs(base).sum())
    for i, (instance, _, trial) in enumerate(trials):
        where = f"{instance.label} at {trial.tolist()}"
        assert np.isfinite(full[i]).all(), f"simulations fail under {where}"
        assert not zero[0].any(), (
            f"{instance.label} changes predictions at size 0, by {np.abs(zero[0]).max():.3g}"
        )
        remaining = np.abs(tiny[i]).sum()
        whole = np.abs(full[i]).sum()
        assert remaining <= settings.max_tiny_response * whole + rounding, (
            f"{where} still changes predictions by {remaining / whole:.2g} of that at "
            f"{settings.tiny:g} of the size"
        )
        if smooth[i]:
            sloped_above = rounding + 0.1 * settings.small * np.abs(full[i]).sum(axis=1)
            curvature = _curvature(small[i], half[i], sloped_above)
            assert curvature <= settings.max_curvature, (
                f"{where}: small answers are not in proportion to the size, by {curvature:.2g}, "
                "though it is said to be smooth"
            )


def _curvature(small: Array, half: Array, sloped_above: Array) -> float:
    """Returns the median over rows of |small - 2 half| / |small|.

    small and half (R, p) are the responses to a small magnitude and to half of it. Rows whose
    response is not above `sloped_above` (R,) have no slope at 0, as where the response is even, and
    are left out.
    """
    deviation = np.abs(small - 2 * half).sum(axis=1)
    size = np.abs(small).sum(axis=1)
    sloped = size > sloped_above
    return float(np.median(deviation[sloped] / size[sloped])) if sloped.any() else 0.0


def _all_trials(
    instances: list[EffectInstance], first: int
) -> list[tuple[EffectInstance, int, Array]]:
    """Returns every trial with its instance and the place of its first quantity.

    `first` is the place of the first quantity of all in the extended simulator's space.
    """
    found = []
    for instance in instances:
        for trials in instance.trials:
            found += [(instance, first, np.array(trial)) for trial in trials]
        first += len(instance.quantities)
    return found


@dataclass(frozen=True)
class _Watch:
    """A hook whose arguments and result are checked at each call."""

    label: str
    name: str
    hook: Callable[..., Any]

    def __call__(self, *arguments: Any) -> Any:
        self._check_arguments(arguments)
        arrays = _arrays(arguments)
        originals = [array.copy() for array in arrays]
        result = self.hook(*arguments)
        unchanged = all(
            np.array_equal(array, original, equal_nan=True)
            for array, original in zip(arrays, originals, strict=True)
        )
        assert unchanged, f"the hook {self.name!r} of {self.label} changes what it is given"
        expected = self._shape(arguments)
        if self.name == "wrench":
            is_pair = isinstance(result, tuple) and len(result) == 2
            assert is_pair, (
                f"the hook 'wrench' of {self.label} must give a body's id and (6,) numbers, not "
                f"{result!r}"
            )
        got = np.shape(result[1] if self.name == "wrench" else result)
        assert expected is None or got == expected, (
            f"the hook {self.name!r} of {self.label} gives shape {got}, not {expected}"
        )
        return result

    def _check_arguments(self, arguments: tuple[Any, ...]) -> None:
        """The hook takes what it is given; what is not written in Python is not looked at."""
        try:
            signature = inspect.signature(self.hook)
        except (TypeError, ValueError):
            return
        try:
            signature.bind(*arguments)
        except TypeError as error:
            raise AssertionError(
                f"the hook {self.name!r} of {self.label} must take {len(arguments)} arguments, the "
                f"magnitudes last: {error}"
            ) from error

    def _shape(self, arguments: tuple[Any, ...]) -> tuple[int, ...] | None:
        """Returns the shape that the hook's result must have; None where any is allowed."""
        first = arguments[0]
        if self.name in ("model", "sensor_delay", "applied_force"):
            return None
        if self.name == "command_feedback":
            return np.shape(first.ctrl)
        if self.name in ("force", "friction"):
            return np.shape(first.qvel)
        if self.name == "wrench":
            return (6,)
        if self.name == "time_profile":
            return (len(first),)
        return np.shape(first)


def _arrays(arguments: tuple[Any, ...]) -> list[Array]:
    """Returns the arrays that a hook must not change."""
    arrays: list[Array] = []
    for argument in arguments:
        if isinstance(argument, StepState):
            arrays += [argument.qpos, argument.qvel, argument.ctrl, argument.act]
        elif isinstance(argument, np.ndarray):
            arrays.append(argument)
    return arrays


def _watched(instance: EffectInstance) -> EffectInstance:
    """Returns the instance with all its hooks watched."""
    hooks: dict[str, Any] = {}
    for name in HOOKS:
        hook = getattr(instance, name)
        if hook is not None:
            hooks[name] = _Watch(instance.label, name, hook)
    return replace(instance, **hooks)
