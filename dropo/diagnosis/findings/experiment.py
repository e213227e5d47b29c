"""The commands under which two effects differ most that the recorded data cannot distinguish.

Candidate commands are simulated under both effects.
"""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State
from dropo.evaluation.open_loop import open_loop
from dropo.mjmodel.robot_simulator import RobotSimulator

FULL = 1.0
HALF = 0.5


@dataclass(frozen=True)
class ExperimentSettings:
    """Which experiments are tried.

    Attributes
    ----------
    length : int
        Control steps of a simulated experiment.
    starts : int
        Measured starts from which each is simulated.
    periods : tuple of int
        Periods of sine and square waves [control steps].
    amplitudes : tuple of float
        Fractions of the largest command in the data, about their median.
    margin : float
        By how much signals may leave the recorded range, as a fraction of it.
    distinct : float
        Difference in log-likelihood that distinguishes two effects [nats].
    """

    length: int = 50
    starts: int = 4
    periods: tuple[int, ...] = (4, 10, 25, 50)
    amplitudes: tuple[float, ...] = (HALF, FULL)
    margin: float = 0.25
    distinct: float = 10.0


SETTINGS = ExperimentSettings()


@dataclass(frozen=True)
class Experiment:
    """Commands to record.

    Attributes
    ----------
    of : str or None
        The actuator that moves; None for all.
    shape : {"constant", "sine", "square"}
        Of the command over time.
    period : float
        [s]; 0 for a constant command.
    amplitude : float
        Fraction of the largest command in the data.
    step : float
        The control step [s].
    nats : float
        By how much the two effects differ in `settings.length` control steps of it.
    now : float
        By how much they differ in as many steps of the data.
    settings : ExperimentSettings
        How it was simulated.
    """

    of: str | None
    shape: str
    period: float
    amplitude: float
    step: float
    nats: float = 0.0
    now: float = 0.0
    settings: ExperimentSettings = SETTINGS

    def __str__(self) -> str:
        """Such as "a square wave on leg_joint, period 0.08 s, at half of the largest command"."""
        where = self.of or "all actuators"
        command = f"a constant command on {where}"
        if self.period:
            command = f"a {self.shape} wave on {where}, period {self.period:.3g} s"
        half = "half of " if self.amplitude == HALF else ""
        return f"{command}, at {half}the largest command recorded"

    @property
    def seconds(self) -> float:
        """How much of it would distinguish the two, in whole control steps [s]."""
        if not self.nats > 0:
            return np.inf
        repetitions = self.settings.distinct / self.nats
        return self.step * max(1, int(np.ceil(repetitions * self.settings.length)))


def experiment(
    library: Library,
    last: State,
    one: EffectInstance,
    other: EffectInstance,
    sizes: Array,
    settings: ExperimentSettings = SETTINGS,
) -> Experiment | None:
    """Choose the commands under which an effect differs most from another.

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
        Which commands are tried.

    Returns
    -------
    Experiment or None
        None where there is nothing to command, or where predictions are no observations from which
        a window could start.

    Notes
    -----
    The difference is the length of the first effect's response without its projection on the
    other's, in units of the noise, window by window as the data are evaluated.
    """
    windows = last.train.windows
    data = windows.segments.trajectories
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return None
    commanded = np.any(np.ptp(data.actions, axis=0) > 0)
    if not commanded or len(simulator.signals) != data.observations.shape[1]:
        return None

    # The model with everything; without the first effect; with the other in its place.
    thetas = np.repeat(last.theta[None], 3, axis=0)
    thetas[1:, library.places[one.label]] = 0.0
    thetas[2, library.places[other.label]] = sizes
    sigma = last.train.whiten.sigma

    # What the recorded data say of the difference.
    recorded = _responses(library, thetas, windows.segments, sigma).reshape(2, 1, -1)
    now = float(_difference(recorded)[0] * settings.length / windows.steps)

    # What each candidate says, from several measured starts.
    names = simulator.action_names
    step = simulator.control_step
    tried = _candidates(names, step, settings)
    rows = np.linspace(0, len(data) - 1, settings.starts).astype(int)
    starts = np.tile(data.observations[rows], (len(tried), 1))
    commands = np.repeat(_commands(data, tried, names, step, settings), settings.starts, axis=0)
    simulated = _windows(library, last, starts, commands, settings)
    responses = _responses(library, thetas, simulated, sigma).reshape(2, len(tried), -1)
    nats = _difference(responses) / settings.starts
    best = int(np.argmax(nats))
    return replace(tried[best], nats=float(nats[best]), now=now)


def _candidates(
    names: list[str], step: float, settings: ExperimentSettings = SETTINGS
) -> list[Experiment]:
    """Every shape, period and amplitude, on each actuator and on all of them."""
    actuators: list[str | None] = [*names]
    if len(names) > 1:
        actuators.append(None)
    shapes = [("constant", 0.0)]
    for shape in ("sine", "square"):
        shapes += [(shape, period * step) for period in settings.periods]
    return [
        Experiment(actuator, shape, period, amplitude, step, settings=settings)
        for actuator in actuators
        for shape, period in shapes
        for amplitude in settings.amplitudes
    ]


def _commands(
    data: Trajectories,
    tried: list[Experiment],
    names: list[str],
    step: float,
    settings: ExperimentSettings = SETTINGS,
) -> Array:
    """(candidates, length, q) about the median of the data's commands, none larger than theirs."""
    middle = np.median(data.actions, axis=0)
    largest = np.abs(data.actions - middle).max(axis=0)
    waves = [_wave(candidate, names, step, settings.length) for candidate in tried]
    return np.stack([middle + largest * wave for wave in waves])


def _wave(candidate: Experiment, names: list[str], step: float, length: int) -> Array:
    """(length, q) between -1 and 1; where all actuators move, each a little later than the last."""
    moves = np.array([candidate.of in (None, name) for name in names], dtype=float)
    time = (np.arange(length)[:, None] + 0.5) * step
    lag = np.arange(len(names)) / (2 * len(names)) * (candidate.of is None)
    turn = np.sin(2 * np.pi * (time / (candidate.period or 1.0) + lag))
    if candidate.shape == "constant":
        turn = np.ones_like(turn)
    elif candidate.shape == "square":
        turn = np.where(turn >= 0, 1.0, -1.0)
    return candidate.amplitude * moves * turn


def _windows(
    library: Library,
    last: State,
    starts: Array,
    commands: Array,
    settings: ExperimentSettings,
) -> Segments:
    """Windows of what the model predicts under the commands, as long as those of the data.

    Windows that would begin beyond what was recorded, or where the simulation diverges, begin at
    the experiment's start instead, where they say no more than the first.
    """
    length = settings.length
    states = open_loop(library.simulator, last.theta, starts, commands)[:, :-1]
    recorded = last.train.windows.segments.trajectories.observations
    margin = settings.margin * np.ptp(recorded, axis=0)
    low = recorded.min(axis=0) - margin
    high = recorded.max(axis=0) + margin
    inside = ((states >= low) & (states <= high)).all(axis=2)
    good = np.logical_and.accumulate(inside, axis=1)[:, :, None]
    rows = np.where(good, states, starts[:, None]).reshape(-1, starts.shape[1])
    ends = np.tile(np.arange(length) == length - 1, len(starts))
    data = Trajectories(rows, commands.reshape(len(rows), -1), rows, ends)
    return data.segments(min(last.train.windows.length, length), every_step=True)


def _responses(library: Library, thetas: Array, segments: Segments, sigma: Array) -> Array:
    """(2, rows, p) the response to each effect, in standard deviations of the noise.

    0 where a simulation diverges.
    """
    with_one, without, with_other = library.simulator.predict(thetas, segments) / sigma
    return np.asarray(np.nan_to_num(np.stack([with_one - without, with_other - without])))


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
