"""Windows simulated and linearized in starts and parameters, and condensed to one start a piece."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator, describe_failures
from dropo.core.numerics.finite_differences import axial_design, difference_quotients
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.likelihoods.support.runs.windows import RunWindows

BLOCK = 1 << 24
"""Predicted numbers that one call of the simulator may give; no result depends on it."""


@dataclass(frozen=True, eq=False)
class Observed:
    """What of the simulator's signals was measured, and which coordinates a start has.

    Attributes
    ----------
    simulator : Simulator
        It starts in all s coordinates of its state; its signals are its start coordinates.
    measured : (p,) array of bool
        The m signals that were measured.
    state : (p,) array of bool
        The s start coordinates that move the state.
    """

    simulator: Simulator
    measured: NDArray[np.bool_]
    state: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Steps:
    """How far windows are moved, and how long they stay linked.

    Attributes
    ----------
    starts : (s,) array
        Half widths of the differences in start coordinates.
    values : (d,) array
        The same in parameters.
    unit : (s,) array
        Of each start coordinate, in which growth is measured.
    growth : float
        A run is cut where an error of its start has grown by this factor.
    """

    starts: Array
    values: Array
    unit: Array
    growth: float


@dataclass(frozen=True, eq=False)
class LinearizedInstants:
    """Residuals of all instants as linear functions of one start a piece and of the parameters.

    An instant is a measurement: the first of each run, and that at the end of every transition.

    Attributes
    ----------
    piece : (T,) array of int
        The piece of each instant.
    row : (T,) array of int
        The transition that ends at each instant; of a run's first instant, the one that begins.
    first : (T,) array of bool
        Whether it is the first measurement of a run.
    valid : (T, m) array of bool
        What is compared: at the first measurement of a run the state alone.
    matrix : (T, m, s + d + 1) array
        Derivatives of the predictions in start and parameters, and the residuals, in the signals'
        units; 0 where nothing is compared.
    of_start : (N, s, s) array
        d window's start / d start of its piece.
    of_value : (N, s, d) array
        d window's start / d parameter.
    gap : (N, s) array
        Where the linearized motion before a window reaches its start, less that start.
    window : (T,) array of int
        The window of each instant.
    of_window : (T, m, s) array
        Derivatives of the predictions in the start of their own window.
    """

    piece: NDArray[np.int64]
    row: NDArray[np.int64]
    first: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    matrix: Array
    of_start: Array
    of_value: Array
    gap: Array
    window: NDArray[np.int64]
    of_window: Array

    def unlinked(self) -> "LinearizedInstants":
        """Make the same residuals as functions of one start a window, the parameters known.

        Returns
        -------
        LinearizedInstants
        """
        matrix = np.concatenate([self.of_window, self.matrix[:, :, -1:]], axis=2)
        return replace(self, piece=self.window, matrix=matrix)

    @property
    def states(self) -> int:
        """The number s of start coordinates."""
        return self.gap.shape[1]

    @property
    def residuals(self) -> Array:
        """(T, m) the residuals with all gaps closed."""
        return np.asarray(self.matrix[:, :, -1])


def linearize_windows(
    observed: Observed, windows: RunWindows, value: Array, starts: Array, steps: Steps
) -> tuple[LinearizedInstants, RunWindows]:
    """Simulate every window from its start, differentiate, and close the gaps between windows.

    Parameters
    ----------
    observed : Observed
    windows : RunWindows
        N of them.
    value : (d,) or (G, d) array
        Parameters, one vector or one for each group.
    starts : (N, s) array
        Offsets of the starts from the measured states.
    steps : Steps

    Returns
    -------
    columns : LinearizedInstants
    windows : RunWindows
        The same, with runs cut where errors of their start have grown too far.

    Raises
    ------
    SimulationFailed
        If a simulation diverges.
    """
    d = value.shape[-1]
    s = len(steps.starts)
    places = np.flatnonzero(observed.state)
    space = observed.simulator.space
    offsets = axial_design(steps.values, -steps.values)
    design = np.stack([space.feasible(centre + offsets) for centre in np.atleast_2d(value)], axis=1)
    moves = np.zeros((2 * s, len(observed.state)))
    moves[:, places] = axial_design(steps.starts, -steps.starts)[1:]
    values = np.concatenate([design, np.repeat(np.atleast_2d(value)[None], 2 * s, axis=0)])
    moves = np.concatenate([np.zeros((len(design), len(observed.state))), moves])
    if value.ndim == 1:
        values = values[:, 0]
    predicted, ends = _predict(observed, windows, values, starts, moves)

    # Differences of predictions (R, m, .) and of ends (N, s, .), with widths (G, d) of the design.
    widths = np.einsum("dgd->gd", design[1 : 1 + d] - design[1 + d :])
    group = windows.segments.group if value.ndim > 1 else np.zeros(len(starts), dtype=np.int64)
    window = windows.segments.rows[0]
    order = np.append(0, np.arange(2 * d + 1, 2 * (s + d) + 1))
    by_start = difference_quotients(predicted[order], 2 * steps.starts)
    end_by_start = difference_quotients(ends[order], 2 * steps.starts)
    by_value = difference_quotients(predicted[: 2 * d + 1], np.ones(d))
    by_value /= widths[group[window]][:, None]
    end_by_value = difference_quotients(ends[: 2 * d + 1], np.ones(d)) / widths[group][:, None]

    # Each window's start as a function of its piece's start and the parameters.
    count = len(starts)
    of_start = np.tile(np.eye(s), (count, 1, 1))
    of_value = np.zeros((count, s, d))
    gap = np.zeros((count, s))
    cuts = []
    for depth in range(1, int(windows.depth.max()) + 1):
        now = np.flatnonzero(windows.depth == depth)
        linked = end_by_start[now - 1] @ of_start[now - 1]
        growth = np.abs(linked) * steps.unit / steps.unit[:, None]
        short = np.all(growth < steps.growth, axis=(1, 2))  # of numbers that are not finite too
        cuts.append(now[~short])
        now = now[short]
        before = now - 1
        of_start[now] = linked[short]
        of_value[now] = end_by_start[before] @ of_value[before] + end_by_value[before]
        carried = (end_by_start[before] @ gap[before][:, :, None])[:, :, 0]
        gap[now] = carried + ends[0][before] - starts[now]
    windows = windows.cut_before(np.concatenate(cuts)) if cuts else windows

    targets = observed.simulator.targets(windows.segments)[:, observed.measured]
    shift = (by_start @ gap[window][:, :, None])[:, :, 0]
    matrix = np.concatenate(
        [
            by_start @ of_start[window],
            by_value + by_start @ of_value[window],
            (targets - predicted[0] - shift)[:, :, None],
        ],
        axis=2,
    )
    links = (of_start, of_value, gap)
    return _with_first_instants(observed, windows, starts, matrix, by_start, links), windows


def _predict(
    observed: Observed, windows: RunWindows, values: Array, starts: Array, moves: Array
) -> tuple[Array, Array]:
    """Predictions (K, R, m) and ends (K, N, s), from moved starts, in calls that fit in memory."""
    segments = windows.segments
    base = np.zeros((len(starts), len(observed.state)))
    base[:, observed.state] = starts
    rows = len(segments.rows[0])
    each = max(1, BLOCK // (rows * len(observed.measured)))
    predicted = []
    ends = []
    for first in range(0, len(values), each):
        part = slice(first, first + each)
        found, end = observed.simulator.predict_with_ends(
            values[part], segments, offsets=base + moves[part, None]
        )
        if not np.isfinite(found).all():
            space = observed.simulator.space
            shown = values[part] if values.ndim == 2 else values[part, 0]
            raise SimulationFailed(describe_failures(found, shown, space))
        predicted.append(found[:, :, observed.measured])
        ends.append(end[:, :, observed.state])
    return np.concatenate(predicted), np.concatenate(ends)


def _with_first_instants(
    observed: Observed,
    windows: RunWindows,
    starts: Array,
    matrix: Array,
    by_start: Array,
    links: tuple[Array, Array, Array],
) -> LinearizedInstants:
    """The columns with each run's first measurement before the others of its piece."""
    segment, step = windows.segments.rows
    row = windows.segments.steps[segment, step]
    s = starts.shape[1]

    # A start is measured directly: residual = measured - (measured + offset).
    opening = np.flatnonzero(windows.opens_run)
    window = np.flatnonzero(windows.depth == 0)[opening]
    coordinate = np.cumsum(observed.state) - 1
    measured = np.flatnonzero(observed.measured)
    direct = observed.state[measured]
    own = coordinate[measured[direct]]
    at_start = np.zeros((len(opening), *matrix.shape[1:]))
    at_start[:, np.flatnonzero(direct), own] = 1.0
    at_start[:, np.flatnonzero(direct), -1] = -starts[window][:, own]
    valid = np.ones((len(matrix), len(measured)), dtype=bool)

    every_row = np.concatenate([windows.segments.steps[window, 0], row])
    is_first = np.concatenate([np.ones(len(opening), bool), np.zeros(len(row), bool)])
    order = np.lexsort((~is_first, every_row))
    of_start, of_value, gap = links
    return LinearizedInstants(
        piece=np.concatenate([opening, windows.piece[segment]])[order],
        row=every_row[order],
        first=is_first[order],
        valid=np.concatenate([np.tile(direct, (len(opening), 1)), valid])[order],
        matrix=np.concatenate([at_start, matrix])[order],
        of_start=of_start,
        of_value=of_value,
        gap=gap,
        window=np.concatenate([window, segment])[order],
        of_window=np.concatenate([at_start[:, :, :s], by_start])[order],
    )
