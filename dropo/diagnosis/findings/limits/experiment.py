"""The motion under which two effects differ most that the recorded data cannot distinguish.

Smooth motions of several periods are simulated under both effects, at sizes at which positions,
velocities and forces stay within what was recorded and what the robot can do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State
from dropo.evaluation.open_loop import open_loop
from dropo.mjmodel.dynamics.forces import force_limit, linear_drives, motors
from dropo.mjmodel.joints import joints
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.simulators.mujoco.layers import clamp, control_ranges

SINES = ((1.0, 1.0, 0.0), (0.61, 0.7, 2.1), (0.37, 0.5, 4.4))
"""Of each sine of a sum: its period, in those of the slowest, its size, and its phase [rad]."""
LEVELS = (1.0, -0.5, 0.5, -1.0, 0.25, -0.75)
"""The levels of steps, which are repeated."""
Limits = tuple[Array, Array]
"""Lower and upper ends."""


@dataclass(frozen=True)
class ExperimentSettings:
    """Which motions are tried, and within which limits.

    Attributes
    ----------
    periods : tuple of float
        Slowest periods of sums of sines, and for how long steps hold [s].
    smooth : int
        Control steps that such a period has at least.
    repeats : int
        How many of these periods a motion has at least ...
    windows : int
        ... and how many windows, as long as those of the data.
    amplitudes : tuple of float
        Fractions of the largest command in the data, about their median; the largest that stays
        within all limits is taken.
    starts : int
        Measured starts near the median from which each is simulated.
    recorded : float
        By how much positions, velocities and forces may leave the recorded range, as a fraction of
        it.
    joint : float
        The margin to each end of a joint's range, as a fraction of it.
    command : float
        The same of an actuator's ctrlrange.
    force : float
        The same of its forcerange.
    distinct : float
        Difference in log-likelihood that distinguishes two effects [nats].
    """

    periods: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    smooth: int = 24
    repeats: int = 5
    windows: int = 10
    amplitudes: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)
    starts: int = 2
    recorded: float = 0.1
    joint: float = 0.02
    command: float = 0.02
    force: float = 0.05
    distinct: float = 10.0


SETTINGS = ExperimentSettings()


@dataclass(frozen=True)
class Experiment:
    """A motion to record.

    Attributes
    ----------
    of : str or None
        The actuator that moves; None for all.
    shape : {"sines", "steps"}
        Of the command over time.
    period : float
        The slowest of a sum of sines, or for how long a step holds [s].
    amplitude : float
        Fraction of the largest command in the data.
    step : float
        The control step [s].
    steps : int
        Control steps of the whole motion.
    reach : float
        By how much the command leaves its median at most, in the actuator's unit; the largest where
        all move.
    nats : float
        By how much the two effects differ in it.
    now : float
        By how much they differ in as many steps of the data.
    settings : ExperimentSettings
        How it was chosen.
    """

    of: str | None
    shape: str
    period: float
    amplitude: float
    step: float
    steps: int
    reach: float = 0.0
    nats: float = 0.0
    now: float = 0.0
    settings: ExperimentSettings = SETTINGS

    def __str__(self) -> str:
        """Such as "6 s of a sum of three sines on m1 (periods 1, 0.61, 0.37 s), ..."."""
        where = self.of or "all actuators, each a little later than the last"
        if self.shape == "sines":
            listed = ", ".join(number(self.period * share, 2) for share, _, _ in SINES)
            motion = f"a sum of three sines on {where} (periods {listed} s)"
        else:
            held = number(self.period, 2)
            motion = f"steps on {where} that change smoothly every {held} s"
        reach = f"commands up to {number(self.reach, 2)} from their median"
        return f"{number(self.seconds, 2)} s of {motion}, {reach}"

    @property
    def times(self) -> int:
        """How often it is to be recorded to distinguish the two; 0 where it never does."""
        return int(np.ceil(self.settings.distinct / self.nats)) if self.nats > 0 else 0

    @property
    def seconds(self) -> float:
        """How long all of that takes [s]; infinite where it never distinguishes the two."""
        return self.times * self.steps * self.step if self.times else np.inf

    @property
    def is_better(self) -> bool:
        """Whether it tells more than as many steps of the data do."""
        return self.nats > self.now

    @property
    def more_seconds(self) -> float:
        """How much motion like that of the data distinguishes the two [s]."""
        if not self.now > 0:
            return np.inf
        return self.settings.distinct / self.now * self.steps * self.step


def experiment(
    library: Library,
    last: State,
    one: EffectInstance,
    other: EffectInstance,
    sizes: Array,
    settings: ExperimentSettings = SETTINGS,
) -> Experiment | None:
    """Choose the motion under which an effect differs most from another.

    Parameters
    ----------
    library : Library
        The simulator with both effects.
    last : State
        Where the search ended, with the first effect.
    one, other : EffectInstance
        The effects.
    sizes : (q,) array
        Magnitudes of the other; the result does not depend on their scale.
    settings : ExperimentSettings
        Which motions are tried.

    Returns
    -------
    Experiment or None
        None where there is nothing to command, where no motion stays within the limits, or where
        predictions are no observations from which a window could start.

    Notes
    -----
    The difference is the length of the first effect's response without its projection on the
    other's, in units of the noise, window by window as the data are evaluated.
    """
    return experiments(library, last, one, [(other, sizes)], settings)[0]


def experiments(
    library: Library,
    last: State,
    one: EffectInstance,
    others: Sequence[tuple[EffectInstance, Array]],
    settings: ExperimentSettings = SETTINGS,
) -> list[Experiment | None]:
    """Choose the motions under which an effect differs most from each of several.

    Parameters
    ----------
    library, last, one, settings
        As of `experiment`.
    others : sequence of (EffectInstance, (q,) array)
        The other effects with their magnitudes.

    Returns
    -------
    list of Experiment or None
        For each of the others; the motions are simulated once for all, in coarser physics steps
        where the library has such: motions to come are not compared with data.
    """
    coarse = library.coarse
    if coarse is None:
        return _chosen(library, last, one, others, settings)
    before = coarse.steps
    planned = replace(library, simulator=coarse, coarse=None)
    found = _chosen(planned, last, one, others, settings)
    library.simulator.steps += coarse.steps - before
    return found


def _chosen(
    library: Library,
    last: State,
    one: EffectInstance,
    others: Sequence[tuple[EffectInstance, Array]],
    settings: ExperimentSettings,
) -> list[Experiment | None]:
    """As `experiments`, in the library's own steps."""
    windows = last.train.windows
    data = windows.segments.trajectories
    simulator = library.simulator
    best: list[Experiment | None] = [None] * len(others)
    if not others or not isinstance(simulator, RobotSimulator):
        return best
    commanded = np.any(np.ptp(data.actions, axis=0) > 0)
    if not commanded or len(simulator.signals) != data.observations.shape[1]:
        return best

    # The model with everything; without the first effect; with each other in its place.
    thetas = np.repeat(last.theta[None], 2 + len(others), axis=0)
    thetas[1:, library.indices_of[one.label]] = 0.0
    for theta, (other, sizes) in zip(thetas[2:], others, strict=True):
        theta[library.indices_of[other.label]] = sizes
    sigma = last.train.whiten.sigma

    # What the recorded data say of the difference.
    now = _differences(library, thetas, windows.segments, sigma) / windows.steps

    # What each candidate says, from measured starts.
    starts = _starts(data, settings)
    for group in _candidates(simulator, windows.length, settings):
        admitted = _admitted(library, last, group, starts, settings)
        for tried, commands, states in admitted:
            segments = _windows(states, commands, windows.length)
            nats = _differences(library, thetas, segments, sigma) / len(starts)
            for i, so_far in enumerate(best):
                if so_far is None or nats[i] > so_far.nats:
                    recorded = float(now[i]) * tried.steps
                    best[i] = replace(tried, nats=float(nats[i]), now=recorded)
    return best


def _starts(data: Trajectories, settings: ExperimentSettings) -> Array:
    """(k, p) the measured rows that are nearest to the median of all, as slow as it."""
    middle = np.median(data.observations, axis=0)
    spread = np.maximum(data.observations.std(axis=0), 1e-300)
    far = np.sum(((data.observations - middle) / spread) ** 2, axis=1)
    return data.observations[np.argsort(far)[: settings.starts]]


def _candidates(
    simulator: RobotSimulator, window: int, settings: ExperimentSettings = SETTINGS
) -> list[list[Experiment]]:
    """Every shape on each actuator and on all of them, by their period, at the largest commands."""
    names = simulator.action_names
    step = simulator.control_step
    actuators: list[str | None] = [*names]
    if len(names) > 1:
        actuators.append(None)
    shortest = settings.smooth * step
    periods = sorted({max(period, shortest) for period in settings.periods})
    found = []
    for period in periods:
        steps = max(settings.windows * window, int(np.ceil(settings.repeats * period / step)))
        found.append(
            [
                Experiment(of, shape, period, 1.0, step, steps, settings=settings)
                for of in actuators
                for shape in ("sines", "steps")
            ]
        )
    return found


def _admitted(
    library: Library,
    last: State,
    tried: list[Experiment],
    starts: Array,
    settings: ExperimentSettings,
) -> list[tuple[Experiment, Array, Array]]:
    """Of motions of one length, each at the largest size that stays within all limits.

    With its commands (k, T, q) and the states (k, T + 1, p) that the model predicts from k starts.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("asked of robots alone")
    data = last.train.windows.segments.trajectories
    low, high = signal_limits(simulator, data, settings)
    found = []
    for amplitude in settings.amplitudes:
        if not tried:
            break
        sized = [replace(one, amplitude=amplitude) for one in tried]
        commands = commands_of(simulator, data, sized, settings)
        every = np.repeat(commands, len(starts), axis=0)
        states = open_loop(simulator, last.theta, np.tile(starts, (len(sized), 1)), every)
        inside = np.isfinite(states).all(axis=(1, 2))
        inside &= ((states >= low) & (states <= high)).all(axis=(1, 2))
        inside &= _within_forces(simulator, data, states, every, settings)
        good = inside.reshape(len(sized), len(starts)).all(axis=1)
        middle = np.median(data.actions, axis=0)
        for i in np.flatnonzero(good).tolist():
            own = slice(i * len(starts), (i + 1) * len(starts))
            reach = float(np.abs(commands[i] - middle).max())
            found.append((replace(sized[i], reach=reach), every[own], states[own]))
        tried = [tried[i] for i in np.flatnonzero(~good).tolist()]
    return found


def commands_of(
    simulator: RobotSimulator,
    data: Trajectories,
    tried: list[Experiment],
    settings: ExperimentSettings = SETTINGS,
) -> Array:
    """Return the commands of motions of one length.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    data : Trajectories
        What was recorded.
    tried : list of Experiment
        K motions of T control steps.
    settings : ExperimentSettings
        Margins.

    Returns
    -------
    (K, T, q) array
        About the median of the data's commands, none farther from it than theirs, and within the
        actuators' ranges; each begins and ends at the median.
    """
    middle = np.median(data.actions, axis=0)
    largest = np.abs(data.actions - middle).max(axis=0)
    low, high = control_ranges(simulator.model)
    low, high = low[simulator.controls], high[simulator.controls]
    margin = np.where(np.isfinite(high - low), settings.command * (high - low), 0.0)
    room = np.minimum(middle - (low + margin), (high - margin) - middle)
    largest = np.minimum(largest, np.maximum(room, 0.0))
    waves = [_wave(one, simulator.action_names) for one in tried]
    return np.stack([middle + largest * wave for wave in waves])


def _wave(candidate: Experiment, names: list[str]) -> Array:
    """(T, q) between -1 and 1, 0 at both ends; where all move, each a little later."""
    moves = np.array([candidate.of in (None, name) for name in names], dtype=float)
    time = (np.arange(candidate.steps)[:, None] + 0.5) * candidate.step / candidate.period
    whole = candidate.steps * candidate.step / candidate.period
    lag = np.arange(len(names)) / (2 * len(names)) * (candidate.of is None)
    if candidate.shape == "sines":
        parts = [
            size * np.sin(2 * np.pi * (time + lag) / share + phase) for share, size, phase in SINES
        ]
        wave = np.sum(parts, axis=0) / sum(size for _, size, _ in SINES)
    else:
        wave = _steps(time + lag)
    ends = np.clip(np.minimum(time, whole - time), 0.0, 1.0)
    return np.asarray(candidate.amplitude * moves * wave * _eased(ends))


def _steps(time: Array) -> Array:
    """Levels that are held for a unit of time each, and change smoothly in its first half."""
    levels = np.array([0.0, *LEVELS])
    count = len(LEVELS)
    place = np.floor(time).astype(int)
    before = levels[np.where(place == 0, 0, (place - 1) % count + 1)]
    after = levels[place % count + 1]
    return np.asarray(before + (after - before) * _eased(np.minimum(2 * (time - place), 1.0)))


def _eased(share: Array) -> Array:
    """From 0 to 1 with no speed at either end."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


def signal_limits(
    simulator: RobotSimulator, data: Trajectories, settings: ExperimentSettings = SETTINGS
) -> Limits:
    """Return the limits (p,) of the observed columns: as recorded, and within joints' ranges.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    data : Trajectories
        What was recorded.
    settings : ExperimentSettings
        Margins.

    Returns
    -------
    low, high : (p,) arrays
    """
    low, high = data.observations.min(axis=0), data.observations.max(axis=0)
    margin = settings.recorded * (high - low)
    low, high = low - margin, high + margin
    ranges = {joint.qpos: joint.range for joint in joints(simulator.model)}
    for i, column in enumerate(simulator.layout.columns):
        limits = ranges.get(column.place) if column.field == "qpos" else None
        if limits is not None:
            inside = settings.joint * (limits[1] - limits[0])
            low[i] = max(low[i], limits[0] + inside)
            high[i] = min(high[i], limits[1] - inside)
    return low, high


def _within_forces(
    simulator: RobotSimulator,
    data: Trajectories,
    states: Array,
    commands: Array,
    settings: ExperimentSettings,
) -> NDArray[np.bool_]:
    """(n,) whether drives give no more than recorded and than they can, where that is known."""
    model = simulator.model
    recorded = _forces(simulator, data.observations, data.actions)
    rows = states[:, :-1].reshape(-1, states.shape[2])
    asked = _forces(simulator, rows, commands.reshape(len(rows), -1))
    if recorded is None or asked is None:
        return np.ones(len(states), dtype=bool)
    most = (1 + settings.recorded) * np.abs(recorded).max(axis=0)
    for joint, ids in motors(model):
        limit = (1 - settings.force) * force_limit(model, ids)
        most[joint.qvel] = min(most[joint.qvel], limit)
    within = (np.abs(asked) <= most).all(axis=1)
    return np.asarray(within.reshape(len(states), -1).all(axis=1))


def _forces(simulator: RobotSimulator, rows: Array, actions: Array) -> Array | None:
    """(n, nv) the drives' forces; None where the state or a drive's law is not known."""
    model = simulator.model
    column = simulator.layout.column_places
    needed = [("qpos", i) for i in range(model.nq)] + [("qvel", i) for i in range(model.nv)]
    if model.nq != model.nv or not all(place in column for place in needed):
        return None
    positions = rows[:, [column["qpos", i] for i in range(model.nq)]]
    velocities = rows[:, [column["qvel", i] for i in range(model.nv)]]
    commands = np.zeros((len(rows), model.nu))
    commands[:, simulator.controls] = actions
    try:
        return linear_drives(model, positions, velocities).forces(clamp(commands, model))
    except Incompatible:
        return None


def _windows(states: Array, commands: Array, length: int) -> Segments:
    """Windows of what the model predicts under commands, as long as those of the data."""
    rows = states[:, :-1].reshape(-1, states.shape[2])
    after = states[:, 1:].reshape(-1, states.shape[2])
    count = commands.shape[1]
    ends = np.tile(np.arange(count) == count - 1, len(states))
    data = Trajectories(rows, commands.reshape(len(rows), -1), after, ends)
    return data.segments(min(length, count), every_step=True)


def _differences(library: Library, thetas: Array, segments: Segments, sigma: Array) -> Array:
    """(k,) the nats between an effect, which the first of the models (2 + k, m) has and the second
    has not, and each other of them; where a simulation diverges, nothing.
    """
    with_one, without, *others = library.simulator.predict(thetas, segments) / sigma
    first = np.nan_to_num(with_one - without).reshape(1, -1)
    second = [np.nan_to_num(other - without).reshape(1, -1) for other in others]
    return np.array([_difference(np.stack([first, one]))[0] for one in second])


def _difference(responses: Array) -> Array:
    """(parts,) of responses (2, parts, n): the nats between the first effect and any other size of
    the second.
    """
    first, second = responses
    along = np.einsum("kn,kn->k", first, second)
    square = np.einsum("kn,kn->k", second, second)
    multiple = along / np.maximum(square, 1e-300)
    rest = first - multiple[:, None] * second
    return np.asarray(0.5 * np.sum(rest**2, axis=1))
