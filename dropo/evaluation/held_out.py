"""How far predictions are off on data held out: one choice of windows, one definition of the error.

Every error by horizon that is printed, saved or drawn comes from here, so that figures of one run
agree: for the same data, horizon and parameters, the same windows and the same number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.fits.fit_parts import HeldOutErrors
from dropo.core.records.trajectories import Ints, Segments, Signal, Trajectories
from dropo.core.services.validation import Array, require

ROTATIONS = (".rx", ".ry", ".rz")
"""Ends of the names of a quaternion's signals, compared in the chart at the measurement."""
MANY = 4
"""Windows of a trajectory from which on one of them may be lost."""


@dataclass(frozen=True)
class HeldOutSettings:
    """Which windows errors are taken from.

    Attributes
    ----------
    horizons : tuple of int
        Control steps after which a diagnosis gives errors.
    maximum : int
        So many windows of one horizon are taken at most.
    maximum_steps : int
        The windows of one horizon have so many control steps in all at most, unless they were then
        fewer than `minimum`.
    minimum : int
        So many windows of one horizon are taken at least, as far as the data have them.
    overlap : float
        No row is in more windows of one horizon than so many on average, unless they were then
        fewer than `minimum`: windows that hardly differ say the same.
    fewest : int
        With fewer windows of a horizon a diagnosis gives no errors of it.
    blocks : int
        Few trajectories are cut into so many blocks of time, of which every other one is held out.
    few_trajectories : int
        With fewer trajectories blocks of time are held out in the place of whole trajectories.
    minimum_variance : float
        Fraction of a signal's variance that counts as motion however large its noise is.
    """

    horizons: tuple[int, ...] = (1, 5, 20, 100, 400)
    maximum: int = 480
    maximum_steps: int = 4800
    minimum: int = 40
    overlap: float = np.inf
    fewest: int = 8
    blocks: int = 24
    few_trajectories: int = 4
    minimum_variance: float = 1e-3

    def count(self, horizon: int, rows: int) -> int:
        """Return how many windows of a horizon are taken, where there are so many.

        Parameters
        ----------
        horizon : int
            Control steps in a window.
        rows : int
            Rows of the data that the windows are of.

        Returns
        -------
        int
            As many as `maximum_steps` and `overlap` allow, from `minimum` to `maximum`.
        """
        apart = self.overlap * rows / horizon
        return max(self.minimum, int(min(self.maximum, self.maximum_steps // horizon, apart)))


SETTINGS = HeldOutSettings()
OF_DIAGNOSIS = HeldOutSettings(overlap=2.0)
"""Those of a diagnosis, which compares many models."""


@dataclass(frozen=True, eq=False)
class DataPart:
    """A part of measured data, in blocks that no window crosses.

    Attributes
    ----------
    trajectories : Trajectories
        The data that it is a part of, N rows.
    block : (N,) array
        The trajectory or block of time of each row.
    chosen : (N,) array
        Whether a row is in this part.
    """

    trajectories: Trajectories
    block: Ints
    chosen: NDArray[np.bool_]


def held_out_part(
    problem: Problem, horizon: int, held_out: bool = True, settings: HeldOutSettings = SETTINGS
) -> DataPart:
    """Return the part of a problem's data that evaluates a fit, or the part that is fitted.

    Parameters
    ----------
    problem : Problem
        Held out are its own held-out data where it has such, else every other trajectory, else
        every other block of time of the few trajectories that there are.
    horizon : int
        Control steps in a window of the fit: each block of time holds one at least.
    held_out : bool
        False: the other part.
    settings : HeldOutSettings
        How many blocks there are.

    Returns
    -------
    DataPart
        All rows of one side.
    """
    if problem.held_out is not None:
        return whole_part(problem.held_out if held_out else problem.trajectories)
    data = problem.trajectories
    block = _blocks(data, horizon, settings)
    return DataPart(data, block, block % 2 == held_out)


def whole_part(data: Trajectories) -> DataPart:
    """Return all of the data, in blocks that are trajectories.

    Parameters
    ----------
    data : Trajectories
        N rows.

    Returns
    -------
    DataPart
        With every row chosen.
    """
    return DataPart(data, data.trajectory, np.ones(len(data), dtype=bool))


def _blocks(data: Trajectories, horizon: int, settings: HeldOutSettings) -> Ints:
    """(N,) trajectories, or blocks of time within them where they are few."""
    count = len(data.spans)
    if count >= settings.few_trajectories:
        return data.trajectory
    block = np.empty(len(data), dtype=np.int64)
    first = 0
    for start, stop in data.spans:
        length = stop - start
        pieces = max(1, min(settings.blocks // count, length // (horizon + 1)))
        block[start:stop] = first + np.arange(length) * pieces // length
        first += pieces
    return block


def window_starts(part: DataPart, horizon: int, stride: int = 1, skipped: int = 0) -> Ints:
    """Return the rows at which windows of a part may begin.

    Parameters
    ----------
    part : DataPart
        The data.
    horizon : int
        Control steps in a window; none crosses the end of a trajectory or a block.
    stride : int
        Control steps from the beginning of one window to that of the next in the same block.
    skipped : int
        Control steps at the beginning of each trajectory at which none begins; fewer where that
        would cost one of its few windows.

    Returns
    -------
    numpy.ndarray
        (W,) rows, ascending; there may be none.

    Raises
    ------
    BadArgument
        If the horizon is below 1.
    """
    require(horizon >= 1, "length", "at least 1 step", horizon, "windows")
    data = part.trajectories
    edges = np.flatnonzero(np.diff(part.block) != 0) + 1
    stops = [stop for _, stop in data.spans]
    ends = sorted({0, len(data), *edges.tolist(), *stops})
    first = {start for start, _ in data.spans}
    starts = []
    for a, b in pairwise(ends):
        if not part.chosen[a]:
            continue
        last = b - horizon
        offset = 0
        if skipped and a in first:
            windows, spare = divmod(last - a, stride)
            offset = skipped if windows + 1 >= MANY else min(skipped, spare)
        starts.append(np.arange(a + offset, last + 1, stride))
    return np.concatenate([np.zeros(0, dtype=np.int64), *starts]).astype(np.int64)


def thin(starts: Ints, count: int) -> Ints:
    """Return some of the rows, evenly spread.

    Parameters
    ----------
    starts : (W,) array of int
        The rows.
    count : int
        At most so many are left.

    Returns
    -------
    array of int
        The first and the last row are among them if any is left out.
    """
    if len(starts) <= count:
        return starts
    return starts[np.linspace(0, len(starts) - 1, count).round().astype(np.int64)]


def held_out_starts(part: DataPart, horizon: int, settings: HeldOutSettings = SETTINGS) -> Ints:
    """Return the first rows of the windows of `held_out_windows`.

    Parameters
    ----------
    part, horizon, settings
        As of `held_out_windows`.

    Returns
    -------
    (W,) int array
    """
    count = settings.count(horizon, int(part.chosen.sum()))
    return thin(window_starts(part, horizon), count)


def held_out_windows(
    part: DataPart, horizon: int, settings: HeldOutSettings = SETTINGS
) -> Segments:
    """Return the windows that errors after a horizon are taken from.

    They begin at measurements evenly spread over the part, and may overlap; of each the last step
    is compared.

    Parameters
    ----------
    part : DataPart
        The data.
    horizon : int
        Control steps in a window.
    settings : HeldOutSettings
        How many windows there are.

    Returns
    -------
    Segments
        W windows with one row each; none where no block is so long.
    """
    starts = held_out_starts(part, horizon, settings)
    return part.trajectories.from_rows(starts, horizon)


def horizon_segments(
    problem: Problem, part: DataPart, horizon: int, settings: HeldOutSettings = SETTINGS
) -> Segments:
    """Return the segments that errors of a fit after a horizon are taken from.

    Parameters
    ----------
    problem : Problem
        Where its `reset` is "transition", the segments are those of `held_out_windows`. Where it
        is "partial", they are chained as the fit's. Where it is "start", each trajectory's first
        steps, since no other state is measured.
    part : DataPart
        Whole trajectories.
    horizon : int
        Control steps in a segment.
    settings : HeldOutSettings
        How many windows there are.

    Returns
    -------
    Segments
        With the last step compared; none where no trajectory is so long.
    """
    data = part.trajectories
    lengths = np.array([stop - start for start, stop in data.spans])
    if problem.reset == "transition":
        return held_out_windows(part, horizon, settings)
    if problem.reset == "partial" and horizon <= lengths.min():
        return data.segments(horizon, reset="partial", set_columns=problem.set_columns)
    first = np.array([start for start, _ in data.spans], dtype=np.int64)
    return data.from_rows(first[lengths >= horizon], horizon)


@dataclass(frozen=True, eq=False)
class HorizonErrors:
    """Errors of one model after a horizon; rows whose simulation failed are left out.

    Attributes
    ----------
    signals : tuple of Signal
        The p compared signals.
    horizon : int
        Control steps.
    squares : (p,) array
        Mean square of each signal's error, in its unit squared; NaN where all rows failed.
    spread : (p,) array
        What errors of all signals together are counted in (see `noise_free_spread`).
    rows : int
        How many rows were compared.
    failed : int
        How many of them failed.
    """

    signals: tuple[Signal, ...]
    horizon: int
    squares: Array
    spread: Array
    rows: int
    failed: int

    @property
    def by_signal(self) -> Array:
        """(p,) root mean square error of each signal, in its unit."""
        return np.sqrt(self.squares)

    @property
    def by_unit(self) -> dict[str, float]:
        """Root mean square over the signals of each unit."""
        return rms_by_unit(self.signals, self.squares)

    @property
    def overall(self) -> float:
        """Root mean square over all signals, each in units of its spread."""
        return rms_of_motion(self.squares, self.spread)


def errors_of(
    simulator: Simulator, predictions: Array, segments: Segments, spread: Array
) -> list[HorizonErrors]:
    """Return the errors of several models on the same segments.

    Parameters
    ----------
    simulator : Simulator
        Whose signals are compared.
    predictions : (K, R, p) array
        Of K models, NaN where a simulation failed.
    segments : Segments
        With R compared rows.
    spread : (p,) array
        Of `noise_free_spread`.

    Returns
    -------
    list of HorizonErrors
        One of each model.
    """
    targets = simulator.targets(segments)
    signals = tuple(simulator.signals)
    horizon = int(segments.lengths.max())
    found = []
    for predicted in predictions:
        errors = targets - predicted
        good = np.isfinite(errors).all(axis=1)
        nothing = np.full(len(signals), np.nan)
        squares = np.mean(errors[good] ** 2, axis=0) if good.any() else nothing
        failed = int((~good).sum())
        found.append(HorizonErrors(signals, horizon, squares, spread, len(errors), failed))
    return found


def rms_by_unit(signals: Sequence[Signal], squares: Array) -> dict[str, float]:
    """Return root mean squares over the signals of each unit.

    Parameters
    ----------
    signals : sequence of Signal
        The p signals.
    squares : (p,) array
        Mean squared error of each, in squared units.

    Returns
    -------
    dict of str to float
        By unit, in that unit; "-" is for signals without one.
    """
    units = [signal.unit or "-" for signal in signals]
    found = {}
    for unit in dict.fromkeys(units):
        same = np.array([other == unit for other in units])
        found[unit] = float(np.sqrt(np.mean(squares[same])))
    return found


def rms_of_motion(squares: Array, spread: Array) -> float:
    """Return the root mean square in units of each signal's motion.

    Parameters
    ----------
    squares : (p,) array
        Mean squared error of each signal, in squared units.
    spread : (p,) array
        How much each signal varies, in its unit; those of spread 0 do not count.

    Returns
    -------
    float
        A pure number; NaN where no signal varies.
    """
    varies = spread > 0
    if not varies.any():
        return float("nan")
    return float(np.sqrt(np.mean(squares[varies] / spread[varies] ** 2)))


def signal_spread(simulator: Simulator, targets: Array) -> Array:
    """Return the standard deviation of measured signals, noise and all.

    Parameters
    ----------
    simulator : Simulator
        Whose signals they are.
    targets : (R, p) array
        Measurements.

    Returns
    -------
    numpy.ndarray
        (p,) in each signal's unit; 1 rad for rotations, which are compared in the chart at the
        measurement; 0 for signals that do not vary.
    """
    spread = np.where(np.ptp(targets, axis=0) > 0, targets.std(axis=0), 0.0)
    rotation = np.array([signal.name.endswith(ROTATIONS) for signal in simulator.signals])
    return np.where(rotation, 1.0, spread)


def noise_free_spread(
    simulator: Simulator, part: DataPart, noise: Array, settings: HeldOutSettings = SETTINGS
) -> Array:
    """Return the spread of each signal in a part of the data, without its noise.

    Parameters
    ----------
    simulator : Simulator
        Whose signals they are.
    part : DataPart
        All of its rows count.
    noise : (p,) array
        Variance of each signal's noise; 0 where nothing is known of it.
    settings : HeldOutSettings
        What share of the variance is left at least.

    Returns
    -------
    numpy.ndarray
        (p,) in each signal's unit; 0 for signals that do not vary.
    """
    rows = part.trajectories.from_rows(np.flatnonzero(part.chosen))
    variance = signal_spread(simulator, simulator.targets(rows)) ** 2
    return np.sqrt(np.maximum(variance - noise, settings.minimum_variance * variance))


def stated_noise(problem: Problem) -> Array:
    """Return the noise variances that a problem states.

    Parameters
    ----------
    problem : Problem
        Its `epsilon` may be a number, one a signal, or None.

    Returns
    -------
    (p,) array
        In squared signal units; 0 where none is stated.
    """
    stated = 0.0 if problem.epsilon is None else np.asarray(problem.epsilon, dtype=float)
    return np.broadcast_to(stated, (len(problem.simulator.signals),))


def compared_segments(problem: Problem, part: DataPart) -> Segments:
    """Return the segments that errors at a fit's own horizon are taken from.

    The horizon is the problem's lambda. Where `reset` is "start", which has none, all steps of the
    whole trajectories are compared.

    Parameters
    ----------
    problem : Problem
        That is fitted.
    part : DataPart
        Whole trajectories.

    Returns
    -------
    Segments
        One at least.

    Raises
    ------
    BadArgument
        If lambda is longer than every trajectory.
    """
    if problem.reset != "start":
        segments = horizon_segments(problem, part, problem.horizon)
        if len(segments):
            return segments
    return problem.cut(part.trajectories)  # all of "start"; else refuses such a lambda


def held_out_errors(problem: Problem, run: Run, mean: Array) -> HeldOutErrors | None:
    """Return the errors of a fit on its held-out trajectories.

    Parameters
    ----------
    problem : Problem
        With `held_out` data, or without.
    run : Run
        Counts the simulations.
    mean : (d,) array
        The fitted mean.

    Returns
    -------
    HeldOutErrors or None
        By unit, at the fitted mean and with the parameters as they stand in the model, if it has
        such; NaN where a simulation diverged. None where nothing is held out.
    """
    if problem.held_out is None:
        return None
    part = whole_part(problem.held_out)
    segments = compared_segments(problem, part)
    nominal = problem.simulator.nominal
    values = np.stack([mean] if nominal is None else [mean, nominal])
    with run.counting(evaluations=1):
        predictions = problem.simulator.predict(values, segments)
    spread = noise_free_spread(problem.simulator, part, stated_noise(problem))
    errors = errors_of(problem.simulator, predictions, segments, spread)
    return HeldOutErrors(
        rows=errors[0].rows,
        steps=errors[0].horizon,
        rmse=_or_nan(errors[0]),
        rmse_nominal=None if nominal is None else _or_nan(errors[1]),
    )


def _or_nan(errors: HorizonErrors) -> dict[str, float]:
    """The errors by unit; NaN where some simulation diverged."""
    return {unit: np.nan if errors.failed else value for unit, value in errors.by_unit.items()}
