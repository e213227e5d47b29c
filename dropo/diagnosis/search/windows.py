"""Windows of several steps, every step compared, and how they are split into those that a fit sees
and those that evaluate it.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.evaluation.held_out import DataPart, held_out_part, signal_spread, thin, window_starts

BLOCKS = 24  # blocks of neighbours where trajectories are too few to tell how much a sum varies
FEW = 8  # trajectories on one side below which windows are counted by shorter blocks
STILL = 0.01  # of a signal's spread: a window in which none moves farther is at rest
FEWEST = 8  # windows on each side, below which nothing can be confirmed


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of L steps.

    Attributes
    ----------
    segments
        The windows, every step compared.
    measured
        (W, L p) what was measured.
    block
        (W,) the trajectory or block of time that each belongs to.
    length
        L.
    """

    segments: Segments
    measured: Array
    block: Ints
    length: int

    def __len__(self) -> int:
        return len(self.block)

    def take(self, index: Ints) -> "Windows":
        """Return some of the windows."""
        segments = self.segments.take(index)
        return Windows(segments, self.measured[index], self.block[index], self.length)

    @property
    def steps(self) -> int:
        """Control steps in all windows."""
        return len(self) * self.length


def split(problem: Problem, length: int, most: int) -> tuple[Windows, Windows]:
    """Cut the data into windows to fit and windows held out.

    Windows have a step between them, so that no measurement is used twice. Where a side has few
    trajectories, its windows are told apart by blocks of neighbours. Windows at rest are left out,
    unless few move: they say little of the model, and would have the noise look like nothing.

    Parameters
    ----------
    problem
        Which of its data are held out, `held_out_part` says.
    length
        Control steps in a window.
    most
        About how many windows of each side are taken, evenly spread.

    Returns
    -------
    tuple of Windows
        Those to fit, and those held out.

    Raises
    ------
    BadArgument
        If a side has fewer than `FEWEST` windows.
    """
    data = problem.trajectories
    sides = []
    for held_out, purpose in ((False, "fit"), (True, "hold out")):
        part = held_out_part(problem, length, held_out)
        starts = _moving(problem, part, window_starts(part, length, stride=length + 1), length)
        if len(starts) < FEWEST:
            raise BadArgument(
                f"A diagnosis needs at least {FEWEST} windows of {length} steps to {purpose}. Got"
                f" {len(starts)} from {len(data)} transitions in {len(data.spans)} trajectories."
                f" Give more data, about {4 * FEWEST * (length + 1)} transitions, or"
                " shorter windows."
            )
        sides.append(_side(problem.simulator, part, starts, length, most))
    return sides[0], sides[1]


def windows_from(simulator: Simulator, segments: Segments, block: Ints) -> Windows:
    """Return windows of segments of equal length with every step compared; block: (W,)."""
    length = segments.steps.shape[1]
    measured = simulator.targets(segments).reshape(len(segments), length * len(simulator.signals))
    return Windows(segments, measured, block, length)


def spread_of(simulator: Simulator, windows: Windows) -> Array:
    """Return the spread (p,) of each signal measured in the windows, as `signal_spread` has it."""
    return signal_spread(simulator, windows.measured.reshape(len(windows) * windows.length, -1))


def _side(simulator: Simulator, part: DataPart, starts: Ints, length: int, most: int) -> Windows:
    """At most so many of the windows that begin at the rows (W,)."""
    block = _finer(part.block[starts])
    chosen = thin(np.arange(len(starts)), most)
    segments = part.trajectories.from_rows(starts[chosen], length, every_step=True)
    return windows_from(simulator, segments, block[chosen])


def _moving(problem: Problem, part: DataPart, starts: Ints, length: int) -> Ints:
    """The starts (W,) of windows in which some column moves; all where those are few."""
    data = part.trajectories
    if not len(starts):
        return starts
    spread = np.maximum(problem.trajectories.observations.std(axis=0), 1e-300)
    rows = starts[:, None] + np.arange(length)
    first = data.observations[starts[:, None]]
    path = np.concatenate([first, data.next_observations[rows]], axis=1)
    moves = np.asarray((np.ptp(path, axis=1) > STILL * spread).any(axis=1))
    return starts[moves] if moves.sum() >= FEWEST else starts


def _finer(block: Ints) -> Ints:
    """The blocks (W,) as they are, or where they are few each cut into pieces of neighbours."""
    which, count = np.unique(block, return_counts=True)
    if len(which) >= FEW:
        return block
    pieces = [np.arange(n) * max(1, min(n, BLOCKS // len(which))) // n for n in count]
    piece = np.concatenate([*pieces, []]).astype(np.int64)
    return np.asarray(BLOCKS * block + piece, dtype=np.int64)
