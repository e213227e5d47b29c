"""Windows of several steps, every step compared, and how they are split into windows to fit and
windows held out.
"""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.evaluation.held_out import DataPart, held_out_part, signal_spread, thin, window_starts


@dataclass(frozen=True)
class WindowSettings:
    """Which windows are taken.

    Attributes
    ----------
    fewest : int
        Windows on each side below which nothing can be confirmed.
    few_blocks : int
        Trajectories or blocks on one side below which they are cut into shorter blocks ...
    blocks : int
        ... of which there are then about so many: enough for the standard error of a sum.
    at_rest : float
        A window is at rest if no column moves by more than this fraction of its spread.
    one_sided : int
        Control steps at the beginning of a trajectory whose velocities, where they were estimated,
        rest on positions of one side, and are far off where motion sets in: no window begins there.
    """

    fewest: int = 8
    few_blocks: int = 8
    blocks: int = 24
    at_rest: float = 0.01
    one_sided: int = 10


SETTINGS = WindowSettings()


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of L steps and p signals.

    Attributes
    ----------
    segments : Segments
        The windows, every step compared.
    measured : (W, L p) array
        What was measured, in the signals' units.
    block : (W,) int array
        The trajectory or block of time that each belongs to.
    length : int
        L.
    start_sd : (p,) array or None
        How far starts are from the true ones in signals that were estimated, not measured, infinite
        in others; None where all were measured.
    moved : (W, p) array or None
        How far starts were moved from the estimates, in the signals' units; None if they were not.
    """

    segments: Segments
    measured: Array
    block: Ints
    length: int
    start_sd: Array | None = None
    moved: Array | None = None

    def __len__(self) -> int:
        return len(self.block)

    def take(self, index: Ints) -> "Windows":
        """Return some of the windows.

        Parameters
        ----------
        index : int array
            Which.

        Returns
        -------
        Windows
        """
        return replace(
            self,
            segments=self.segments.take(index),
            measured=self.measured[index],
            block=self.block[index],
            moved=None if self.moved is None else self.moved[index],
        )

    def with_starts(self, starts: Array, moves: Array, start_sd: Array) -> "Windows":
        """Return windows with other starts.

        Parameters
        ----------
        starts : (W, p) array
            The observations that they start from.
        moves : (W, p) array
            How far these are from the starts before, in the signals' units.
        start_sd : (p,) array
            How far they are from the true ones.

        Returns
        -------
        Windows
        """
        segments = self.segments
        observations = segments.trajectories.observations.copy()
        observations[segments.steps[:, 0]] = starts
        data = replace(segments.trajectories, observations=observations)
        moved = moves if self.moved is None else self.moved + moves
        segments = replace(segments, trajectories=data)
        return replace(self, segments=segments, start_sd=start_sd, moved=moved)

    @property
    def counted(self) -> int:
        """The measurements in a window that say something of the noise: signals that were estimated
        have none, and each of their starts takes one to be found.
        """
        signals = self.measured.shape[1] // self.length
        estimated = 0 if self.start_sd is None else int(np.isfinite(self.start_sd).sum())
        return max(self.length * (signals - estimated) - estimated, 1)

    @property
    def steps(self) -> int:
        """Control steps in all windows."""
        return len(self) * self.length


def split(
    problem: Problem, length: int, maximum: int, settings: WindowSettings = SETTINGS
) -> tuple[Windows, Windows]:
    """Cut the data into windows to fit and windows held out.

    Windows have a step between them, so that no measurement is used twice. Windows at rest are left
    out, unless few move: they say little of the model, and would make the noise seem small.

    Parameters
    ----------
    problem : Problem
        Which of its data are held out, `held_out_part` says.
    length : int
        Control steps in a window.
    maximum : int
        About how many windows of each side are taken, evenly spread.
    settings : WindowSettings
        Which windows count.

    Returns
    -------
    train, test : Windows
        Those to fit, and those held out.

    Raises
    ------
    BadArgument
        If a side has fewer windows than `settings.fewest`.
    """
    sides = []
    for held_out, purpose in ((False, "fit"), (True, "hold out")):
        part = held_out_part(problem, length, held_out)
        sides.append(cut(problem, part, length, maximum, purpose, settings))
    return sides[0], sides[1]


def cut(
    problem: Problem,
    part: DataPart,
    length: int,
    maximum: int,
    purpose: str,
    settings: WindowSettings = SETTINGS,
) -> Windows:
    """Cut some of a problem's data into windows, as `split` does with each side.

    Parameters
    ----------
    problem : Problem
        Whose data they are.
    part : DataPart
        Some of them.
    length, maximum, settings
        As of `split`.
    purpose : str
        What the windows are for, for a message.

    Returns
    -------
    Windows

    Raises
    ------
    BadArgument
        If there are fewer windows than `settings.fewest`.
    """
    skipped = settings.one_sided if problem.estimated else 0
    starts = window_starts(part, length, stride=length + 1, skipped=skipped)
    starts = _moving(problem, part, starts, length, settings)
    if len(starts) < settings.fewest:
        data = problem.trajectories
        raise BadArgument(
            f"A diagnosis needs at least {settings.fewest} windows of {length} steps to {purpose}."
            f" Got {len(starts)} from {len(data)} transitions in {len(data.spans)} trajectories."
            f" Give more data, about {4 * settings.fewest * (length + 1)} transitions, or shorter"
            " windows."
        )
    windows = _side(problem.simulator, part, starts, length, maximum, settings)
    return replace(windows, start_sd=_start_sd(problem))


def _start_sd(problem: Problem) -> Array | None:
    """The errors (p,) of starts that were estimated."""
    if not problem.estimated:
        return None
    return np.array([problem.estimated.get(one.name, np.inf) for one in problem.simulator.signals])


def windows_from(simulator: Simulator, segments: Segments, block: Ints) -> Windows:
    """Return segments of equal length as windows with every step compared.

    Parameters
    ----------
    simulator : Simulator
        Whose signals are compared.
    segments : Segments
        W of them.
    block : (W,) int array
        The trajectory or block of time that each belongs to.

    Returns
    -------
    Windows
    """
    length = segments.steps.shape[1]
    measured = simulator.targets(segments).reshape(len(segments), length * len(simulator.signals))
    return Windows(segments, measured, block, length)


def spread_of(simulator: Simulator, windows: Windows) -> Array:
    """Return the spread of each signal in the windows.

    Parameters
    ----------
    simulator : Simulator
        Of p signals.
    windows : Windows
        What was measured.

    Returns
    -------
    (p,) array
        In the signals' units, as `signal_spread` has it.
    """
    return signal_spread(simulator, windows.measured.reshape(len(windows) * windows.length, -1))


def _side(
    simulator: Simulator,
    part: DataPart,
    starts: Ints,
    length: int,
    maximum: int,
    settings: WindowSettings,
) -> Windows:
    """At most so many of the windows that begin at the rows (W,)."""
    block = _finer(part.block[starts], settings)
    chosen = thin(np.arange(len(starts)), maximum)
    segments = part.trajectories.from_rows(starts[chosen], length, every_step=True)
    return windows_from(simulator, segments, block[chosen])


def _moving(
    problem: Problem, part: DataPart, starts: Ints, length: int, settings: WindowSettings
) -> Ints:
    """The starts (W,) of windows in which some column moves; all where those are few."""
    data = part.trajectories
    if not len(starts):
        return starts
    spread = np.maximum(problem.trajectories.observations.std(axis=0), 1e-300)
    rows = starts[:, None] + np.arange(length)
    first = data.observations[starts[:, None]]
    path = np.concatenate([first, data.next_observations[rows]], axis=1)
    moves = np.asarray((np.ptp(path, axis=1) > settings.at_rest * spread).any(axis=1))
    return starts[moves] if moves.sum() >= settings.fewest else starts


def _finer(block: Ints, settings: WindowSettings) -> Ints:
    """The blocks (W,) as they are, or where they are few each cut into pieces of neighbours."""
    which, counts = np.unique(block, return_counts=True)
    if len(which) >= settings.few_blocks:
        return block
    # The windows of a block stand together: number the pieces within each.
    pieces = [np.zeros(0, dtype=np.int64)]
    for count in counts:
        parts = max(1, min(count, settings.blocks // len(which)))
        pieces.append(np.arange(count) * parts // count)
    piece = np.concatenate(pieces).astype(np.int64)
    return np.asarray(settings.blocks * block + piece, dtype=np.int64)
