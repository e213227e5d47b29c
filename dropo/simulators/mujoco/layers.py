"""What effects do outside of the physics: to the commands on their way in, and to the measurements
on their way out.
"""

import mujoco
import numpy as np

from dropo.core.contracts.effect import ActiveEffects
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.observation import Layout
from dropo.simulators.mujoco.worker import clamps_itself


def by_time_profile(
    active: ActiveEffects, segments: Segments, part: Ints
) -> list[tuple[Ints, ActiveEffects]]:
    """A part of the segments in sets that have the same effects, with the sizes that hold there."""
    if all(instance.time_profile is None for instance, _ in active):
        return [(part, active)]
    if len(segments.levels) > 1:
        chained = next(
            instance.label for instance, _ in active if instance.time_profile is not None
        )
        raise Incompatible(
            f"{chained} changes from segment to segment, and with reset='partial' one goes "
            "on where another ended."
            " Use reset='transition' or 'start'."
        )
    shares = np.ones((len(part), len(active)))
    for i, (instance, magnitudes) in enumerate(active):
        if instance.time_profile is not None:
            shares[:, i] = instance.time_profile(segments, magnitudes)[part]
    rows, which = np.unique(shares, axis=0, return_inverse=True)
    sets = [
        [
            (instance, share * magnitudes)
            for (instance, magnitudes), share in zip(active, row, strict=True)
            if share != 0
        ]
        for row in rows
    ]
    return [(part[which.ravel() == i], those) for i, those in enumerate(sets)]


def declared_values(values: Array, active: ActiveEffects) -> Array:
    """The declared parameters' values (d,) as the effects leave them."""
    for instance, magnitudes in active:
        values = values if instance.declared is None else instance.declared(values, magnitudes)
    return values


def commands_of(
    segments: Segments,
    part: Ints,
    actions: Array,
    model: mujoco.MjModel,
    frame_skip: int,
    active: ActiveEffects,
) -> Array:
    """(N, L frame_skip, nu) commands, one a physics step, as the effects leave them, 0 in
    trajectories that the part is not of.

    actions (T, nu) of all transitions. Effects see a trajectory's commands from its beginning, so
    that delays, lags and play know what came before a segment.
    """
    whole = np.zeros((len(actions), frame_skip, model.nu))
    data = segments.trajectories
    for first, last in (data.spans[i] for i in np.unique(data.trajectory[segments.steps[part, 0]])):
        whole[first:last] = changed(actions[first:last], model, frame_skip, active).reshape(
            last - first, frame_skip, model.nu
        )
    chosen = np.where(
        segments.steps >= 0, segments.steps, segments.steps.max(axis=1, keepdims=True)
    )
    return whole[chosen].reshape(len(segments), -1, model.nu)


def changed(
    commands: Array, model: mujoco.MjModel, frame_skip: int, active: ActiveEffects
) -> Array:
    """(T frame_skip, nu) a trajectory's commands, one a physics step, as the effects leave them;
    commands (T, nu) from its beginning.
    """
    step = float(model.opt.timestep)
    for instance, magnitudes in active:
        commands = commands if instance.command is None else instance.command(commands, magnitudes)
    if clamps_itself(active):
        commands = clamp(commands, model)
    commands = np.repeat(commands, frame_skip, axis=0)
    for instance, magnitudes in active:
        commands = (
            commands
            if instance.actuation is None
            else instance.actuation(commands, step, magnitudes)
        )
    return commands


def clamp(commands: Array, model: mujoco.MjModel) -> Array:
    """Commands (T, nu) within the actuators' control ranges, as MuJoCo does it itself."""
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return np.clip(commands, low, high)


def changes_commands(active: ActiveEffects) -> bool:
    """Whether an effect changes commands that do not depend on the state."""
    return any(
        instance.command is not None or instance.actuation is not None for instance, _ in active
    )


def true_starts(rows: Array, slopes: Array, layout: Layout, active: ActiveEffects) -> Array:
    """Start observations (n, P) as they were, from measured ones; slopes (n, p) of the signals
    [1/s].
    """
    hooks = [
        (instance.start, magnitudes)
        for instance, magnitudes in active
        if instance.start is not None
    ]
    for start, magnitudes in hooks:
        rows = layout.move(rows, start(layout.coordinates(rows, rows), slopes, magnitudes))
    return rows


def sensed(signals: Array, active: ActiveEffects) -> Array:
    """Signals (..., p) as the sensors give them."""
    for instance, magnitudes in active:
        signals = (
            signals if instance.measurement is None else instance.measurement(signals, magnitudes)
        )
    return signals


def lateness(active: ActiveEffects, p: int) -> Array:
    """(p,) how late each signal is seen [s]."""
    return sum(
        (
            instance.sensor_delay(magnitudes)
            for instance, magnitudes in active
            if instance.sensor_delay is not None
        ),
        start=np.zeros(p),
    )


def slopes_of(segments: Segments, layout: Layout, control_step: float) -> Array:
    """(N, p) how fast the measured signals move at each segment's start [1/s]: central differences
    within its trajectory.
    """
    data = segments.trajectories
    at = segments.steps[:, 0]
    first = np.array([span[0] for span in data.spans])[data.trajectory[at]]
    before = np.maximum(at - 1, first)
    rows = data.observations[at]
    after = data.next_observations[at]
    ahead = layout.coordinates(after, rows)
    behind = layout.coordinates(data.observations[before], rows)
    return (ahead - behind) / ((1 + at - before)[:, None] * control_step)


def curvatures_of(segments: Segments, layout: Layout, control_step: float) -> Array:
    """(N, p) by how much the speed of each measured signal changes from step to step around each
    segment's start [1/s]: the root mean square of three second differences, fewer at the ends of
    its trajectory.
    """
    data = segments.trajectories
    at = segments.steps[:, 0]
    first, last = np.array(data.spans)[data.trajectory[at]].T
    here = data.observations[at]
    moves = [
        layout.coordinates(data.next_observations[k], here)
        - layout.coordinates(data.observations[k], here)
        for k in (np.clip(at + shift, first, last - 1) for shift in (-2, -1, 0, 1))
    ]
    apart = np.diff(moves, axis=0) / control_step
    counted = np.sum(
        [(at + shift >= first) & (at + shift < last - 1) for shift in (-2, -1, 0)], axis=0
    )
    return np.asarray(np.sqrt((apart**2).sum(axis=0) / np.maximum(counted, 1)[:, None]))


def seen_late(trace: Array, delays: Array) -> Array:
    """Columns (n, J, c) of a trace (n, 1 + steps, c), one value a physics step, J evenly spaced
    steps late by so many steps (c,).

    What lies before the start is continued backwards from its first step.
    """
    steps = trace.shape[1] - 1
    out = np.empty((len(trace), steps, trace.shape[2]))
    for column, delay in enumerate(delays):
        place = np.arange(1, steps + 1) - delay
        low = np.clip(np.floor(place).astype(int), 0, steps - 1)
        share = place - low
        out[:, :, column] = (1 - share) * trace[:, low, column] + share * trace[:, low + 1, column]
    return out
