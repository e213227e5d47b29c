"""Spans of time that no command explains, such as a hand that pushes the arm: found, listed, and
left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints, Segments, Signal, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.data.outliers.robust_fit import robust_fit

SECONDS = (
    0.05,
    0.1,
    0.2,
    0.4,
)  # windows in which a push shows: a short strong one, a long weak one
# robust standard deviations: of a span's worst window, and of all of them
SURE = 6.0
EDGE = 4.0
# windows of a span at least: a spike of a sensor spoils the one that begins there and the one that
# ends there
NEIGHBOURS = 2
# of windows by how far they move, whose errors are compared with each other; windows in one at
# least
BINS = 10
FEWEST = 40
NEAR = 0.2  # seconds between spans of one disturbance
FAR = 3.0  # standard deviations of noise that a start may be off by
AROUND = 2  # rows around a contact that are not looked at
WINDOWS = 300  # that the robust fit sees
MUCH = 0.2  # a share of the data beyond which it is the model that is wrong
STILL = 0.02  # of a signal's spread: a window that goes less far is at rest
ROUNDING = 1e-4  # of a signal's spread: what is off by less is no push
# of a run's moving windows, those that err least say what is usual in it; that quantile of |z|
CALM = 0.25
CALM_NORMAL = 0.3186

Predict = Callable[[Segments], Array]
"""What is expected at the compared rows (R, p) of segments of any length."""


@dataclass(frozen=True)
class Span:
    """Transitions `first` to `last` - 1 of a trajectory, `start` to `end` seconds from its
    beginning; held_out: of those held out.

    signal: that is off most, by `size` in its unit after `seconds`, `times` the robust standard
    deviation of like windows.
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
        """Plain numbers: the run, and from where to where in it [s]."""
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
    """The spans, by trajectory and time, in which the trajectories do not move as they do
    elsewhere.
    """

    trajectories: Trajectories
    spans: tuple[Span, ...]

    @property
    def share(self) -> float:
        """Of the transitions, how many lie in the spans."""
        return sum(span.last - span.first for span in self.spans) / len(self.trajectories)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(N,) the transitions that lie in the spans."""
        out = np.zeros(len(self.trajectories), dtype=bool)
        for span in self.spans:
            begin = self.trajectories.spans[span.trajectory][0]
            out[begin + span.first : begin + span.last] = True
        return out

    def left_out(self) -> Trajectories:
        """The trajectories without the spans; a trajectory is cut in two at each."""
        return self.trajectories.rows(np.flatnonzero(~self.inside))

    def __str__(self) -> str:
        if not self.spans:
            return "No span of time stands out."
        lines = [
            (
                f"{len(self.spans)} spans of time, {100 * self.share:.2g} % of the data, in "
                "which something acts that no command explains:"
            )
        ]
        if self.share > MUCH:
            lines = [
                (
                    f"{len(self.spans)} spans, {100 * self.share:.2g} % of the data, stand "
                    "out: so much is rather a model that lacks something:"
                )
            ]
        return "\n  ".join([*lines, *map(str, self.spans)])


def find_disturbances(
    simulator: Simulator,
    trajectories: Trajectories,
    values: Array,
    step: float,
    *,
    seconds: Sequence[float] = SECONDS,
) -> Disturbances:
    """Find windows that a simulator predicts far worse than others of like motion, joined to spans.

    A push shows in velocities: where there are such signals (units per second), they alone are
    evaluated. A long window adds only what no short one has shown. Transitions near contacts are
    not looked at.

    Parameters
    ----------
    simulator
        Should explain most of the data, or its errors hide all but the strongest pushes: what it
        always gets wrong in like motion is its usual error there.
    trajectories
        The data.
    values
        (d,) the simulator's parameters, from a fit (see `robust_values`).
    step
        Of the control [s].
    seconds
        Lengths of the windows.

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
    predict: Predict = lambda segments: simulator.predict(value[None], segments)[0]
    short = cut(trajectories, 1)
    noise = deviation(simulator.targets(short) - predict(short)) / np.sqrt(2)
    free = _untouched(simulator, trajectories)
    signals = simulator.signals
    every = list(range(len(signals)))
    rates = [i for i in every if signals[i].unit.endswith("/s")] or every
    found: list[Span] = []
    for length in sorted({max(1, round(s / step)) for s in seconds}):
        windows = cut(trajectories, length)
        windows = windows if free is None else windows.take(free[windows.steps].all(axis=1))
        if len(windows) < FEWEST:
            continue
        predicted = predict(windows)
        errors = (simulator.targets(windows) - predicted)[:, rates]
        usual = _usual(errors, _moved(windows, predicted), windows.trajectory)
        usual = np.maximum(usual, ROUNDING * np.nanstd(predicted[:, rates], axis=0))
        times = errors / usual
        far = np.flatnonzero((np.abs(times) > EDGE).any(axis=1))
        if len(far):
            by_noise = _reach(simulator, value, noise, windows.take(far))[:, rates]
            left = np.maximum(np.abs(errors[far]) - by_noise, 0.0)
            times[far] = np.sign(errors[far]) * left / usual[far]
        for members, which in _runs(windows, times):
            signal = signals[rates[which]]
            span = _span(windows, members, errors[:, which], times[:, which], signal, step)
            if not any(_overlap(span, other) for other in found):
                found.append(span)
    found.sort(key=lambda span: (span.trajectory, span.first))
    return Disturbances(trajectories, tuple(_joined(found)))


def _overlap(one: Span, other: Span) -> bool:
    """Whether two spans share a transition."""
    same = one.trajectory == other.trajectory
    return same and one.first < other.last and other.first < one.last


def _reach(simulator: Simulator, value: Array, noise: Array, windows: Segments) -> Array:
    """(W, p) how far predictions move as each signal of the start is off by up to FAR standard
    deviations, all signals together.

    So a window that begins close to a stop or an impact, where little decides much, is not taken
    for pushed.
    """
    p = len(noise)
    if simulator.start_size != p:
        return np.zeros((len(windows), p))
    shares = FAR * np.array([-1.0, -0.5, 0.5, 1.0])
    offsets = np.zeros((1 + len(shares) * p, len(windows), p))
    for i in range(p):
        offsets[1 + len(shares) * i + np.arange(len(shares)), :, i] = (shares * noise[i])[:, None]
    found = simulator.predict(
        np.repeat(value[None], len(offsets), axis=0), windows, offsets=offsets
    )
    moved = np.nan_to_num(np.abs(found[1:] - found[0]), nan=np.inf).reshape(
        p, len(shares), len(windows), p
    )
    return np.asarray(moved.max(axis=1).sum(axis=0))


def _untouched(simulator: Simulator, trajectories: Trajectories) -> NDArray[np.bool_]:
    """(N,) transitions that neither begin nor end near a contact, in which a push and a wrong
    contact are the same.
    """
    touching = np.array(simulator.in_contact(trajectories.segments(1)))
    for _ in range(AROUND):
        touching[1:], touching[:-1] = touching[1:] | touching[:-1], touching[1:] | touching[:-1]
    return ~touching


def _joined(spans: list[Span]) -> list[Span]:
    """Spans of one trajectory that follow each other closely as one, with the numbers of the worst."""
    out: list[Span] = []
    for span in spans:
        if out and out[-1].trajectory == span.trajectory and span.start - out[-1].end <= NEAR:
            worst = max(out[-1], span, key=lambda s: s.times)
            out[-1] = replace(
                worst,
                first=out[-1].first,
                start=out[-1].start,
                last=max(out[-1].last, span.last),
                end=max(out[-1].end, span.end),
            )
        else:
            out.append(span)
    return out


def cut(trajectories: Trajectories, length: int) -> Segments:
    """Windows of so many steps, each beginning half a window after the one before; only their ends
    are compared.
    """
    stride = max(1, length // 2)
    begin = np.concatenate(
        [np.arange(start, stop - length + 1, stride) for start, stop in trajectories.spans]
    ).astype(np.int64)
    return trajectories.from_rows(begin, length)


def _moved(windows: Segments, predicted: Array) -> Array:
    """(W,) how far a window goes by the prediction, in spreads of the signals."""
    ways = np.nan_to_num(
        predicted - windows.starts if predicted.shape == windows.starts.shape else predicted
    )
    return np.asarray(np.sqrt(np.sum((ways / np.maximum(ways.std(axis=0), 1e-300)) ** 2, axis=1)))


def _usual(errors: Array, moved: Array, run: Ints) -> Array:
    """(W, p) the robust standard deviation of the errors of windows that move about as far, and no
    less than in half of all bins; and no less than that of the calmer windows of its run.
    Windows at rest do not count: where friction holds, there are no errors.
    """
    moving = np.flatnonzero(moved > STILL)
    if not len(moving):
        return np.full_like(errors, np.inf)
    bins = np.array_split(
        moving[np.argsort(moved[moving], kind="stable")], max(1, min(BINS, len(moving) // FEWEST))
    )
    scales = np.array([deviation(errors[members]) for members in bins])
    scales = np.maximum(scales, np.median(scales, axis=0))
    out = scales[np.searchsorted([moved[members[-1]] for members in bins[:-1]], moved)]
    for k in np.unique(run[moving]):
        calm = np.nanquantile(np.abs(errors[moving[run[moving] == k]]), CALM, axis=0) / CALM_NORMAL
        out[run == k] = np.maximum(out[run == k], calm)
    return out


def _runs(windows: Segments, times: Array) -> list[tuple[Ints, int]]:
    """Neighbouring windows, and the signal that is above EDGE to the same side in all of them, and
    above SURE in one.
    """
    out = []
    for which in range(times.shape[1]):
        for side in (1.0, -1.0):
            above = np.flatnonzero(side * times[:, which] > EDGE)
            broken = (np.diff(above) > 1) | (np.diff(windows.trajectory[above]) != 0)
            runs = np.split(above, np.flatnonzero(broken) + 1)
            out += [
                (run, which)
                for run in runs
                if len(run) >= NEIGHBOURS and (side * times[run, which]).max() > SURE
            ]
    return out


def _span(
    windows: Segments, members: Ints, errors: Array, times: Array, signal: Signal, step: float
) -> Span:
    trajectory = int(windows.trajectory[members[0]])
    begin = windows.trajectories.spans[trajectory][0]
    first = int(windows.steps[members[0], 0]) - begin
    last = int(windows.steps[members[-1], -1]) + 1 - begin
    worst = members[int(np.argmax(np.abs(times[members])))]
    seconds = windows.steps.shape[1] * step
    return Span(
        trajectory,
        first,
        last,
        first * step,
        last * step,
        signal.name,
        signal.unit,
        float(errors[worst]),
        seconds,
        float(abs(times[worst])),
    )


def robust_values(
    simulator: Simulator,
    trajectories: Trajectories,
    step: float,
    start: Array,
    *,
    seconds: float = 0.2,
) -> Array:
    """The parameters (d,) that explain most windows of the trajectories, from `start`:
    `robust_fit`, which pushes do not lead astray.
    """
    windows = cut(trajectories, max(1, round(seconds / step)))
    return robust_fit(simulator, windows.take(windows.thin(WINDOWS)), start).value
