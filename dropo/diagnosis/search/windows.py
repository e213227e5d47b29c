"""Windows of several steps, every step compared, and how they are split into those that a fit sees
and those that judge it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, require

# blocks of time where there are too few trajectories to split, or to tell how much a sum over them
# varies
BLOCKS = 24
FEW = 8  # trajectories on one side below which windows are counted by shorter blocks
STILL = 0.01  # of a signal's spread: a window in which none moves farther is at rest
FEWEST = 8  # windows on each side, below which nothing can be confirmed


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of L steps: what was measured (W, L p), and the trajectory or block of time (W,)
    that each belongs to.
    """

    segments: Segments
    measured: Array
    block: Ints
    length: int

    def __len__(self) -> int:
        return len(self.block)

    def take(self, index: Ints) -> "Windows":
        """Some of the windows."""
        return Windows(
            self.segments.take(index), self.measured[index], self.block[index], self.length
        )

    @property
    def steps(self) -> int:
        """Control steps in all windows."""
        return len(self) * self.length


def split(problem: Problem, length: int, most: int) -> tuple[Windows, Windows]:
    """Windows to fit and windows held out, about `most` of each, evenly spread.

    Held out are the problem's own held-out trajectories where it has such, else every other
    trajectory, else every other block of time of the few there are. Windows have a step between
    them, so that no measurement is used twice. Where a side has few trajectories, their windows are
    told apart by blocks of neighbours. Windows at rest are left out, unless few move: they say
    little of the model, and would have the noise look like nothing.
    """
    data = problem.trajectories
    sides = [_moving(problem, *_side(problem, length, held_out)) for held_out in (False, True)]
    for name, (_, steps, _) in zip(("fit", "hold out"), sides, strict=True):
        if len(steps) < FEWEST:
            raise BadArgument(
                f"A diagnosis needs at least {FEWEST} windows of {length} steps to {name}. "
                f"Got {len(steps)} from {len(data)} transitions in"
                f" {len(data.spans)} trajectories. Give more data, about "
                f"{4 * FEWEST * (length + 1)} transitions, or shorter windows."
            )
    first, second = (_windows(problem.simulator, *side, length, most) for side in sides)
    return first, second


def held_out_windows(problem: Problem, length: int, most: int) -> Windows:
    """Windows of the data that `split` holds out, which may overlap; there may be few or none."""
    return _windows(problem.simulator, *_side(problem, length, True, stride=1), length, most)


ROTATIONS = (
    ".rx",
    ".ry",
    ".rz",
)  # ends of the names of a quaternion's signals: 0 at the measurement, by their chart


def spread_of(simulator: Simulator, windows: Windows) -> Array:
    """(p,) the standard deviation of each measured signal; 1 rad for rotations, which are compared
    in the chart at the measurement.
    """
    signals = windows.measured.reshape(len(windows) * windows.length, -1)
    spread = np.where(np.ptp(signals, axis=0) > 0, signals.std(axis=0), 0.0)
    turns = np.array([signal.name.endswith(ROTATIONS) for signal in simulator.signals])
    return np.where(turns, 1.0, spread)


def _side(
    problem: Problem, length: int, held_out: bool, stride: int = 0
) -> tuple[Trajectories, Ints, Ints]:
    """The data, the rows (W, L) and the blocks (W,) of the windows of one side."""
    data = problem.held_out if held_out and problem.held_out is not None else problem.trajectories
    apart = problem.held_out is not None
    steps, block = _cut(
        data, length, data.trajectory if apart else _blocks(data, length), stride or length + 1
    )
    mine = np.ones(len(block), dtype=bool) if apart else block % 2 == held_out
    return data, steps[mine], _finer(block[mine])


def _moving(
    problem: Problem, data: Trajectories, steps: Ints, block: Ints
) -> tuple[Trajectories, Ints, Ints]:
    """Without the windows in which no column moves."""
    if not len(steps):
        return data, steps, block
    spread = np.maximum(problem.trajectories.observations.std(axis=0), 1e-300)
    path = np.concatenate(
        [data.observations[steps[:, :1]], data.next_observations[steps]], axis=1
    )  # (W, L + 1, P)
    moves = np.asarray((np.ptp(path, axis=1) > STILL * spread).any(axis=1))
    return (data, steps[moves], block[moves]) if moves.sum() >= FEWEST else (data, steps, block)


def _blocks(data: Trajectories, length: int) -> Ints:
    """(N,) what is held out together: trajectories, or blocks of time within them where there are
    fewer than four.
    """
    if len(data.spans) >= 4:
        return data.trajectory
    out = np.empty(len(data), dtype=np.int64)
    first = 0
    for start, stop in data.spans:
        each = max(1, min(BLOCKS // len(data.spans), (stop - start) // (length + 1)))
        out[start:stop] = first + np.arange(stop - start) * each // (stop - start)
        first += each
    return out


def _finer(block: Ints) -> Ints:
    """The blocks (W,) as they are, or where they are few each cut into pieces of neighbouring
    windows.
    """
    which, count = np.unique(block, return_counts=True)
    if len(which) >= FEW:
        return block
    pieces = [np.arange(n) * max(1, min(n, BLOCKS // len(which))) // n for n in count]
    return np.asarray(
        BLOCKS * block + np.concatenate([*pieces, []]).astype(np.int64), dtype=np.int64
    )


def _cut(data: Trajectories, length: int, blocks: Ints, stride: int) -> tuple[Ints, Ints]:
    """Rows (W, L) of windows that begin every so many steps, none across the end of a trajectory or
    block; and their blocks (W,).
    """
    require(length >= 1, "length", "at least 1 step", length, "windows")
    edges = np.flatnonzero(np.diff(blocks) != 0) + 1
    ends = sorted({0, len(data), *edges.tolist(), *(stop for _, stop in data.spans)})
    firsts = [np.arange(a, b - length + 1, stride) for a, b in pairwise(ends)]
    begin = np.concatenate(firsts).astype(np.int64)
    return begin[:, None] + np.arange(length), blocks[begin]


def _windows(
    simulator: Simulator, data: Trajectories, steps: Ints, block: Ints, length: int, most: int
) -> Windows:
    if len(steps) > most:
        chosen = np.linspace(0, len(steps) - 1, most).round().astype(np.int64)
        steps = steps[chosen]
        block = block[chosen]
    segments = data.from_rows(steps[:, 0], length, every_step=True)
    return Windows(
        segments,
        simulator.targets(segments).reshape(len(steps), length * len(simulator.signals)),
        block,
        length,
    )
