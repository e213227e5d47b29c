"""What effects do outside of the physics: to the commands on their way in, and to the measurements on their way out."""

import mujoco
import numpy as np

from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.observation import Layout
from dropo.simulators.mujoco.worker import Present, clamps_itself


def by_gate(present: Present, segments: Segments, part: Ints) -> list[tuple[Ints, Present]]:
    """A part of the segments in sets that have the same effects, with the sizes that hold there."""
    if all(atom.gate is None for atom, _ in present):
        return [(part, present)]
    if len(segments.levels) > 1:
        chained = next(atom.label for atom, _ in present if atom.gate is not None)
        raise Incompatible(f"{chained} changes from segment to segment, and with reset='partial' one goes on where another ended."
                           " Use reset='transition' or 'start'.")  # fmt: skip
    shares = np.ones((len(part), len(present)))
    for i, (atom, sizes) in enumerate(present):
        if atom.gate is not None:
            shares[:, i] = atom.gate(segments, sizes)[part]
    rows, which = np.unique(shares, axis=0, return_inverse=True)
    sets = [[(atom, share * sizes) for (atom, sizes), share in zip(present, row, strict=True) if share != 0] for row in rows]
    return [(part[which.ravel() == i], those) for i, those in enumerate(sets)]


def declared_values(values: Array, present: Present) -> Array:
    """The declared parameters' values (d,) as the effects leave them."""
    for atom, sizes in present:
        values = values if atom.declared is None else atom.declared(values, sizes)
    return values


def commands_of(segments: Segments, part: Ints, actions: Array, model: mujoco.MjModel, frame_skip: int, present: Present) -> Array:
    """(N, L frame_skip, nu) commands, one a physics step, as the effects leave them, 0 in trajectories that the part is not of.

    actions (T, nu) of all transitions. Effects see a trajectory's commands from its beginning, so that delays, lags and play know
    what came before a segment.
    """
    whole = np.zeros((len(actions), frame_skip, model.nu))
    data = segments.trajectories
    for first, last in (data.spans[i] for i in np.unique(data.trajectory[segments.steps[part, 0]])):
        whole[first:last] = changed(actions[first:last], model, frame_skip, present).reshape(last - first, frame_skip, model.nu)
    chosen = np.where(segments.steps >= 0, segments.steps, segments.steps.max(axis=1, keepdims=True))
    return whole[chosen].reshape(len(segments), -1, model.nu)


def changed(commands: Array, model: mujoco.MjModel, frame_skip: int, present: Present) -> Array:
    """(T frame_skip, nu) a trajectory's commands, one a physics step, as the effects leave them; commands (T, nu) from its beginning."""
    step = float(model.opt.timestep)
    for atom, sizes in present:
        commands = commands if atom.command is None else atom.command(commands, sizes)
    if clamps_itself(present):
        commands = clamp(commands, model)
    commands = np.repeat(commands, frame_skip, axis=0)
    for atom, sizes in present:
        commands = commands if atom.actuation is None else atom.actuation(commands, step, sizes)
    return commands


def clamp(commands: Array, model: mujoco.MjModel) -> Array:
    """Commands (T, nu) within the actuators' control ranges, as MuJoCo does it itself."""
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return np.clip(commands, low, high)


def changes_commands(present: Present) -> bool:
    """Whether an effect changes commands that do not depend on the state."""
    return any(atom.command is not None or atom.actuation is not None for atom, _ in present)


def true_starts(rows: Array, slopes: Array, layout: Layout, present: Present) -> Array:
    """Start observations (n, P) as they were, from measured ones; slopes (n, p) of the signals [1/s]."""
    hooks = [(atom.start, sizes) for atom, sizes in present if atom.start is not None]
    for start, sizes in hooks:
        rows = layout.move(rows, start(layout.coordinates(rows, rows), slopes, sizes))
    return rows


def sensed(signals: Array, present: Present) -> Array:
    """Signals (..., p) as the sensors give them."""
    for atom, sizes in present:
        signals = signals if atom.sense is None else atom.sense(signals, sizes)
    return signals


def lateness(present: Present, p: int) -> Array:
    """(p,) how late each signal is seen [s]."""
    return sum((atom.late(sizes) for atom, sizes in present if atom.late is not None), start=np.zeros(p))


def slopes_of(segments: Segments, layout: Layout, control_step: float) -> Array:
    """(N, p) how fast the measured signals move at each segment's start [1/s]: central differences within its trajectory."""
    data = segments.trajectories
    at = segments.steps[:, 0]
    first = np.array([span[0] for span in data.spans])[data.trajectory[at]]
    before = np.maximum(at - 1, first)
    rows, after = data.observations[at], data.next_observations[at]
    ahead = layout.coordinates(after, rows)
    behind = layout.coordinates(data.observations[before], rows)
    return (ahead - behind) / ((1 + at - before)[:, None] * control_step)


def bends_of(segments: Segments, layout: Layout, control_step: float) -> Array:
    """(N, p) by how much the speed of each measured signal changes from step to step around each segment's start [1/s]: the root mean
    square of three second differences, fewer at the ends of its trajectory."""
    data, at = segments.trajectories, segments.steps[:, 0]
    first, last = np.array(data.spans)[data.trajectory[at]].T
    here = data.observations[at]
    moves = [layout.coordinates(data.next_observations[k], here) - layout.coordinates(data.observations[k], here)
             for k in (np.clip(at + shift, first, last - 1) for shift in (-2, -1, 0, 1))]  # fmt: skip
    apart = np.diff(moves, axis=0) / control_step
    counted = np.sum([(at + shift >= first) & (at + shift < last - 1) for shift in (-2, -1, 0)], axis=0)
    return np.asarray(np.sqrt((apart**2).sum(axis=0) / np.maximum(counted, 1)[:, None]))


def seen_late(trace: Array, delays: Array) -> Array:
    """Columns (n, J, c) of a trace (n, 1 + steps, c), one value a physics step, J evenly spaced steps late by so many steps (c,).

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
