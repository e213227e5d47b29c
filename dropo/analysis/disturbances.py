"""Spans of time that no command explains, such as a hand that pushes the arm: found, listed, and left out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.checks import Array, float_array, require
from dropo.core.data import Ints, Segments, Signal, Trajectories
from dropo.core.simulator import Simulator

SECONDS = (0.05, 0.1, 0.2, 0.4)  # windows in which a push shows: a short strong one, a long weak one
SURE, EDGE = 8.0, 4.0  # robust standard deviations: of a span's worst window, and of all of them
NEIGHBOURS = 2  # windows of a span at least: a spike of a sensor spoils the one that begins there and the one that ends there
BINS, FEWEST = 10, 40  # of windows by how far they move, whose errors are compared with each other; windows in one at least
NEAR = 0.2  # seconds between spans of one disturbance
WINDOWS = 300  # that the robust fit sees
MUCH = 0.2  # a share of the data beyond which it is the model that is wrong

Predict = Callable[[Segments], Array]
"""What is expected at the compared rows (R, p) of segments of any length."""


@dataclass(frozen=True)
class Span:
    """Transitions `first` to `last` - 1 of a trajectory, `start` to `end` seconds from its beginning.

    signal: that is off most, by `size` in its unit after `seconds`, `times` the robust standard deviation of like windows.
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

    def __str__(self) -> str:
        where = f"trajectory {self.trajectory}, {self.start:.2f} to {self.end:.2f} s"
        unit = f" {self.unit}" if self.unit else ""
        return f"{where}: {self.signal} is {self.size:.3g}{unit} off after {self.seconds:.3g} s, {self.times:.0f} times the usual error"


@dataclass(frozen=True, eq=False)
class Disturbances:
    """The spans, by trajectory and time, in which the trajectories do not move as they do elsewhere."""

    trajectories: Trajectories
    spans: tuple[Span, ...]

    @property
    def share(self) -> float:
        """Of the transitions, how many lie in the spans."""
        return sum(span.last - span.first for span in self.spans) / len(self.trajectories)

    def left_out(self) -> Trajectories:
        """The trajectories without the spans; a trajectory is cut in two at each."""
        keep = np.ones(len(self.trajectories), dtype=bool)
        for span in self.spans:
            first = self.trajectories.spans[span.trajectory][0]
            keep[first + span.first : first + span.last] = False
        return self.trajectories.rows(np.flatnonzero(keep))

    def __str__(self) -> str:
        if not self.spans:
            return "No span of time stands out."
        lines = [
            f"{len(self.spans)} spans of time, {100 * self.share:.2g} % of the data, in which something acts that no command explains:"
        ]
        if self.share > MUCH:
            lines = [
                f"{len(self.spans)} spans, {100 * self.share:.2g} % of the data, stand out: so much is rather a model that lacks something:"
            ]
        return "\n  ".join([*lines, *map(str, self.spans)])


def find_disturbances(
    simulator: Simulator, trajectories: Trajectories, values: Array, step: float, *, seconds: Sequence[float] = SECONDS
) -> Disturbances:
    """Windows that the simulator with these values (d,) predicts far worse than others of like motion; step: of the control [s].

    A push shows in velocities: where there are such signals (units per second), they alone are judged. The values should come from a
    fit that explains most of the data (see `robust_values`), or the model's errors hide all but the strongest pushes: what the
    model always gets wrong in like motion is its usual error there.
    """
    value = float_array("values", values, (len(simulator.space),), "find_disturbances")
    return scan(
        lambda segments: simulator.predict(value[None], segments)[0], simulator.targets, simulator.signals, trajectories, step, seconds
    )


def scan(
    predict: Predict, targets: Predict, signals: Sequence[Signal], trajectories: Trajectories, step: float,
    seconds: Sequence[float] = SECONDS, sure: float = SURE,
) -> Disturbances:  # fmt: skip
    """Windows of each length whose errors stand out, joined to spans; a long window tells only of what no short one has shown.

    sure: robust standard deviations of a span's worst window.
    """
    require(step > 0, "step", "the seconds of a control step, above 0", step, "find_disturbances")
    found: list[Span] = []
    rates = [i for i, signal in enumerate(signals) if signal.unit.endswith("/s")] or list(range(len(signals)))
    judged = [signals[i] for i in rates]
    for length in sorted({max(1, round(s / step)) for s in seconds}):
        windows = cut(trajectories, length)
        if len(windows) < FEWEST:
            continue
        predicted, measured = predict(windows), targets(windows)
        errors = (measured - predicted)[:, rates]
        times = errors / _usual(errors, _moved(windows, predicted))
        for members, which in _runs(windows, times, sure):
            span = _span(windows, members, errors[:, which], times[:, which], judged[which], step)
            if not any(span.trajectory == s.trajectory and span.first < s.last and s.first < span.last for s in found):
                found.append(span)
    return Disturbances(trajectories, tuple(_joined(sorted(found, key=lambda span: (span.trajectory, span.first)))))


def _joined(spans: list[Span]) -> list[Span]:
    """Spans of one trajectory that follow each other closely as one, with the numbers of the worst."""
    out: list[Span] = []
    for span in spans:
        if out and out[-1].trajectory == span.trajectory and span.start - out[-1].end <= NEAR:
            worst = max(out[-1], span, key=lambda s: s.times)
            out[-1] = replace(
                worst, first=out[-1].first, start=out[-1].start, last=max(out[-1].last, span.last), end=max(out[-1].end, span.end)
            )
        else:
            out.append(span)
    return out


def cut(trajectories: Trajectories, length: int) -> Segments:
    """Windows of so many steps, each beginning half a window after the one before; only their ends are compared."""
    stride = max(1, length // 2)
    begin = np.concatenate([np.arange(start, stop - length + 1, stride) for start, stop in trajectories.spans]).astype(np.int64)
    return Segments(
        trajectories, begin[:, None] + np.arange(length), np.full(len(begin), -1, dtype=np.int64),
        np.ones(trajectories.observations.shape[1], dtype=bool),
    )  # fmt: skip


def _moved(windows: Segments, predicted: Array) -> Array:
    """(W,) how far a window goes by the prediction, in spreads of the signals."""
    ways = predicted - windows.starts if predicted.shape == windows.starts.shape else predicted
    ways = np.nan_to_num(ways)
    return np.asarray(np.sqrt(np.sum((ways / np.maximum(ways.std(axis=0), 1e-300)) ** 2, axis=1)))


def _usual(errors: Array, moved: Array) -> Array:
    """(W, p) the robust standard deviation of the errors of windows that move about as far; no less than
    in half of all bins: at rest, where friction holds, there are none."""
    order = np.argsort(moved, kind="stable")
    bins = np.array_split(order, max(1, min(BINS, len(order) // FEWEST)))
    scales = np.array([_robust(errors[members]) for members in bins])
    scales = np.maximum(scales, np.median(scales, axis=0))
    out = np.empty_like(errors)
    for members, scale in zip(bins, scales, strict=True):
        out[members] = scale
    return np.maximum(out, 1e-300)


def _robust(errors: Array) -> Array:
    return np.asarray(1.4826 * np.nanmedian(np.abs(errors), axis=0))


def _runs(windows: Segments, times: Array, sure: float) -> list[tuple[Ints, int]]:
    """Neighbouring windows, and the signal that is above EDGE to the same side in all of them, and above `sure` in one."""
    out = []
    for which in range(times.shape[1]):
        for side in (1.0, -1.0):
            above = np.flatnonzero(side * times[:, which] > EDGE)
            broken = (np.diff(above) > 1) | (np.diff(windows.trajectory[above]) != 0)
            runs = np.split(above, np.flatnonzero(broken) + 1)
            out += [(run, which) for run in runs if len(run) >= NEIGHBOURS and (side * times[run, which]).max() > sure]
    return out


def _span(windows: Segments, members: Ints, errors: Array, times: Array, signal: Signal, step: float) -> Span:
    trajectory = int(windows.trajectory[members[0]])
    begin = windows.trajectories.spans[trajectory][0]
    first, last = int(windows.steps[members[0], 0]) - begin, int(windows.steps[members[-1], -1]) + 1 - begin
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
    simulator: Simulator, trajectories: Trajectories, step: float, start: Array, *, seconds: float = 0.2, rounds: int = 8
) -> Array:
    """The parameters (d,) that explain most windows: Gauss-Newton with the weights of a Student t of 3 degrees of freedom.

    Windows in which something pushes count for little, so that they need not be found before the model is fitted.
    """
    windows = cut(trajectories, max(1, round(seconds / step)))
    windows = windows.take(windows.spread_out(WINDOWS))
    space, measured = simulator.space, simulator.targets(windows)
    value = np.clip(float_array("start", start, (len(space),), "robust_values"), space.low, space.high)
    width = space.high - space.low
    for _ in range(rounds):
        predicted, slopes = simulator.linearise(value, windows, step=1e-3 * width)
        errors = measured - predicted
        scale = np.maximum(_robust(errors), 1e-300)
        weights = 4 / (3 + np.sum((errors / scale) ** 2, axis=1) / errors.shape[1])  # (W,)
        white = (slopes * width / scale[:, None] * np.sqrt(weights)[:, None, None]).reshape(-1, len(space))
        rest = (errors / scale * np.sqrt(weights)[:, None]).ravel()
        change = np.linalg.lstsq(
            np.concatenate([white, 1e-3 * np.eye(len(space))]), np.concatenate([rest, np.zeros(len(space))]), rcond=None
        )[0]
        new = np.clip(value + width * np.clip(change, -0.25, 0.25), space.low, space.high)
        if np.max(np.abs(new - value) / width) < 1e-4:
            return new
        value = new
    return value
