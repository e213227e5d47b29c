"""Measured motion: trajectories of transitions, and the segments that a simulator replays."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, check_shape, float_array, known, require

Ints = NDArray[np.int64]
Reset = Literal["transition", "start", "partial"]


@dataclass(frozen=True)
class Signal:
    """One compared number: the column's name, and its unit for tables (left out: none)."""

    name: str
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Transitions (o_t, a_t, o_{t+1}) of one or more trajectories, in order; read-only float64.

    observations, next_observations: (N, p); actions: (N, q), q may be 0; terminals: (N,), True on
    each trajectory's last row; group: (N,) integers, rows of one group share one draw of the
    parameters (None: nothing is known);
    time: (N,) [s] or None.
    """

    observations: Array
    actions: Array
    next_observations: Array
    terminals: NDArray[np.bool_]
    group: Ints | None = None
    time: Array | None = None

    def __post_init__(self) -> None:
        observations = float_array("observations", self.observations, (None, None), "Trajectories")
        n, p = observations.shape
        require(n > 0, "observations", "at least one row", n, "Trajectories")
        actions = float_array("actions", self.actions, (n, None), "Trajectories")
        following = float_array("next_observations", self.next_observations, (n, p), "Trajectories")
        terminals = np.array(self.terminals, dtype=bool)
        check_shape("terminals", terminals, (n,), "Trajectories")
        require(
            bool(terminals.any()),
            "terminals",
            "True on each trajectory's last row",
            "no True at all",
            "Trajectories",
        )
        require(bool(terminals[-1]), "terminals", "True on the last row", "False", "Trajectories")
        for name, value in (
            ("observations", observations),
            ("actions", actions),
            ("next_observations", following),
        ):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "terminals", terminals)
        if self.group is not None:
            group = np.array(self.group)
            check_shape("group", group, (n,), "Trajectories")
            object.__setattr__(
                self, "group", np.unique(group, return_inverse=True)[1].astype(np.int64)
            )
        if self.time is not None:
            object.__setattr__(self, "time", float_array("time", self.time, (n,), "Trajectories"))

    def __reduce__(self) -> tuple[object, ...]:
        """Copies in other processes are read-only too."""
        return Trajectories, (
            self.observations,
            self.actions,
            self.next_observations,
            self.terminals,
            self.group,
            self.time,
        )

    def __len__(self) -> int:
        return len(self.observations)

    @cached_property
    def trajectory(self) -> Ints:
        """(N,) the trajectory that each row belongs to: 0, 1, ..."""
        return np.concatenate([[0], np.cumsum(self.terminals)[:-1]]).astype(np.int64)

    @cached_property
    def spans(self) -> list[tuple[int, int]]:
        """[start, stop) of each trajectory's rows."""
        stops = np.flatnonzero(self.terminals) + 1
        return list(zip([0, *stops[:-1].tolist()], stops.tolist(), strict=True))

    def head(self, transitions: int) -> "Trajectories":
        """The first so many transitions; the last one ends its trajectory."""
        require(transitions >= 1, "transitions", "at least 1", transitions, "Trajectories.first")
        return self.rows(np.arange(min(transitions, len(self))))

    def select(self, trajectories: ArrayLike) -> "Trajectories":
        """The named trajectories, in the order of the data."""
        return self.rows(np.flatnonzero(np.isin(self.trajectory, np.asarray(trajectories))))

    def rows(self, rows: Ints) -> "Trajectories":
        """Some rows, in order; a trajectory ends where the next row is missing or belongs to
        another one.
        """
        require(len(rows) > 0, "rows", "at least one", len(rows), "Trajectories")
        end = self.terminals[rows].copy()
        end[:-1] |= np.diff(rows) != 1
        end[-1] = True
        group = None if self.group is None else self.group[rows]
        time = None if self.time is None else self.time[rows]
        return Trajectories(
            self.observations[rows],
            self.actions[rows],
            self.next_observations[rows],
            end,
            group,
            time,
        )

    def segments(
        self,
        length: int = 1,
        *,
        reset: Reset = "transition",
        set_columns: ArrayLike | None = None,
        every_step: bool = False,
    ) -> "Segments":
        """Segments of `length` steps (the thesis' lambda), not overlapping, never across a
        trajectory's end.

        reset: "transition", every segment starts from its own measured observation; "start", one
        segment a trajectory, every step compared; "partial", only the columns in `set_columns` (p,)
        bool are set to the measurement at a segment's start, the others go on from where the last
        segment's simulation ended (all are set at a trajectory's first row). every_step: compare
        every step and not only the last.
        """
        known("reset mode", reset, ("transition", "start", "partial"))
        require(length >= 1, "lambda", "at least 1", length, "Trajectories.segments")
        p = self.observations.shape[1]
        columns = (
            np.ones(p, dtype=bool) if set_columns is None else np.array(set_columns, dtype=bool)
        )
        check_shape("set_columns", columns, (p,), "Trajectories.segments")
        if reset == "start":
            return Segments(self, *_whole(self.spans), set_columns=columns, every_step=True)
        short = [
            (i, stop - start) for i, (start, stop) in enumerate(self.spans) if stop - start < length
        ]
        if len(short) == len(self.spans) or (short and reset == "partial"):
            raise BadArgument(
                f"lambda = {length} is longer than trajectory {short[0][0]}, which has "
                f"{short[0][1]} transitions."
                " Choose a smaller lambda, or leave that trajectory out."
            )
        steps, previous = _windows(self.spans, length, chained=reset == "partial")
        return Segments(self, steps, previous, set_columns=columns, every_step=every_step)

    def from_rows(self, first: Ints, length: int = 1, *, every_step: bool = False) -> "Segments":
        """Segments of `length` steps that begin at the rows `first` (N,), each from its
        measurement; they may overlap. `every_step`: as of `segments`.
        """
        alone = np.full(len(first), -1, dtype=np.int64)
        columns = np.ones(self.observations.shape[1], dtype=bool)
        return Segments(
            self, first[:, None] + np.arange(length), alone, columns, every_step=every_step
        )


def _whole(spans: list[tuple[int, int]]) -> tuple[Ints, Ints]:
    longest = max(stop - start for start, stop in spans)
    steps = np.full((len(spans), longest), -1, dtype=np.int64)
    for i, (start, stop) in enumerate(spans):
        steps[i, : stop - start] = np.arange(start, stop)
    return steps, np.full(len(spans), -1, dtype=np.int64)


def _windows(spans: list[tuple[int, int]], length: int, *, chained: bool) -> tuple[Ints, Ints]:
    starts: list[Ints] = []
    previous: list[Ints] = []
    for start, stop in spans:
        own = np.arange(start, stop - length + 1, length)
        first = sum(len(own) for own in starts)
        starts.append(own)
        previous.append(np.arange(first, first + len(own)) - 1)
        previous[-1][:1] = -1
    begin = np.concatenate(starts).astype(np.int64)
    follow = (
        np.concatenate(previous).astype(np.int64)
        if chained
        else np.full(len(begin), -1, dtype=np.int64)
    )
    return begin[:, None] + np.arange(length), follow


@dataclass(frozen=True, eq=False)
class Segments:
    """N pieces of trajectories to replay, of up to L steps, and the R compared (segment, step)
    pairs, the rows.

    steps: (N, L) the transition replayed at each step, -1 behind the end of a shorter segment;
    previous: (N,) the segment whose simulated end the unset columns start from, or -1; set_columns:
    (p,) bool. Rows are ordered by segment, then step; without `every_step` there is one a segment
    and R = N.
    """

    trajectories: Trajectories
    steps: Ints
    previous: Ints
    set_columns: NDArray[np.bool_]
    every_step: bool = False

    def __len__(self) -> int:
        return len(self.steps)

    @cached_property
    def lengths(self) -> Ints:
        """(N,) steps of each segment."""
        return (self.steps >= 0).sum(axis=1)

    @cached_property
    def rows(self) -> tuple[Ints, Ints]:
        """(R,) segment and (R,) step (from 0) of every compared row."""
        if self.every_step:
            segment, step = np.nonzero(self.steps >= 0)
            return segment.astype(np.int64), step.astype(np.int64)
        return np.arange(len(self), dtype=np.int64), self.lengths - 1

    @cached_property
    def levels(self) -> list[Ints]:
        """The segments by how many come before them in their chain; one level without `partial`
        resets.
        """
        depth = np.zeros(len(self), dtype=np.int64)
        for i in np.flatnonzero(
            self.previous >= 0
        ):  # a segment comes behind the one it goes on from
            depth[i] = depth[self.previous[i]] + 1
        return [np.flatnonzero(depth == level) for level in range(int(depth.max()) + 1)]

    @property
    def starts(self) -> Array:
        """(N, p) the measured observation at each segment's start."""
        return self.trajectories.observations[self.steps[:, 0]]

    @property
    def actions(self) -> Array:
        """(N, L, q) the actions of each segment; behind the end of a shorter one, its last."""
        filled = np.where(self.steps >= 0, self.steps, self.steps.max(axis=1, keepdims=True))
        return self.trajectories.actions[filled]

    @property
    def targets(self) -> Array:
        """(R, p) the measured observation at every compared row."""
        segment, step = self.rows
        return self.trajectories.next_observations[self.steps[segment, step]]

    @property
    def group(self) -> Ints:
        """(N,) the group of each segment: the data's own, else its trajectory."""
        given = self.trajectories.group
        return (self.trajectories.trajectory if given is None else given)[self.steps[:, 0]]

    @property
    def trajectory(self) -> Ints:
        """(N,) the trajectory of each segment."""
        return self.trajectories.trajectory[self.steps[:, 0]]

    def comparing_every_step(self) -> "Segments":
        """The same segments with every step compared."""
        return self if self.every_step else replace(self, every_step=True)

    def thin(self, count: int) -> Ints:
        """Which segments to take for about `count` of them, evenly spread; all where they form
        chains, or are fewer.
        """
        stride = len(self) // count if len(self.levels) == 1 else 1
        return np.arange(0, len(self), max(1, stride), dtype=np.int64)

    def take(self, index: ArrayLike) -> "Segments":
        """Some of the segments, by an index of numbers or (N,) bool; of a chain (`partial` resets)
        only whole beginnings can be taken.
        """
        index = np.asarray(index)
        index = np.flatnonzero(index) if index.dtype == bool else index.astype(np.int64)
        place = np.full(len(self) + 1, -2, dtype=np.int64)
        place[index], place[-1] = np.arange(len(index)), -1
        previous = place[self.previous[index]]
        require(
            not (previous == -2).any(),
            "index",
            "closed under 'previous'",
            "a segment without the one before it",
            "Segments.take",
        )
        return replace(self, steps=self.steps[index], previous=previous)
