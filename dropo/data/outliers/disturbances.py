"""Spans of time that no command explains, such as a hand that pushes the arm: found, listed, and
left out.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.finite_differences import axial_design, difference_quotients
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints, Segments, Signal, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.data.outliers.robust_fit import robust_fit


@dataclass(frozen=True)
class DisturbanceSettings:
    """What stands out in the errors of a simulator.

    Attributes
    ----------
    seconds : tuple of float
        Horizons of the windows [s]: a short one for a short strong push, a long one for a long weak
        one.
    worst : float
        Number of robust standard deviations that a span's worst window must be off.
    edge : float
        Number of robust standard deviations that all of a span's windows must be off.
    neighbours : int
        Smallest number of windows of a span: a spike of a sensor spoils the one that begins there
        and the one that ends there.
    bins : int
        Largest number of bins of windows, by how far they move, within which errors are compared.
    fewest : int
        Smallest number of windows in a bin.
    near : float
        Longest pause within one disturbance [s].
    start_error : float
        Number of standard deviations of noise that the start of a window may be off by.
    rounds : int
        Gauss-Newton steps to the start that fits a window best, where it was not measured.
    around_contact : int
        Number of rows around a contact that are not evaluated.
    windows : int
        Largest number of windows that the robust fit uses.
    at_rest : float
        A window that goes less far is at rest, as a fraction of the signals' spread.
    rounding : float
        Errors below this fraction of a signal's spread are no push.
    calm : float
        Fraction of a run's moving windows, those with the smallest errors, that say what is usual
        in it.
    calm_normal : float
        The quantile `calm` of a Gaussian's |z|.
    too_much : float
        Fraction of the data beyond which the model, not the data, is wrong.
    many_runs : int
        Number of trajectories from which on disturbances must be rare.
    too_often : float
        Largest fraction of so many trajectories that may have disturbances: what comes back in more
        is the model's own.
    """

    seconds: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    worst: float = 6.0
    edge: float = 4.0
    neighbours: int = 2
    bins: int = 10
    fewest: int = 40
    near: float = 0.2
    start_error: float = 3.0
    rounds: int = 3
    around_contact: int = 2
    windows: int = 300
    at_rest: float = 0.02
    rounding: float = 1e-4
    calm: float = 0.25
    calm_normal: float = 0.3186
    too_much: float = 0.2
    many_runs: int = 8
    too_often: float = 1 / 3


SETTINGS = DisturbanceSettings()


@dataclass(frozen=True)
class Span:
    """A span of time in which a trajectory does not move as others do.

    Attributes
    ----------
    trajectory : int
        Which one.
    first, last : int
        Its transitions from `first` to `last` - 1.
    start, end : float
        Its beginning and end [s], from the trajectory's beginning.
    signal, unit : str
        The signal that is off most.
    size : float
        By how much it is off, in its unit ...
    seconds : float
        ... after this horizon [s].
    times : float
        The same in robust standard deviations of like windows.
    held_out : bool
        Whether the trajectory is one of those held out.
    """

    trajectory: int
    first: int
    last: int
    start: float
    end: float
    signal: str
    unit: str
    size: float
    seconds: float
    times: float
    held_out: bool = False

    def __str__(self) -> str:
        where = (
            f"{'held-out ' * self.held_out}trajectory {self.trajectory}, {self.start:.2f} to "
            f"{self.end:.2f} s"
        )
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{where}: {self.signal} is {self.size:.3g}{unit} off after {self.seconds:.3g} s, "
            f"{self.times:.0f} times the usual error"
        )

    def to_json(self) -> dict[str, Any]:
        """Give plain numbers.

        Returns
        -------
        dict
            The run, and from where to where in it [s].
        """
        return {
            "run": self.trajectory,
            "held_out": self.held_out,
            "from": self.start,
            "to": self.end,
            "seconds": self.end - self.start,
            "signal": self.signal,
            "unit": self.unit,
            "off": self.size,
            "after": self.seconds,
            "times": self.times,
        }


@dataclass(frozen=True, eq=False)
class Disturbances:
    """The spans in which trajectories do not move as they do elsewhere.

    Attributes
    ----------
    trajectories : Trajectories
        All data, N transitions.
    spans : tuple of Span
        By trajectory and time.
    too_much : float
        Fraction of the data beyond which the model, not the data, is wrong.
    """

    trajectories: Trajectories
    spans: tuple[Span, ...]
    too_much: float = SETTINGS.too_much

    @property
    def share(self) -> float:
        """The fraction of the transitions that lies in the spans."""
        return sum(span.last - span.first for span in self.spans) / len(self.trajectories)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(N,) the transitions that lie in the spans."""
        inside = np.zeros(len(self.trajectories), dtype=bool)
        for span in self.spans:
            begin = self.trajectories.spans[span.trajectory][0]
            inside[begin + span.first : begin + span.last] = True
        return inside

    def left_out(self) -> Trajectories:
        """Return the trajectories without the spans.

        Returns
        -------
        Trajectories
            A trajectory is cut in two at each span.
        """
        return self.trajectories.rows(np.flatnonzero(~self.inside))

    def __str__(self) -> str:
        if not self.spans:
            return "No span of time stands out."
        count = f"{len(self.spans)} spans"
        share = f"{100 * self.share:.2g} % of the data"
        title = f"{count} of time, {share}, in which something acts that no command explains:"
        if self.share > self.too_much:
            title = f"{count}, {share}, stand out: so much is rather a model that lacks something:"
        return "\n  ".join([title, *map(str, self.spans)])


def find_disturbances(
    simulator: Simulator,
    trajectories: Trajectories,
    values: Array,
    step: float,
    *,
    estimated: Collection[str] = (),
    seconds: Sequence[float] | None = None,
    settings: DisturbanceSettings = SETTINGS,
) -> Disturbances:
    """Find windows that a simulator predicts far worse than others of like motion, as spans.

    A push shows in velocities: where there are such signals (units per second), they alone are
    evaluated. A long window adds only what no short one has shown. Transitions near contacts are
    left aside.

    Velocities that were estimated are off where forces set in at once. They are not evaluated,
    other signals are, and a window is off by what it is off by from its best start.

    Parameters
    ----------
    simulator : Simulator
        Should explain most of the data, or its errors hide all but the strongest pushes: what it
        always gets wrong in like motion is its usual error there.
    trajectories : Trajectories
        The data.
    values : (d,) array
        The simulator's parameters, from a fit (see `robust_values`).
    step : float
        Of the control [s].
    estimated : collection of str
        Names of the signals that were not measured.
    seconds : sequence of float, optional
        Horizons of the windows, in place of the settings'.
    settings : DisturbanceSettings
        What stands out.

    Returns
    -------
    Disturbances
        The spans, by trajectory and time; there may be none.

    Raises
    ------
    BadArgument
        If the step is not above 0 or there are not d values.
    """
    value = float_array("values", values, (len(simulator.space),), "find_disturbances")
    require(step > 0, "step", "the seconds of a control step, above 0", step, "find_disturbances")
    if seconds is None:
        seconds = settings.seconds

    # The noise, from one-step errors; the signals in which pushes show; where contacts are.
    short = cut(trajectories, 1)
    noise = deviation(simulator.targets(short) - _predict(simulator, value, short)) / np.sqrt(2)
    signals = simulator.signals
    unknown = [i for i, signal in enumerate(signals) if signal.name in estimated]
    measured = [i for i in range(len(signals)) if i not in unknown]
    rates = [i for i in measured if signals[i].unit.endswith("/s")]
    if unknown or not rates:
        rates = measured
    simulation = _Simulation(simulator, value, noise, rates, unknown)
    free = _away_from_contacts(simulator, trajectories, settings.around_contact)

    found: list[Span] = []
    for length in sorted({max(1, round(horizon / step)) for horizon in seconds}):
        windows = cut(trajectories, length)
        windows = windows.take(free[windows.steps].all(axis=1))
        if len(windows) < settings.fewest:
            continue
        times, errors = simulation.relative_errors(windows, settings)
        for members, which in _neighbours(windows, times, settings):
            signal = signals[rates[which]]
            span = _span(windows, members, errors[:, which], times[:, which], signal, step)
            if not any(_overlap(span, other) for other in found):
                found.append(span)
    found.sort(key=lambda span: (span.trajectory, span.first))
    return Disturbances(trajectories, tuple(_joined(found, settings.near)), settings.too_much)


def robust_values(
    simulator: Simulator,
    trajectories: Trajectories,
    step: float,
    start: Array,
    *,
    seconds: float = 0.2,
    settings: DisturbanceSettings = SETTINGS,
) -> Array:
    """Estimate the parameters that explain most windows, by `robust_fit`.

    Parameters
    ----------
    simulator : Simulator
        Of d parameters.
    trajectories : Trajectories
        The data, disturbances among them.
    step : float
        Of the control [s].
    start : (d,) array
        Where the fit begins.
    seconds : float
        Horizon of the windows [s].
    settings : DisturbanceSettings
        How many windows are used.

    Returns
    -------
    (d,) array

    Raises
    ------
    BadArgument
        If there are not d numbers to start from.
    SimulationFailed
        If there is nothing to start from.
    """
    windows = cut(trajectories, max(1, round(seconds / step)))
    chosen = windows.take(windows.thin(settings.windows))
    return robust_fit(simulator, chosen, start).value


def cut(trajectories: Trajectories, length: int) -> Segments:
    """Cut trajectories into overlapping windows.

    Parameters
    ----------
    trajectories : Trajectories
        The data.
    length : int
        Control steps in a window.

    Returns
    -------
    Segments
        Each begins half a window after the one before; only their ends are compared.
    """
    stride = max(1, length // 2)
    starts = [np.arange(start, stop - length + 1, stride) for start, stop in trajectories.spans]
    return trajectories.from_rows(np.concatenate(starts).astype(np.int64), length)


def _predict(simulator: Simulator, value: Array, windows: Segments) -> Array:
    """(W, p) the predictions at the ends of windows."""
    return simulator.predict(value[None], windows)[0]


@dataclass(frozen=True, eq=False)
class _Simulation:
    """What windows are predicted by: the noise (p,) of the simulator's signals, the signals that
    are evaluated, and those whose start is not known.
    """

    simulator: Simulator
    value: Array
    noise: Array
    evaluated: list[int]
    unknown: list[int]

    def relative_errors(
        self, windows: Segments, settings: DisturbanceSettings
    ) -> tuple[Array, Array]:
        """(W, r) the errors of some signals in units of what is usual, and in their units."""
        which = self.evaluated
        predicted = _predict(self.simulator, self.value, windows)
        errors = (self.simulator.targets(windows) - predicted)[:, which]
        usual = _usual_errors(errors, _motion(windows, predicted), windows.trajectory, settings)
        usual = np.maximum(usual, settings.rounding * np.nanstd(predicted[:, which], axis=0))
        times = errors / usual
        # Of large errors, only what the start's noise cannot explain counts.
        large = np.flatnonzero((np.abs(times) > settings.edge).any(axis=1))
        if len(large):
            some = windows.take(large)
            if self.unknown:
                errors[large] = self._from_best_start(some, usual[large], settings.rounds)
            by_noise = self._errors_by_start(some, settings.start_error)[:, which]
            left = np.maximum(np.abs(errors[large]) - by_noise, 0.0)
            times[large] = np.sign(errors[large]) * left / usual[large]
        return times, errors

    def _from_best_start(self, windows: Segments, usual: Array, rounds: int) -> Array:
        """(W, r) the errors at the ends of windows whose unknown starts fit all of their steps, by
        so many Gauss-Newton steps.

        usual: (W, r) in units of which they are to fit.
        """
        rows = windows.steps[:, 0]
        steps = windows.trajectories.from_rows(rows, windows.steps.shape[1], every_step=True)
        targets = self._by_step(self.simulator.targets(steps), usual)
        start = np.zeros((len(self.unknown), len(windows)))
        left = targets[:, -1]
        for _ in range(rounds):
            predicted, slopes = self._around(steps, start, usual)
            errors = np.nan_to_num(targets - predicted)
            flat = slopes.reshape(len(windows), -1, len(start))
            change = np.linalg.pinv(flat) @ errors.reshape(len(windows), -1, 1)
            left = errors[:, -1] - (slopes[:, -1] @ change)[..., 0]
            start += change[..., 0].T
        return left * usual

    def _around(self, steps: Segments, start: Array, usual: Array) -> tuple[Array, Array]:
        """Predictions (W, L, r) from starts moved by (u, W), and their slopes (W, L, r, u)."""
        count = len(start)
        width = self.noise[self.unknown]
        # Row 0: the start; then each unknown signal larger by its width, then each smaller.
        offsets = np.zeros((1 + 2 * count, len(steps), len(self.noise)))
        offsets[:, :, self.unknown] = start.T + axial_design(width, -width)[:, None]
        values = np.repeat(self.value[None], len(offsets), axis=0)
        predicted = self._by_step(self.simulator.predict(values, steps, offsets=offsets), usual)
        flat = predicted.reshape(*predicted.shape[:2], -1)
        slopes = difference_quotients(flat, 2 * width).reshape(*predicted.shape[1:], count)
        return predicted[0], np.nan_to_num(slopes)

    def _by_step(self, values: Array, usual: Array) -> Array:
        """(..., W, L, r) the signals that are evaluated after each step of (..., W L p) values."""
        p = len(self.noise)
        by_step = values.reshape(*values.shape[:-2], len(usual), -1, p)
        return np.asarray(by_step[..., self.evaluated] / usual[:, None], dtype=float)

    def _errors_by_start(self, windows: Segments, times: float) -> Array:
        """(W, p) the change of predictions as each signal of the start is off by up to some times
        its noise.

        The changes of all signals are added. So a window that begins close to a stop or an impact,
        where little decides much, is not taken for pushed.
        """
        p = len(self.noise)
        if self.simulator.start_size != p:
            return np.zeros((len(windows), p))
        known = [i for i in range(p) if i not in self.unknown]
        fractions = np.array([-1.0, -0.5, 0.5, 1.0])
        count = len(fractions)
        # Row 0: the measured start; then for each signal the fractions of its width.
        offsets = np.zeros((1 + count * len(known), len(windows), p))
        for place, i in enumerate(known):
            rows = 1 + count * place + np.arange(count)
            offsets[rows, :, i] = (fractions * times * self.noise[i])[:, None]
        values = np.repeat(self.value[None], len(offsets), axis=0)
        predicted = self.simulator.predict(values, windows, offsets=offsets)
        change = np.nan_to_num(np.abs(predicted[1:] - predicted[0]), nan=np.inf)
        largest = change.reshape(len(known), count, len(windows), p).max(axis=1)
        return np.asarray(largest.sum(axis=0))


def _away_from_contacts(
    simulator: Simulator, trajectories: Trajectories, around: int
) -> NDArray[np.bool_]:
    """(N,) transitions that neither begin nor end near a contact.

    In a contact a push and a wrong contact are the same.
    """
    touching = np.array(simulator.in_contact(trajectories.segments(1)))
    for _ in range(around):
        either = touching[1:] | touching[:-1]
        touching[1:] |= either
        touching[:-1] |= either
    return ~touching


def _motion(windows: Segments, predicted: Array) -> Array:
    """(W,) how far a window goes by the prediction, in spreads of the signals."""
    way = predicted
    if predicted.shape == windows.starts.shape:
        way = predicted - windows.starts
    way = np.nan_to_num(way)
    scaled = way / np.maximum(way.std(axis=0), 1e-300)
    return np.asarray(np.sqrt(np.sum(scaled**2, axis=1)))


def _usual_errors(errors: Array, motion: Array, run: Ints, settings: DisturbanceSettings) -> Array:
    """(W, r) the robust standard deviation of the errors of windows that move about as far.

    It is no less than in half of all bins, and no less than that of the calmer windows of its run.
    Windows at rest do not count: where friction holds, there are no errors.
    """
    moving = np.flatnonzero(motion > settings.at_rest)
    if not len(moving):
        return np.full_like(errors, np.inf)
    # Bins of about as many windows, by how far they move.
    ordered = moving[np.argsort(motion[moving], kind="stable")]
    count = max(1, min(settings.bins, len(moving) // settings.fewest))
    bins = np.array_split(ordered, count)
    scales = np.array([deviation(errors[members]) for members in bins])
    scales = np.maximum(scales, np.median(scales, axis=0))
    edges = [motion[members[-1]] for members in bins[:-1]]
    usual = scales[np.searchsorted(edges, motion)]
    # The calmer windows of each run.
    for number in np.unique(run[moving]):
        own = np.abs(errors[moving[run[moving] == number]])
        calm = np.nanquantile(own, settings.calm, axis=0) / settings.calm_normal
        usual[run == number] = np.maximum(usual[run == number], calm)
    return usual


def _neighbours(
    windows: Segments, times: Array, settings: DisturbanceSettings
) -> list[tuple[Ints, int]]:
    """Neighbouring windows, and the signal that is off to the same side in all of them."""
    found = []
    for which in range(times.shape[1]):
        for side in (1.0, -1.0):
            off = side * times[:, which]
            above = np.flatnonzero(off > settings.edge)
            apart = np.diff(above) > 1
            other_run = np.diff(windows.trajectory[above]) != 0
            for members in np.split(above, np.flatnonzero(apart | other_run) + 1):
                if len(members) >= settings.neighbours and off[members].max() > settings.worst:
                    found.append((members, which))
    return found


def _span(
    windows: Segments, members: Ints, errors: Array, times: Array, signal: Signal, step: float
) -> Span:
    """The span of neighbouring windows, with the numbers of the worst of them."""
    trajectory = int(windows.trajectory[members[0]])
    begin = windows.trajectories.spans[trajectory][0]
    first = int(windows.steps[members[0], 0]) - begin
    last = int(windows.steps[members[-1], -1]) + 1 - begin
    worst = members[int(np.argmax(np.abs(times[members])))]
    return Span(
        trajectory=trajectory,
        first=first,
        last=last,
        start=first * step,
        end=last * step,
        signal=signal.name,
        unit=signal.unit,
        size=float(errors[worst]),
        seconds=windows.steps.shape[1] * step,
        times=float(abs(times[worst])),
    )


def _overlap(one: Span, other: Span) -> bool:
    """Whether two spans share a transition."""
    same = one.trajectory == other.trajectory
    return same and one.first < other.last and other.first < one.last


def _joined(spans: list[Span], near: float) -> list[Span]:
    """Spans of one trajectory that follow each other closely as one, with the worst's numbers."""
    joined: list[Span] = []
    for span in spans:
        before = joined[-1] if joined else None
        if before is None or before.trajectory != span.trajectory or span.start - before.end > near:
            joined.append(span)
        else:
            worst = max(before, span, key=lambda one: one.times)
            joined[-1] = replace(
                worst,
                first=before.first,
                start=before.start,
                last=max(before.last, span.last),
                end=max(before.end, span.end),
            )
    return joined
