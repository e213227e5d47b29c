"""Runs of rows that follow each other, cut into pieces and these into windows."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints, Segments, Trajectories


def following_rows(data: Trajectories) -> Trajectories:
    """End a trajectory wherever a row does not begin where the one before it ended.

    Parameters
    ----------
    data : Trajectories

    Returns
    -------
    Trajectories
        The same rows, of which each but a trajectory's first begins with the measurement that the
        row before it ended with.
    """
    ends = data.terminals.copy()
    ends[:-1] |= np.any(data.next_observations[:-1] != data.observations[1:], axis=1)
    return replace(data, terminals=ends)


@dataclass(frozen=True, eq=False)
class RunWindows:
    """N windows of P pieces, all transitions of the data in their order.

    A piece is a stretch of a run through which one start state decides the motion. Its windows are
    simulated each from a start of its own, and linked: a window ends where the next one starts.

    Attributes
    ----------
    runs : Trajectories
        The data; a trajectory is a run.
    cut : (n,) array of bool
        True on the last transition of every piece: of every run, and wherever one is cut.
    length : int
        The most control steps in a window.
    """

    runs: Trajectories
    cut: NDArray[np.bool_]
    length: int

    @cached_property
    def pieces(self) -> Trajectories:
        """The same rows, with a trajectory for each piece."""
        group = self.runs.trajectory if self.runs.group is None else self.runs.group
        return replace(self.runs, terminals=self.cut, group=group)

    @cached_property
    def segments(self) -> Segments:
        """The windows as segments with every step compared."""
        steps = []
        for start, stop in self.pieces.spans:
            for first in range(start, stop, self.length):
                own = np.full(self.length, -1, dtype=np.int64)
                count = min(self.length, stop - first)
                own[:count] = np.arange(first, first + count)
                steps.append(own)
        unchained = np.full(len(steps), -1, dtype=np.int64)
        columns = np.ones(self.pieces.observations.shape[1], dtype=bool)
        return Segments(self.pieces, np.stack(steps), unchained, columns, every_step=True)

    @cached_property
    def piece(self) -> Ints:
        """(N,) the piece of each window."""
        return self.segments.trajectory

    @cached_property
    def depth(self) -> Ints:
        """(N,) how many windows of its piece come before each."""
        first = np.flatnonzero(np.append(True, self.piece[1:] != self.piece[:-1]))
        return np.arange(len(self.piece)) - first[self.piece]

    @cached_property
    def opens_run(self) -> NDArray[np.bool_]:
        """(P,) whether a piece begins a run: then its first measurement is compared by it alone."""
        starts = np.array([start for start, _ in self.pieces.spans])
        return (starts == 0) | self.runs.terminals[starts - 1]

    @property
    def whole(self) -> Segments:
        """The pieces as segments with every step compared: their rows are the data's."""
        return self.pieces.segments(reset="start")

    def cut_before(self, windows: Ints) -> "RunWindows":
        """Cut the runs where given windows begin.

        Parameters
        ----------
        windows : (n,) array of int
            Their numbers; none is the first of a piece.

        Returns
        -------
        RunWindows
            The same windows, of more pieces.
        """
        if not len(windows):
            return self
        cut = self.cut.copy()
        cut[self.segments.steps[windows, 0] - 1] = True
        return replace(self, cut=cut)


def windows_of(runs: Trajectories, length: int) -> RunWindows:
    """Make every run one piece.

    Parameters
    ----------
    runs : Trajectories
        As `following_rows` gives them.
    length : int
        The most control steps in a window.

    Returns
    -------
    RunWindows
    """
    return RunWindows(runs, runs.terminals, length)
