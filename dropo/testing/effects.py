"""What every effect must keep to."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import Effect, EffectInstance, Quantity, StepState
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array

HOOKS = (
    "declared",
    "start",
    "command",
    "actuation",
    "command_feedback",
    "force",
    "wrench",
    "model",
    "measurement",
    "sensor_delay",
    "time_profile",
)
# of a trial: where nothing may be seen any more, and where an answer is a straight line
TINY = 1e-6
SMALL = 1e-2
# shares of an answer that count as nothing, and as still straight
UNSEEN = 1e-2
CURVED = 0.2


def check_effect(effect: Effect, simulator: Any, segments: Segments) -> None:
    """Raises AssertionError, saying what is wrong, unless the effect keeps to the contract on a
    simulator's robot.

    simulator: one with `robot` and `with_effects`, such as MujocoSimulator; segments: on which no
    simulation fails. Checked are labels, bounds and trials; that size 0 is the base model bit for
    bit, and tiny sizes next to it; that answers to small sizes are in proportion to them where the
    quantities are said to be smooth; that no simulation fails at a trial; and that hooks give what
    they must, and leave what they are given as it is.
    """
    instances = list(effect(simulator.effect_context))
    labels = [instance.label for instance in instances]
    assert len(set(labels)) == len(labels), (
        f"labels appear twice: {sorted({x for x in labels if labels.count(x) > 1})}"
    )
    assert len({instance.effect for instance in instances}) <= 1, (
        f"atoms of one plug-in have several names: {sorted({a.effect for a in instances})}"
    )
    for instance in instances:
        assert any(
            getattr(instance, hook) is not None for hook in HOOKS if hook != "time_profile"
        ), f"{instance.label} does nothing: it has no hook"
        assert instance.quantities, f"{instance.label} has no quantity to be found"
        for quantity in instance.quantities:
            _check_quantity(instance.label, quantity)
        _check_trials(instance)
    if instances:
        _check_answers(instances, simulator, segments)


def _check_quantity(label: str, q: Quantity) -> None:
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
    low, high = np.array([(q.low, q.high) for q in instance.quantities]).T
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


def _check_answers(instances: list[EffectInstance], simulator: Any, segments: Segments) -> None:
    extended = simulator.with_effects([_watched(instance) for instance in instances])
    own = 0.5 * (simulator.space.low + simulator.space.high)
    d = len(simulator.space)
    base = simulator.predict(own[None], segments)[0]
    rows = [
        (instance, place, np.array(trial))
        for instance, place in _places(instances)
        for trials in instance.trials
        for trial in trials
    ]

    def answers(share: float) -> Array:
        values = np.zeros((len(rows), len(extended.space)))
        values[:, :d] = own
        for value, (_, place, trial) in zip(values, rows, strict=True):
            value[d + place : d + place + len(trial)] = share * trial
        return np.asarray(extended.predict(values, segments) - base)

    nothing = answers(0.0)
    full, small, half, tiny = (answers(share) for share in (1.0, SMALL, SMALL / 2, TINY))
    floor = 1e-9 * (1 + np.abs(base).sum())  # rounding
    for i, (instance, _, trial) in enumerate(rows):
        at = f"{instance.label} at {trial.tolist()}"
        assert np.isfinite(full[i]).all(), f"simulations fail under {at}"
        assert not nothing[i].any(), (
            f"{instance.label} changes predictions at size 0, by {np.abs(nothing[i]).max():.3g}"
        )
        seen = np.abs(tiny[i]).sum()
        whole = np.abs(full[i]).sum()
        assert seen <= UNSEEN * whole + floor, (
            f"{at} still changes predictions by {seen / whole:.2g} of that at {TINY:g} of the size"
        )
        if all(q.smooth for q in instance.quantities):
            bent = _bend(full[i], small[i], half[i], floor)
            assert bent <= CURVED, (
                f"{at}: small answers are not in proportion to the size, by {bent:.2g}, "
                "though it is said to be smooth"
            )


def _bend(full: Array, small: Array, half: Array, floor: float) -> float:
    """How far small answers (R, p) are from twice those to half the size: the share in the middle
    one of the rows that answer.

    Rows without a slope at 0, as where the answer is even, are left out.
    """
    bent = np.abs(small - 2 * half).sum(axis=1)
    straight = np.abs(small).sum(axis=1)
    sloped = straight > floor + 0.1 * SMALL * np.abs(full).sum(axis=1)
    return float(np.median(bent[sloped] / straight[sloped])) if sloped.any() else 0.0


def _places(instances: list[EffectInstance]) -> list[tuple[EffectInstance, int]]:
    """The atoms with the place of each one's first quantity."""
    ends = np.cumsum([len(instance.quantities) for instance in instances]).tolist()
    return [
        (instance, end - len(instance.quantities))
        for instance, end in zip(instances, ends, strict=True)
    ]


@dataclass(frozen=True)
class _Watch:
    """A hook that is held against what it was given."""

    label: str
    name: str
    hook: Callable[..., Any]

    def __call__(self, *given: Any) -> Any:
        arrays = _arrays(given)
        before = [array.copy() for array in arrays]
        out = self.hook(*given)
        same = all(
            np.array_equal(array, old, equal_nan=True)
            for array, old in zip(arrays, before, strict=True)
        )
        assert same, f"the hook {self.name!r} of {self.label} changes what it is given"
        wanted = self._shape(given)
        got = np.shape(out[1] if self.name == "wrench" else out)
        assert wanted is None or got == wanted, (
            f"the hook {self.name!r} of {self.label} gives shape {got}, not {wanted}"
        )
        return out

    def _shape(self, given: tuple[Any, ...]) -> tuple[int, ...] | None:
        if self.name in ("command_feedback", "force"):
            return np.shape(given[0].ctrl if self.name == "command_feedback" else given[0].qvel)
        if self.name in ("model", "sensor_delay"):
            return None
        return (
            (6,)
            if self.name == "wrench"
            else (len(given[0]),)
            if self.name == "time_profile"
            else np.shape(given[0])
        )


def _arrays(given: tuple[Any, ...]) -> list[Array]:
    """The arrays that a hook must not change."""
    moments = [
        array
        for item in given
        if isinstance(item, StepState)
        for array in (item.qpos, item.qvel, item.ctrl, item.act)
    ]
    return [*moments, *(item for item in given if isinstance(item, np.ndarray))]


def _watched(instance: EffectInstance) -> EffectInstance:
    hooks: dict[str, Any] = {
        name: _Watch(instance.label, name, hook)
        for name in HOOKS
        if (hook := getattr(instance, name)) is not None
    }
    return replace(instance, **hooks)
