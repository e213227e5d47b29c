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
    """One compared number.

    Attributes
    ----------
    name : str
        The column's name.
    unit : str
        For tables; empty if it has none.
    """

    name: str
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Transitions (o_t, a_t, o_{t+1}) of one or more trajectories, in order.

    The arrays are read-only float64 copies.

    Attributes
    ----------
    observations : (N, p) array
        The observation before each transition, in the signals' units.
    actions : (N, q) array
        The action that is held during it; q may be 0.
    next_observations : (N, p) array
        The observation after it.
    terminals : (N,) array of bool
        True on each trajectory's last row.
    group : (N,) array of int, or None
        Rows of one group share one draw of the parameters; None where nothing is known of it.
    time : (N,) array or None
        Of each observation [s].

    Raises
    ------
    BadArgument
        If there are no rows, an array has another length or is not finite, or the last row ends no
        trajectory.
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
        rule = "True on each trajectory's last row"
        require(bool(terminals.any()), "terminals", rule, "no True at all", "Trajectories")
        require(bool(terminals[-1]), "terminals", "True on the last row", "False", "Trajectories")
        object.__setattr__(self, "observations", observations)
        object.__setattr__(self, "actions", actions)
        object.__setattr__(self, "next_observations", following)
        object.__setattr__(self, "terminals", terminals)
        if self.group is not None:
            group = np.array(self.group)
            check_shape("group", group, (n,), "Trajectories")
            consecutive = np.unique(group, return_inverse=True)[1].astype(np.int64)
            object.__setattr__(self, "group", consecutive)
        if self.time is not None:
            object.__setattr__(self, "time", float_array("time", self.time, (n,), "Trajectories"))

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild the arrays in other processes, so that they are read-only there too."""
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
        """Number (N,) of the trajectory that each row belongs to: 0, 1, ..."""
        return np.concatenate([[0], np.cumsum(self.terminals)[:-1]]).astype(np.int64)

    @cached_property
    def spans(self) -> list[tuple[int, int]]:
        """First row of each trajectory, and the row behind its last."""
        stops = np.flatnonzero(self.terminals) + 1
        return list(zip([0, *stops[:-1].tolist()], stops.tolist(), strict=True))

    def head(self, transitions: int) -> "Trajectories":
        """Take the first transitions; the last one ends its trajectory.

        Parameters
        ----------
        transitions : int
            How many, at least 1; all if there are fewer.

        Returns
        -------
        Trajectories

        Raises
        ------
        BadArgument
            If it is less than 1.
        """
        require(transitions >= 1, "transitions", "at least 1", transitions, "Trajectories.head")
        return self.rows(np.arange(min(transitions, len(self))))

    def select(self, trajectories: ArrayLike) -> "Trajectories":
        """Take some of the trajectories, in the order of the data.

        Parameters
        ----------
        trajectories : (n,) array_like of int
            Their numbers.

        Returns
        -------
        Trajectories

        Raises
        ------
        BadArgument
            If none of them exists.
        """
        return self.rows(np.flatnonzero(np.isin(self.trajectory, np.asarray(trajectories))))

    def rows(self, rows: Ints) -> "Trajectories":
        """Take some rows; a trajectory ends where the row behind it is not taken.

        Parameters
        ----------
        rows : (n,) array of int
            Their numbers, in rising order.

        Returns
        -------
        Trajectories

        Raises
        ------
        BadArgument
            If there is none.
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
        horizon: int = 1,
        *,
        reset: Reset = "transition",
        set_columns: ArrayLike | None = None,
        every_step: bool = False,
    ) -> "Segments":
        """Cut the trajectories into segments that do not overlap.

        No segment crosses a trajectory's end; steps that are left over there are not used.

        Parameters
        ----------
        horizon : int
            The horizon of a segment in control steps, the thesis' lambda.
        reset : {"transition", "start", "partial"}
            Where segments start. "transition": each from its own measured observation. "start":
            one segment for each trajectory, with every step compared. "partial": only the columns
            in `set_columns` are set to the measurement at a segment's start, and the others go on
            from where the simulation of the segment before ended; at a trajectory's first row all
            are set.
        set_columns : (p,) array_like of bool, optional
            The columns that a partial reset sets; all by default.
        every_step : bool
            Whether every step is compared, and not the last alone.

        Returns
        -------
        Segments

        Raises
        ------
        UnknownName
            If `reset` is another word.
        BadArgument
            If the horizon is less than 1 or longer than all trajectories (with partial resets, than
            any trajectory), or `set_columns` has another shape.
        """
        known("reset mode", reset, ("transition", "start", "partial"))
        require(horizon >= 1, "lambda", "at least 1", horizon, "Trajectories.segments")
        p = self.observations.shape[1]
        columns = np.ones(p, dtype=bool)
        if set_columns is not None:
            columns = np.array(set_columns, dtype=bool)
        check_shape("set_columns", columns, (p,), "Trajectories.segments")
        if reset == "start":
            steps, previous = _whole_trajectories(self.spans)
            return Segments(self, steps, previous, set_columns=columns, every_step=True)
        sizes = [stop - start for start, stop in self.spans]
        short = [i for i, size in enumerate(sizes) if size < horizon]
        if len(short) == len(self.spans) or (short and reset == "partial"):
            first = short[0]
            raise BadArgument(
                f"lambda = {horizon} is longer than trajectory {first}, which has {sizes[first]} "
                "transitions. Choose a smaller lambda, or leave that trajectory out."
            )
        steps, previous = _windows(self.spans, horizon, chained=reset == "partial")
        return Segments(self, steps, previous, set_columns=columns, every_step=every_step)

    def from_rows(self, first: Ints, horizon: int = 1, *, every_step: bool = False) -> "Segments":
        """Cut segments that begin at given rows, each from its measurement; they may overlap.

        Parameters
        ----------
        first : (N,) array of int
            The rows at which segments begin.
        horizon : int
            The horizon of a segment [control steps].
        every_step : bool
            As of `segments`.

        Returns
        -------
        Segments
        """
        unchained = np.full(len(first), -1, dtype=np.int64)
        columns = np.ones(self.observations.shape[1], dtype=bool)
        steps = first[:, None] + np.arange(horizon)
        return Segments(self, steps, unchained, columns, every_step=every_step)


def _whole_trajectories(spans: list[tuple[int, int]]) -> tuple[Ints, Ints]:
    """Steps (N, L) and previous segments (N,) of one segment for each trajectory."""
    longest = max(stop - start for start, stop in spans)
    steps = np.full((len(spans), longest), -1, dtype=np.int64)
    for i, (start, stop) in enumerate(spans):
        steps[i, : stop - start] = np.arange(start, stop)
    return steps, np.full(len(spans), -1, dtype=np.int64)


def _windows(spans: list[tuple[int, int]], horizon: int, *, chained: bool) -> tuple[Ints, Ints]:
    """Steps (N, horizon) and previous segments (N,) of windows that follow each other."""
    starts: list[Ints] = []
    previous: list[Ints] = []
    count = 0
    for start, stop in spans:
        own = np.arange(start, stop - horizon + 1, horizon)
        starts.append(own)
        before = np.arange(count, count + len(own)) - 1
        before[:1] = -1
        previous.append(before)
        count += len(own)
    begin = np.concatenate(starts).astype(np.int64)
    follow = np.full(len(begin), -1, dtype=np.int64)
    if chained:
        follow = np.concatenate(previous).astype(np.int64)
    return begin[:, None] + np.arange(horizon), follow


@dataclass(frozen=True, eq=False)
class Segments:
    """N pieces of trajectories to replay, of up to L steps, and their R compared rows.

    A row is a segment and a step in it. Rows are ordered by segment, then step; without
    `every_step` each segment has one, its last step, so R = N.

    Attributes
    ----------
    trajectories : Trajectories
        The data.
    steps : (N, L) array of int
        The transition replayed at each step; -1 behind the end of a shorter segment.
    previous : (N,) array of int
        The segment from whose simulated end the columns that are not set start, or -1.
    set_columns : (p,) array of bool
        The columns that are set to the measurement at a segment's start.
    every_step : bool
        Whether every step is compared, and not the last alone.
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
        """Number of steps (N,) of each segment."""
        return (self.steps >= 0).sum(axis=1)

    @cached_property
    def rows(self) -> tuple[Ints, Ints]:
        """Segment (R,) and step (R,), from 0, of every compared row."""
        if self.every_step:
            segment, step = np.nonzero(self.steps >= 0)
            return segment.astype(np.int64), step.astype(np.int64)
        return np.arange(len(self), dtype=np.int64), self.lengths - 1

    @cached_property
    def levels(self) -> list[Ints]:
        """Segments by how many come before them in their chain; one level without partial resets.

        Each level is an array of segment numbers.
        """
        depth = np.zeros(len(self), dtype=np.int64)
        # A segment has a larger number than the one that it goes on from.
        for i in np.flatnonzero(self.previous >= 0):
            depth[i] = depth[self.previous[i]] + 1
        return [np.flatnonzero(depth == level) for level in range(int(depth.max()) + 1)]

    @cached_property
    def starts(self) -> Array:
        """Measured observation (N, p) at each segment's start."""
        return self.trajectories.observations[self.steps[:, 0]]

    @property
    def actions(self) -> Array:
        """Actions (N, L, q) of each segment; behind the end of a shorter one, its last."""
        filled = np.where(self.steps >= 0, self.steps, self.steps.max(axis=1, keepdims=True))
        return self.trajectories.actions[filled]

    @property
    def targets(self) -> Array:
        """Measured observation (R, p) at every compared row."""
        segment, step = self.rows
        return self.trajectories.next_observations[self.steps[segment, step]]

    @property
    def group(self) -> Ints:
        """Group (N,) of each segment: the data's own, else its trajectory."""
        given = self.trajectories.group
        return (self.trajectories.trajectory if given is None else given)[self.steps[:, 0]]

    @property
    def trajectory(self) -> Ints:
        """Trajectory (N,) of each segment."""
        return self.trajectories.trajectory[self.steps[:, 0]]

    def comparing_every_step(self) -> "Segments":
        """Make the same segments with every step compared.

        Returns
        -------
        Segments
            Of the same starts and actions.
        """
        return self if self.every_step else replace(self, every_step=True)

    def thin(self, count: int) -> Ints:
        """Choose about a given number of segments, evenly spread.

        Parameters
        ----------
        count : int
            How many.

        Returns
        -------
        (n,) array of int
            Their numbers; all where they form chains or are fewer.
        """
        stride = len(self) // count if len(self.levels) == 1 else 1
        return np.arange(0, len(self), max(1, stride), dtype=np.int64)

    def take(self, index: ArrayLike) -> "Segments":
        """Take some of the segments; of a chain (partial resets), only whole beginnings.

        Parameters
        ----------
        index : (n,) array_like of int, or (N,) array_like of bool
            Their numbers, or which of them.

        Returns
        -------
        Segments

        Raises
        ------
        BadArgument
            If a segment is taken without the one from whose end it starts.
        """
        index = np.asarray(index)
        index = np.flatnonzero(index) if index.dtype == bool else index.astype(np.int64)
        # The new number of each segment: -2 if it is not taken; the last entry stands for -1.
        new_number = np.full(len(self) + 1, -2, dtype=np.int64)
        new_number[index] = np.arange(len(index))
        new_number[-1] = -1
        previous = new_number[self.previous[index]]
        complete = not (previous == -2).any()
        got = "a segment without the one before it"
        require(complete, "index", "closed under 'previous'", got, "Segments.take")
        return replace(self, steps=self.steps[index], previous=previous)
