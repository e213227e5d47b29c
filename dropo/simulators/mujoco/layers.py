"""What effects do outside of the physics: to commands before it, to measurements behind it."""

import mujoco
import numpy as np

from dropo.core.contracts.effect import ActiveEffects
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.observation import Layout
from dropo.simulators.mujoco.worker import acts_after_clamp


def split_by_time_profile(
    active: ActiveEffects, segments: Segments, part: Ints
) -> list[tuple[Ints, ActiveEffects]]:
    """Split a part of the segments into sets that have the same effects.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.
    segments : Segments
        All segments.
    part : (n,) array of int
        The segments that are split.

    Returns
    -------
    list of (array of int, sequence of (EffectInstance, (q,) array))
        The segments of each set, and the effects there, with the magnitudes that hold there.

    Raises
    ------
    Incompatible
        If an effect changes from segment to segment while segments go on where others ended.
    """
    profiled = [instance for instance, _ in active if instance.time_profile is not None]
    if not profiled:
        return [(part, active)]
    if len(segments.levels) > 1:
        raise Incompatible(
            f"{profiled[0].label} changes from segment to segment, and with reset='partial' one "
            "goes on where another ended. Use reset='transition' or 'start'."
        )
    factors = np.ones((len(part), len(active)))
    for i, (instance, magnitudes) in enumerate(active):
        if instance.time_profile is not None:
            factors[:, i] = instance.time_profile(segments, magnitudes)[part]
    rows, set_of = np.unique(factors, axis=0, return_inverse=True)
    sets: list[tuple[Ints, ActiveEffects]] = []
    for i, row in enumerate(rows):
        present = [
            (instance, factor * magnitudes)
            for (instance, magnitudes), factor in zip(active, row, strict=True)
            if factor != 0
        ]
        sets.append((part[set_of.ravel() == i], present))
    return sets


def declared_values(values: Array, active: ActiveEffects) -> Array:
    """Change the values of the declared parameters as the effects do.

    Parameters
    ----------
    values : (d,) array
        Of the declared parameters, in their units.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    (d,) array
        The same array if no effect changes it.
    """
    for instance, magnitudes in active:
        if instance.declared is not None:
            values = instance.declared(values, magnitudes)
    return values


def commands_per_physics_step(
    segments: Segments,
    part: Ints,
    actions: Array,
    model: mujoco.MjModel,
    frame_skip: int,
    active: ActiveEffects,
) -> Array:
    """Compute the commands of every physics step, as the effects change them.

    Effects see the commands of a trajectory from its beginning, so that delays, lags and play know
    what came before a segment.

    Parameters
    ----------
    segments : Segments
        N segments of up to L control steps.
    part : (n,) array of int
        The segments whose trajectories are computed.
    actions : (T, nu) array
        The commands of all transitions of the data.
    model : MjModel
        The compiled model.
    frame_skip : int
        Physics steps in a control step.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    (N, L frame_skip, nu) array
        0 in other trajectories than those of the part.
    """
    data = segments.trajectories
    whole = np.zeros((len(actions), frame_skip, model.nu))
    for i in np.unique(data.trajectory[segments.steps[part, 0]]):
        first, last = data.spans[i]
        commands = change_commands(actions[first:last], model, frame_skip, active)
        whole[first:last] = commands.reshape(last - first, frame_skip, model.nu)
    # behind its end, a segment repeats its last step
    last_step = segments.steps.max(axis=1, keepdims=True)
    chosen = np.where(segments.steps >= 0, segments.steps, last_step)
    return whole[chosen].reshape(len(segments), -1, model.nu)


def change_commands(
    commands: Array, model: mujoco.MjModel, frame_skip: int, active: ActiveEffects
) -> Array:
    """Change the commands of a trajectory as the effects do.

    Parameters
    ----------
    commands : (T, nu) array
        One a control step, from the trajectory's beginning.
    model : MjModel
        The compiled model.
    frame_skip : int
        Physics steps in a control step.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    (T frame_skip, nu) array
        One a physics step.
    """
    for instance, magnitudes in active:
        if instance.command is not None:
            commands = instance.command(commands, magnitudes)
    if acts_after_clamp(active):
        commands = clamp(commands, model)
    commands = np.repeat(commands, frame_skip, axis=0)
    step = float(model.opt.timestep)
    for instance, magnitudes in active:
        if instance.actuation is not None:
            commands = instance.actuation(commands, step, magnitudes)
    return commands


def clamp(commands: Array, model: mujoco.MjModel) -> Array:
    """Clamp commands to the actuators' control ranges, as MuJoCo does itself.

    Parameters
    ----------
    commands : (T, nu) array
        Commands of T steps.
    model : MjModel
        Its actuators have the ranges.

    Returns
    -------
    (T, nu) array
        Commands of actuators without a range as they are.
    """
    low, high = control_ranges(model)
    return np.clip(commands, low, high)


def control_ranges(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Read the ends of the actuators' control ranges.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    low : (nu,) array
        Lower ends, -inf where there is no range.
    high : (nu,) array
        Upper ends, inf where there is no range.
    """
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
    return low, high


def changes_commands(active: ActiveEffects) -> bool:
    """Return whether an effect changes commands independently of the state.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    bool
        True with a hook `command` or `actuation`.
    """
    return any(
        instance.command is not None or instance.actuation is not None for instance, _ in active
    )


def true_starts(rows: Array, speeds: Array, layout: Layout, active: ActiveEffects) -> Array:
    """Correct measured start observations for the effects of the sensors.

    Parameters
    ----------
    rows : (n, P) array
        Measured start observations.
    speeds : (n, p) array
        The speeds of the measured signals [1/s].
    layout : Layout
        The columns of observations.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    (n, P) array
        The true start observations.
    """
    for instance, magnitudes in active:
        if instance.start is not None:
            offsets = instance.start(layout.coordinates(rows, rows), speeds, magnitudes)
            rows = layout.move(rows, offsets)
    return rows


def measured_signals(signals: Array, active: ActiveEffects) -> Array:
    """Turn true signals into those that the sensors measure, delays aside.

    Parameters
    ----------
    signals : (..., p) array
        In the signals' units.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    (..., p) array
        After every hook `measurement`, in the order of the effects.
    """
    for instance, magnitudes in active:
        if instance.measurement is not None:
            signals = instance.measurement(signals, magnitudes)
    return signals


def total_delays(active: ActiveEffects, p: int) -> Array:
    """Add up the delays of each signal.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.
    p : int
        Number of signals.

    Returns
    -------
    (p,) array
        The time by which each is measured late [s].
    """
    total = np.zeros(p)
    for instance, magnitudes in active:
        if instance.sensor_delay is not None:
            total = total + instance.sensor_delay(magnitudes)
    return total


def start_speeds(segments: Segments, layout: Layout, control_step: float) -> Array:
    """Estimate the speeds of the measured signals at the starts of segments.

    Parameters
    ----------
    segments : Segments
        N segments.
    layout : Layout
        The columns of observations.
    control_step : float
        [s]

    Returns
    -------
    (N, p) array
        Central differences within the trajectory, one-sided at its beginning [1/s].
    """
    data = segments.trajectories
    at = segments.steps[:, 0]
    first = np.array([span[0] for span in data.spans])[data.trajectory[at]]
    before = np.maximum(at - 1, first)
    rows = data.observations[at]
    ahead = layout.coordinates(data.next_observations[at], rows)
    behind = layout.coordinates(data.observations[before], rows)
    return (ahead - behind) / ((1 + at - before)[:, None] * control_step)


def start_curvatures(segments: Segments, layout: Layout, control_step: float) -> Array:
    """Estimate by how much the speeds of the measured signals change from step to step.

    Parameters
    ----------
    segments : Segments
        N segments.
    layout : Layout
        The columns of observations.
    control_step : float
        [s]

    Returns
    -------
    (N, p) array
        The root mean square of three second differences around each start, of fewer at the ends of
        its trajectory [1/s].
    """
    data = segments.trajectories
    at = segments.steps[:, 0]
    first, last = np.array(data.spans)[data.trajectory[at]].T
    here = data.observations[at]
    moves = []
    for shift in (-2, -1, 0, 1):
        k = np.clip(at + shift, first, last - 1)
        after = layout.coordinates(data.next_observations[k], here)
        moves.append(after - layout.coordinates(data.observations[k], here))
    changes = np.diff(moves, axis=0) / control_step
    inside = [(at + shift >= first) & (at + shift < last - 1) for shift in (-2, -1, 0)]
    counts = np.maximum(np.sum(inside, axis=0), 1)
    return np.asarray(np.sqrt((changes**2).sum(axis=0) / counts[:, None]))


def delay_columns(trace: Array, delays: Array) -> Array:
    """Delay each column of a trace, by linear interpolation between its steps.

    Parameters
    ----------
    trace : (n, 1 + J, c) array
        The start, then one value a physics step.
    delays : (c,) array
        In physics steps.

    Returns
    -------
    (n, J, c) array
        The delayed values of the J steps. What lies before the start is continued backwards from
        the first step.
    """
    steps = trace.shape[1] - 1
    out = np.empty((len(trace), steps, trace.shape[2]))
    for column, delay in enumerate(delays):
        place = np.arange(1, steps + 1) - delay
        low = np.clip(np.floor(place).astype(int), 0, steps - 1)
        part = place - low
        out[:, :, column] = (1 - part) * trace[:, low, column] + part * trace[:, low + 1, column]
    return out
