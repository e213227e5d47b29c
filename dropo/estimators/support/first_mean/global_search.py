"""The first mean in a wide box, or where a likelihood may have several maxima.

Simulations all over the box, searches from the best of them, and where segments are long, from what
short ones say: their likelihood has one maximum where that of long ones repeats with every turn of
an oscillation.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.sobol import sobol_points
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array
from dropo.estimators.support.first_mean.descent import DescentSettings, descend
from dropo.estimators.support.first_mean.misfit import SETTINGS as MISFIT
from dropo.estimators.support.first_mean.misfit import Misfit


@dataclass(frozen=True)
class GlobalSearchSettings:
    """How much of the box and of the data is tried.

    Attributes
    ----------
    points : int
        So many points of the box are tried, a power of 2.
    many : int
        From so many parameters on, there are twice as many points, of which one is searched from,
        and one further: each search costs more than there.
    segments : int
        So many segments are simulated from each point, or as many short ones as have no more
        control steps together.
    steps : int
        So many short segments are simulated at most.
    descents : bool
        Whether there are searches at all, or the best point is taken as it is.
    searches : int
        Searches begin from so many of the best points.
    further : int
        So many more begin where only one of the first ended in the best optimum.
    apart : float
        Least distance of the points where searches begin, in the unit box.
    alike : float
        Optima are alike within this difference [nats].
    near : float
        A start that is so near to the best optimum, in the unit box, and leads there, is kept.
    barrier : float
        Two optima are apart where the misfit between them is so much higher [nats].
    worse : float
        A fit is worse than the best optimum by more than this for each compared number [nats].
    line : int
        Maxima are counted on so many points along each parameter.
    repeats : int
        So many maxima along a parameter are named.
    stretch : int
        Segments become longer by this factor, from one length to the next.
    follow : DescentSettings
        How an optimum is followed from one length to the next.
    """

    points: int = 64
    many: int = 6
    segments: int = 60
    steps: int = 1000
    descents: bool = True
    searches: int = 3
    further: int = 8
    apart: float = 0.15
    alike: float = 3.0
    near: float = 0.15
    barrier: float = 5.0
    worse: float = 0.1
    line: int = 64
    repeats: int = 3
    stretch: int = 4
    follow: DescentSettings = field(default_factory=lambda: DescentSettings(rounds=5))

    def searched(self, d: int) -> tuple[int, int]:
        """Return from how many points the box is searched.

        Parameters
        ----------
        d : int
            Number of parameters.

        Returns
        -------
        first : int
            Searches at first.
        further : int
            How many more there are, where only one of the first ended in the best optimum.
        """
        return (1, 1) if d >= self.many else (self.searches, self.further)


SETTINGS = GlobalSearchSettings()


@dataclass(frozen=True, eq=False)
class GlobalStart:
    """Where a search should begin.

    Attributes
    ----------
    value : (d,) array
        The first mean.
    best, near : (d,) array
        The best optimum, and how wide it is, in the parameters' units.
    agreed : bool
        Whether all searches over the box ended there.
    misfit : Misfit
        By which it was found.
    least : float
        Its misfit [nats].
    warnings : tuple of str
        Where there may be a better optimum.
    """

    value: Array
    best: Array
    near: Array
    agreed: bool
    misfit: Misfit
    least: float
    warnings: tuple[str, ...]

    @property
    def width(self) -> Array | None:
        """The first region's width (d,), where a usual one may hold several optima."""
        return None if self.agreed else self.near

    def is_better_than(self, mean: Array, settings: GlobalSearchSettings = SETTINGS) -> bool:
        """Return whether the best optimum explains the data better than a fitted mean.

        Parameters
        ----------
        mean : (d,) array
            In the parameters' units.
        settings : GlobalSearchSettings
            By how much the misfit must differ.

        Returns
        -------
        bool
            False where it differs by chance alone.
        """
        found = float(self.misfit.at(self.misfit.unit_of(mean[None]))[0])
        return found > self.least + settings.alike + settings.worse * self.misfit.targets.size


def is_wide(space: ParameterSpace) -> bool:
    """Tell whether an interval spans more than a search from one point should be trusted with.

    Parameters
    ----------
    space : ParameterSpace

    Returns
    -------
    bool
        True where an upper end is more than 30 times its lower one, or the lower one not positive.
    """
    return bool(np.any(space.high > MISFIT.wide * np.maximum(space.low, 0.0)))


def may_have_several(problem: Problem) -> bool:
    """Tell whether segments are long enough for a motion to repeat.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    bool
    """
    return problem.horizon > 1 or problem.reset != "transition"


def best_start(
    problem: Problem, run: Run, mean: Array, settings: GlobalSearchSettings = SETTINGS
) -> GlobalStart:
    """Find the best optimum of the box, by some of the segments.

    Parameters
    ----------
    problem : Problem
        Whose start states are measured.
    run : Run
        Counts the simulations.
    mean : (d,) array
        The start that was asked for, which is one of those tried.
    settings : GlobalSearchSettings

    Returns
    -------
    GlobalStart
    """
    run.progress(0.0, "simulations over the whole box")
    misfit = Misfit(problem, run, _some(problem, settings))
    scan = _scan(len(problem.space), settings)
    if not settings.descents:
        return _best_of(misfit, np.concatenate([misfit.unit_of(mean[None]), scan]))
    order = _apart(scan, misfit.at(scan), settings)
    searches, further = settings.searched(len(problem.space))
    first = [misfit.unit_of(mean[None]), scan[order[:searches]]]
    if problem.segments.lengths.max() > 1:
        first.append(_from_short_segments(problem, run, settings)[None])
    points, values = descend(misfit, np.concatenate(first))
    if _reached(values, settings) < 2:
        behind = order[searches : searches + further]
        if len(behind):
            more = descend(misfit, scan[behind])
            points = np.concatenate([points, more[0]])
            values = np.concatenate([values, more[1]])

    best = int(values.argmin())
    asked = misfit.unit_of(mean[None])[0]
    leads_there = values[0] <= values[best] + settings.alike
    near = np.abs(points[best] - asked).max() <= settings.near
    optimum = misfit.values_of(points[best][None])[0]
    return GlobalStart(
        mean if leads_there and near else optimum,
        optimum,
        misfit.width_at(points[best]),
        _reached(values, settings) == len(values),
        misfit,
        float(values[best]),
        _warnings(misfit, points, values, settings),
    )


def _best_of(misfit: Misfit, points: Array) -> GlobalStart:
    """The best of points (n, d) of the unit box, without a search."""
    values = misfit.at(points)
    best = int(values.argmin())
    value = misfit.values_of(points[best][None])[0]
    near = (misfit.high - misfit.low) / len(points) ** (1 / len(value))
    return GlobalStart(value, value, near, True, misfit, float(values[best]), ())


def _scan(d: int, settings: GlobalSearchSettings) -> Array:
    """(n, d) points all over the unit box."""
    exponent = int(np.log2(settings.points)) + (d >= settings.many)
    return sobol_points(d, exponent, np.random.default_rng(0))


def _some(problem: Problem, settings: GlobalSearchSettings, whole: int = 1) -> Segments:
    """Segments from all over the data; whole: steps of one of the problem's own."""
    segments = problem.segments
    longest = int(segments.lengths.max())
    count = settings.segments * max(1, whole // longest)
    return segments.take(segments.thin(min(count, max(settings.segments, settings.steps))))


def _apart(points: Array, values: Array, settings: GlobalSearchSettings) -> list[int]:
    """Numbers of the points (n, d), best first, without those near a better one."""
    chosen: list[int] = []
    for k in np.argsort(values, kind="stable").tolist():
        distance = np.abs(points[chosen] - points[k]).max(axis=1, initial=0.0)
        if (distance >= settings.apart).all():
            chosen.append(k)
    return chosen


def _from_short_segments(problem: Problem, run: Run, settings: GlobalSearchSettings) -> Array:
    """(d,) the optimum of single steps, followed as segments grow to the problem's own length."""
    own = int(problem.segments.lengths.max())
    length = 1
    point: Array | None = None
    while length < own:
        short = replace(
            problem, horizon=length, reset="transition", set_columns=None, every_step=False
        )
        misfit = Misfit(short, run, _some(short, settings, own))
        if point is None:
            scan = _scan(len(problem.space), settings)
            order = _apart(scan, misfit.at(scan), settings)
            first = order[: settings.searched(len(problem.space))[0]]
            points, values = descend(misfit, scan[first])
            point = points[values.argmin()]
        else:
            point = descend(misfit, point[None], settings.follow)[0][0]
        length *= settings.stretch
    assert point is not None
    return point


def _reached(values: Array, settings: GlobalSearchSettings) -> int:
    """How many searches ended in the best optimum."""
    return int(np.sum(values <= values.min() + settings.alike))


def _warnings(
    misfit: Misfit, points: Array, values: Array, settings: GlobalSearchSettings
) -> tuple[str, ...]:
    """A sentence where the best optimum was found once alone, or has an equal elsewhere."""
    names = misfit.problem.space.names
    best = int(values.argmin())
    alike = np.flatnonzero(values <= values[best] + settings.alike)
    # Of those alike, the one farthest away: what lies between decides whether it is another one.
    distance = np.abs(points[alike] - points[best]).max(axis=1)
    other = int(alike[distance.argmax()])
    if distance.max() > settings.apart:
        share = np.linspace(0, 1, 9)[1:-1, None]
        between = misfit.at(points[best] + share * (points[other] - points[best]))
        if between.max() > max(values[best], values[other]) + settings.barrier:
            there = misfit.values_of(points[[best, other]])
            far = int(np.abs(points[other] - points[best]).argmax())
            both = f"{there[0][far]:.4g} and {there[1][far]:.4g}"
            return (
                f"two optima explain the data alike, {names[far]} about {both}: the data cannot"
                " decide between them. Narrow the bounds",
            )
    if len(alike) > 1 or len(values) == 1:
        return ()
    along = _repeating(misfit, points[best], settings)
    where = f" (there are {along[1]} along {names[along[0]]})" if along else ""
    return (
        f"the likelihood has several maxima{where}, and one of {len(values)} searches over the box"
        " ended in the one taken: there may be a better one. Narrow the bounds, or start near it",
    )


def _repeating(
    misfit: Misfit, point: Array, settings: GlobalSearchSettings
) -> tuple[int, int] | None:
    """The parameter along which the misfit has the most minima, and how many, if they are many."""
    line = (np.arange(settings.line) + 0.5) / settings.line
    d = len(point)
    lines = np.repeat(point[None], d * len(line), axis=0)
    for i in range(d):
        lines[i * len(line) : (i + 1) * len(line), i] = line
    values = misfit.at(lines).reshape(d, -1)
    counts = [_minima(one, settings.barrier) for one in values]
    worst = int(np.argmax(counts))
    return (worst, counts[worst]) if counts[worst] >= settings.repeats else None


def _minima(values: Array, barrier: float) -> int:
    """How many minima a line of values has between which it rises by a barrier."""
    count = 0
    low, high = np.inf, -np.inf
    falling = True
    for value in values.tolist():
        if falling:
            low = min(low, value)
            if value > low + barrier:
                count += 1
                falling = False
                high = value
        else:
            high = max(high, value)
            if value < high - barrier:
                falling = True
                low = value
    return count + falling
