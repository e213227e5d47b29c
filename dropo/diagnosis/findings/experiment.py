"""The commands that would tell two effects apart that the data cannot: candidates, simulated under
both.
"""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import State
from dropo.evaluation.open_loop import open_loop
from dropo.mjmodel.robot_simulator import RobotSimulator

LENGTH = 50  # control steps of an experiment
STARTS = 4  # measured starts from which each is simulated
PERIODS = (4, 10, 25, 50)  # control steps
BEYOND = 0.25  # of what was recorded of each signal: the room beyond that
CLEAR = 10.0  # [nats] that tell two effects apart
# of the commands that the data hold, about their median
FULL = 1.0
HALF = 0.5


@dataclass(frozen=True)
class Experiment:
    """Commands to record. of: the actuator that moves, None for all; shape: "constant", "sine" or
    "square"; period [s], 0 for a constant command; amplitude: share of the largest command in
    the data; step: the control step [s]; nats: what `LENGTH` steps of it tell; now: what as many
    steps of the data tell.
    """

    of: str | None
    shape: str
    period: float
    amplitude: float
    step: float
    nats: float = 0.0
    now: float = 0.0

    def __str__(self) -> str:
        """ "a square wave on leg_joint, period 0.08 s, at half of the largest command recorded"."""
        where = self.of or "all actuators"
        shape = (
            f"a {self.shape} wave on {where}, period {self.period:.3g} s"
            if self.period
            else f"a constant command on {where}"
        )
        return (
            f"{shape}, at {'half of ' if self.amplitude == HALF else ''}the largest command "
            "recorded"
        )

    @property
    def seconds(self) -> float:
        """How much of it would tell the two apart, in whole control steps."""
        return (
            self.step * max(1, int(np.ceil(CLEAR / self.nats * LENGTH)))
            if self.nats > 0
            else np.inf
        )


def experiment(
    library: Library, last: State, one: EffectInstance, other: EffectInstance, sizes: Array
) -> Experiment | None:
    """Of the candidates the one under which the effect differs most from the other (of sizes (q,)),
    whatever the other's size: the length of its response without its projection on the other's,
    in units of the noise, window by window as the data are judged.

    None where there is nothing to command, or where predictions are no observations to start a
    window from.
    """
    windows = last.train.windows
    data = windows.segments.trajectories
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return None
    if (
        not np.any(np.ptp(data.actions, axis=0) > 0)
        or len(simulator.signals) != data.observations.shape[1]
    ):
        return None
    names = simulator.action_names
    tried = _candidates(names, simulator.control_step)
    thetas = np.repeat(last.theta[None], 3, axis=0)
    thetas[1:, library.places[one.label]] = 0.0
    thetas[2, library.places[other.label]] = sizes
    recorded = _told(library, thetas, windows.segments, last.train.whiten.sigma).reshape(2, 1, -1)
    starts = np.tile(
        data.observations[np.linspace(0, len(data) - 1, STARTS).astype(int)], (len(tried), 1)
    )
    commands = np.repeat(_commands(data, tried, names, simulator.control_step), STARTS, axis=0)
    imagined = _told(
        library, thetas, _windows(library, last, starts, commands), last.train.whiten.sigma
    ).reshape(2, len(tried), -1)
    found = _nats(imagined) / STARTS
    best = int(np.argmax(found))
    return replace(
        tried[best], nats=float(found[best]), now=float(_nats(recorded)[0] * LENGTH / windows.steps)
    )


def _candidates(names: list[str], step: float) -> list[Experiment]:
    places: list[str | None] = [*names, *([None] if len(names) > 1 else [])]
    shapes = [
        ("constant", 0.0),
        *((shape, period * step) for shape in ("sine", "square") for period in PERIODS),
    ]
    return [
        Experiment(place, shape, period, size, step)
        for place in places
        for shape, period in shapes
        for size in (HALF, FULL)
    ]


def _commands(data: Trajectories, tried: list[Experiment], names: list[str], step: float) -> Array:
    """(candidates, LENGTH, q) about the median of the data's commands, none larger than theirs."""
    middle = np.median(data.actions, axis=0)
    reach = np.abs(data.actions - middle).max(axis=0)
    return np.stack([middle + reach * _wave(one, names, step) for one in tried])


def _wave(one: Experiment, names: list[str], step: float) -> Array:
    """(LENGTH, q) between -1 and 1; where all actuators move, each a little later than the one
    before it.
    """
    moves = np.array([one.of in (None, name) for name in names], dtype=float)
    phase = (np.arange(LENGTH)[:, None] + 0.5) * step / (one.period or 1.0) + np.arange(
        len(names)
    ) / (2 * len(names)) * (one.of is None)
    turn = np.sin(2 * np.pi * phase)
    shape = {
        "constant": np.ones_like(turn),
        "sine": turn,
        "square": np.where(turn >= 0, 1.0, -1.0),
    }[one.shape]
    return one.amplitude * moves * shape


def _windows(library: Library, last: State, starts: Array, commands: Array) -> Segments:
    """Windows of what the model predicts under the commands, as long as those of the data, or as
    the experiment is; those that begin beyond what was recorded, or where the simulation
    diverges, begin at the experiment's start instead, where they tell no more than the first.
    """
    states = open_loop(library.simulator, last.theta, starts, commands)[:, :-1]
    linearized = last.train.windows.segments.trajectories.observations
    room = BEYOND * np.ptp(linearized, axis=0)
    inside = ((states >= linearized.min(axis=0) - room) & (states <= linearized.max(axis=0) + room)).all(axis=2)
    good = np.logical_and.accumulate(inside, axis=1)[:, :, None]
    rows = np.where(good, states, starts[:, None]).reshape(-1, starts.shape[1])
    ends = np.tile(np.arange(LENGTH) == LENGTH - 1, len(starts))
    data = Trajectories(rows, commands.reshape(len(rows), -1), rows, ends)
    return data.segments(min(last.train.windows.length, LENGTH), every_step=True)


def _told(library: Library, thetas: Array, segments: Segments, sigma: Array) -> Array:
    """(2, rows, p) how far each effect moves the predictions, in standard deviations of the noise;
    what diverges counts nothing.
    """
    both, bare, other = library.simulator.predict(thetas, segments) / sigma
    return np.asarray(np.nan_to_num(np.stack([both - bare, other - bare])))


def _nats(responses: Array) -> Array:
    """(parts,) of responses (2, parts, n): what tells the first effect from the second of any size."""
    first, second = responses
    share = np.einsum("kn,kn->k", first, second) / np.maximum(
        np.einsum("kn,kn->k", second, second), 1e-300
    )
    return np.asarray(0.5 * np.sum((first - share[:, None] * second) ** 2, axis=1))
