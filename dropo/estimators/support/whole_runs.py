"""Whether the start states of a problem must be found along its runs."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import normal_of_tail
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.robot_simulator import RobotSimulator

NOT_MEASURED = "Part of the moving state is not measured: start states are found along whole runs."
ASKED_FOR = "The problem asks for whole runs: start states are found along them."
NOISY = (
    "Rows follow each other and begin with noisy measurements: start states are found along whole"
    " runs."
)


@dataclass(frozen=True)
class NoisyStartSettings:
    """When residuals of single steps say that the steps began in noisy measurements.

    A measurement's error is the end of one step and the start of the next, so residuals cancel as
    they are added up along a run; what the model lacks does not cancel.

    Attributes
    ----------
    spans : tuple of int
        Steps over which residuals are added up.
    shortest : int
        A run is at least so many times as long as a span, and long enough to matter at all.
    level : float
        False alarms over all signals and spans.
    ratio : float
        The variance of a sum, over that of as many independent residuals, must be below this: less
        noise does not matter.
    own : float
        Least share of a residual's variance that the other signals' residuals do not explain:
        parameters that vary move all signals of a machine together.
    rounding : float
        Residuals below this share of the signal are no evidence.
    """

    spans: tuple[int, ...] = (2, 3, 5, 10, 20, 30)
    shortest: int = 2
    level: float = 1e-3
    ratio: float = 0.85
    own: float = 0.2
    rounding: float = 1e-7


SETTINGS = NoisyStartSettings()


def may_follow_runs(problem: Problem, settings: NoisyStartSettings = SETTINGS) -> bool:
    """Tell whether a likelihood of whole runs would be in place, were starts noisy or unknown.

    Parameters
    ----------
    problem : Problem
    settings : NoisyStartSettings

    Returns
    -------
    bool
        True where single steps from measured states are compared, or the problem asks for whole
        runs, rows follow each other within runs of one group each, no effect acts by the time since
        a start or on the sensors, and bodies do not touch: through contacts, the search is not to
        be trusted.
    """
    by_length = problem.horizon == 1 or problem.whole_runs
    if problem.reset != "transition" or problem.every_step or not by_length:
        return False
    data = problem.trajectories
    if not _follow(data) or _groups_change(data):
        return False
    longest = max(stop - start for start, stop in data.spans)
    if longest < settings.shortest * min(settings.spans):
        return False
    if bound_to_segments(problem):
        return False
    every_row = problem.segments if problem.horizon == 1 else data.segments(1)
    return not bool(problem.simulator.in_contact(every_row).any())


def reason_to_follow(problem: Problem) -> str | None:
    """Say why whole runs are to be followed at once, before any fit of segments.

    Parameters
    ----------
    problem : Problem
        Of which `may_follow_runs`.

    Returns
    -------
    str or None
        A sentence for the message of the fit; None where residuals of single steps are to decide.
    """
    if lacks_states(problem):
        return NOT_MEASURED
    return ASKED_FOR if problem.whole_runs else None


def lacks_states(problem: Problem) -> bool:
    """Tell whether some of the state that moves was not measured.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    bool
    """
    return bool(problem.estimated) or len(problem.simulator.observing_state()[1]) > 0


def bound_to_segments(problem: Problem) -> list[str]:
    """Name the effects that act by the time since a segment's start, or on the sensors.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    list of str
        Labels of those that a run of linked windows cannot have.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return []
    every = [*simulator.effects, *(instance for instance, _ in simulator.fixed)]
    return [instance.label for instance in every if _is_bound(instance)]


def _is_bound(instance: EffectInstance) -> bool:
    """Whether an effect is not one of the state and the commands alone."""
    hooks = (
        instance.applied_force,
        instance.measurement,
        instance.sensor_delay,
        instance.start,
        instance.time_profile,
    )
    return any(hook is not None for hook in hooks)


def starts_are_noisy(
    problem: Problem,
    run: Run,
    mean: Array,
    predicted: Array,
    settings: NoisyStartSettings = SETTINGS,
) -> bool:
    """Tell whether residuals cancel along runs, as those from noisy starts do.

    Parameters
    ----------
    problem : Problem
        Of single steps.
    run : Run
        Counts the simulations over longer spans, which are made where single steps do not tell.
    mean : (d,) array
        Of a fit.
    predicted : (R, p) array
        Its mean predictions.
    settings : NoisyStartSettings

    Returns
    -------
    bool

    References
    ----------
    Lo and MacKinlay, The Review of Financial Studies 1 (1988), 41, for the variance ratio.
    """
    targets = problem.simulator.targets(problem.segments)
    residual = targets - predicted
    size = residual.std(axis=0)
    evident = size > settings.rounding * np.maximum(targets.std(axis=0), 1e-300)
    evident &= _own_fraction(residual) > settings.own
    if not evident.any():
        return False
    residual = residual[:, evident]
    longest = max(stop - start for start, stop in problem.trajectories.spans)
    spans = [span for span in settings.spans if longest >= settings.shortest * span]
    # Each signal and all together, over every span, in both ways.
    tests = 2 * len(spans) * (residual.shape[1] + 1)
    limit = float(normal_of_tail(settings.level / tests))
    found = [test for span in spans for test in _variance_ratios(residual, problem, span, settings)]
    if _is_low(found, limit, settings):
        return True
    found = [
        test
        for span in spans
        for test in _longer_spans(residual, evident, problem, run, mean, span)
    ]
    return _is_low(found, limit, settings)


def _is_low(tests: list[tuple[float, float]], limit: float, settings: NoisyStartSettings) -> bool:
    """Whether some ratio is low, by enough standard errors."""
    return any(ratio < settings.ratio and z < -limit for ratio, z in tests)


def _follow(data: Trajectories) -> bool:
    """Whether each row begins with what the one before it in its trajectory ended with."""
    inner = ~data.terminals[:-1]
    same = (data.next_observations[:-1] == data.observations[1:]).all(axis=1)
    return bool(inner.any() and same[inner].all())


def _groups_change(data: Trajectories) -> bool:
    """Whether rows of one trajectory are of different groups."""
    if data.group is None:
        return False
    return bool((np.diff(data.group) != 0)[~data.terminals[:-1]].any())


def _own_fraction(residual: Array) -> Array:
    """(p,) the share of each signal's variance that the others do not explain linearly."""
    p = residual.shape[1]
    size = np.maximum(residual.std(axis=0), 1e-300)
    scaled = (residual - residual.mean(axis=0)) / size
    fraction = np.ones(p)
    for j in range(p):
        others = np.delete(scaled, j, axis=1)
        if others.shape[1]:
            fitted = others @ np.linalg.lstsq(others, scaled[:, j], rcond=1e-10)[0]
            fraction[j] = np.mean((scaled[:, j] - fitted) ** 2)
    return fraction


def _variance_ratios(
    residual: Array, problem: Problem, span: int, settings: NoisyStartSettings
) -> list[tuple[float, float]]:
    """The variance of sums over a span, over that of as many independent residuals, and its z."""
    sums = []
    count = 0
    for start, stop in problem.trajectories.spans:
        if stop - start < settings.shortest * span:
            continue
        nothing = np.zeros((1, residual.shape[1]))
        total = np.cumsum(np.concatenate([nothing, residual[start:stop]]), axis=0)
        sums.append(total[span:] - total[:-span])
        count += stop - start
    variance = np.mean(np.concatenate(sums) ** 2, axis=0)
    ratio = variance / (span * np.mean(residual**2, axis=0))
    error = np.sqrt(2 * (2 * span - 1) * (span - 1) / (3 * span * count))
    return _and_together(ratio, (ratio - 1) / error, residual)


def _longer_spans(
    residual: Array, evident: Array, problem: Problem, run: Run, mean: Array, span: int
) -> list[tuple[float, float]]:
    """The variance of residuals a span behind a start, over that of added ones, and its z.

    As sums, with what the motion makes of each residual on the way.
    """
    longer = problem.using(horizon=span)
    with run.counting(evaluations=1):
        predicted = problem.simulator.predict(mean[None], longer.segments)[0]
    left = (problem.simulator.targets(longer.segments) - predicted)[:, evident]
    if not np.isfinite(left).all():
        return []
    ratio = np.mean(left**2, axis=0) / (span * np.mean(residual**2, axis=0))
    error = np.sqrt(2 / len(left) + 2 / len(residual))
    return _and_together(ratio, np.log(ratio) / error, left)


def _and_together(ratio: Array, z: Array, residual: Array) -> list[tuple[float, float]]:
    """Ratio and z of each signal, and of all: residuals of correlation r have ratios of r^2."""
    correlation = np.atleast_2d(np.corrcoef(residual.T))
    together = (float(np.median(ratio)), float(z.sum() / np.sqrt(np.sum(correlation**2))))
    return [*zip(ratio.tolist(), z.tolist(), strict=True), together]
