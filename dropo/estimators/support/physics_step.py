"""Which estimates are those of the model's physics step, and not of the machine."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.estimators.support.standard_errors import local_jacobian


@dataclass(frozen=True)
class PhysicsStepSettings:
    """When estimates are compared with those of shorter physics steps, and what is said.

    Attributes
    ----------
    finer : int
        Physics steps in the place of one.
    moved : float
        An estimate is named that would move by more of its standard errors.
    share : float
        Of the simulator steps of the search: segments are compared that cost at most so much more.
        Whole runs, of which a search simulates all dozens of times, are always compared.
    fewest : int
        Control steps in them, at least: where these cost more, nothing is compared.
    rounding : float
        Data whose residuals are below this share of every signal were made by the model's own
        steps.
    own : float
        So were data, in a fit that nothing else speaks against, that are nearer to the model's own
        steps than to the shorter ones by so many standard errors.
    """

    finer: int = 2
    moved: float = 1.0
    share: float = 0.05
    fewest: int = 100
    rounding: float = 1e-6
    own: float = 3.0


SETTINGS = PhysicsStepSettings()


@dataclass(frozen=True, eq=False)
class _Change:
    """What shorter steps change, in units of the noise, numbers of all rows one behind the other.

    slopes: (n, d) of the predictions; residual: (n,) measured less predicted; change: (n,) of the
    predictions.
    """

    slopes: Array
    residual: Array
    change: Array

    def moved(self, prior: Array) -> Array:
        """(d,) the Gauss-Newton step that makes up for the change; prior: (d,) information."""
        gram = self.slopes.T @ self.slopes + np.diag(prior)
        size = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True)
        return -(inverse @ (self.slopes.T @ self.change / size)) / size

    def of_own_steps(self, moved: Array, settings: PhysicsStepSettings) -> bool:
        """Whether the data are nearer to the model's own steps than to the shorter ones.

        What parameters do not make up for is there in the residuals by a share: 0 where the data
        were made by the model's own steps, 1 by the shorter ones, 2 by much shorter ones.
        """
        left = self.change + self.slopes @ moved
        size = left @ left
        if size == 0:
            return False
        share = self.residual @ left / size
        error = np.sqrt(np.sum((self.residual * left) ** 2)) / size
        return bool(share + settings.own * error < 0.5)


def checked_by_shorter_steps(
    problem: Problem,
    run: Run,
    fit: Fit,
    objective: LocalLogLikelihood,
    point: Array,
    *,
    spent: int | None = None,
    settings: PhysicsStepSettings = SETTINGS,
) -> Fit:
    """Say which estimates are those of the model's physics step.

    Predictions change when steps are halved. The check is how far the estimates would go to make
    up for that: one Gauss-Newton step, by the likelihood's own slopes and weights.

    Parameters
    ----------
    problem : Problem
        That was fitted; of whole runs, with the start states that were found.
    run : Run
        Counts the simulations.
    fit : Fit
    objective : LocalLogLikelihood
        Of which the fit is the maximum.
    point : (m,) array
        Its unknowns at the fit.
    spent : int, optional
        Simulator steps of the search, which bound what the check may cost. By default nothing does,
        as of whole runs.
    settings : PhysicsStepSettings

    Returns
    -------
    Fit
        With a warning, and not trusted, where an estimate would move by more than its standard
        error. The same fit where the data were simulated by the model's own steps (their `truth` is
        known, or they say so), or the check would cost too much.
    """
    simulator = problem.simulator
    if fit.status is Status.INTERRUPTED or problem.truth is not None:
        return fit
    finer = simulator.with_finer_steps(settings.finer)
    if finer is None or _is_exact(problem, objective, point, settings):
        return fit
    chosen = _chosen(problem, spent, settings)
    if not len(chosen):
        return fit

    # The same segments in both steps.
    segments = problem.segments.take(chosen)
    own = _predicted(simulator, fit.mean, segments, run)
    other = _predicted(finer, fit.mean, segments, run)
    there = np.isfinite(own) & np.isfinite(other)
    residual = np.where(there, simulator.targets(segments) - own, 0.0)
    change = np.where(there, other - own, 0.0)

    # How far the estimates would go.
    number = np.full(len(problem.segments), -1)
    number[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(number[problem.segments.rows[0]] >= 0)
    slopes = np.asarray(local_jacobian(objective, fit.mean, problem)[rows])
    found = _in_units_of_noise(objective, point, rows, slopes, residual, change)
    moved = found.moved(MeanPrior(problem.priors, problem.space).information(fit.mean))
    far = np.flatnonzero(np.abs(moved) > settings.moved * fit.mean_se)
    passed = fit.model_check is None or fit.model_check.passed
    if not len(far) or (passed and found.of_own_steps(moved, settings)):
        return fit
    sentence = _sentence(problem, fit, moved, far, settings)
    check = fit.model_check
    if check is not None:
        check = replace(check, passed=False, sentences=(*check.sentences, sentence))
    return replace(fit, model_check=check, warnings=(*fit.warnings, sentence))


def _is_exact(
    problem: Problem, objective: LocalLogLikelihood, point: Array, settings: PhysicsStepSettings
) -> bool:
    """Whether the fit leaves rounding alone."""
    targets = problem.simulator.targets(problem.segments)
    left = np.sqrt(np.mean((targets - objective.mean(point)) ** 2, axis=0))
    return bool(np.all(left <= settings.rounding * np.maximum(targets.std(axis=0), 1e-300)))


def _chosen(problem: Problem, spent: int | None, settings: PhysicsStepSettings) -> Ints:
    """The segments that are compared: all, or as many as may be, evenly spread."""
    lengths = problem.segments.lengths
    everything = np.arange(len(lengths))
    each = (1 + settings.finer) * problem.simulator.steps_per_action
    if spent is None or lengths.sum() * each <= settings.share * spent:
        return everything
    affordable = int(settings.share * spent / each)  # control steps
    count = affordable // int(lengths.max())
    chained = len(problem.segments.levels) > 1
    if chained or count == 0 or affordable < settings.fewest:
        return everything[:0]
    return np.unique(np.linspace(0, len(lengths) - 1, count).round().astype(np.int64))


def _predicted(simulator: Simulator, mean: Array, segments: Segments, run: Run) -> Array:
    """Predictions (R, p), whose steps are counted."""
    before = simulator.steps
    found = simulator.predict(mean[None], segments)[0]
    run.steps += simulator.steps - before
    return found


def _in_units_of_noise(
    objective: LocalLogLikelihood,
    point: Array,
    rows: Ints,
    slopes: Array,
    residual: Array,
    change: Array,
) -> _Change:
    """Slopes (R, p, d), residual and change (R, p) as the likelihood weighs them."""
    columns = np.concatenate([slopes, residual[:, :, None], change[:, :, None]], axis=2)
    weighed = objective.weighed(point, rows, columns)
    flat = weighed.reshape(-1, weighed.shape[2])
    d = slopes.shape[2]
    return _Change(flat[:, :d], flat[:, d], flat[:, d + 1])


def _sentence(
    problem: Problem, fit: Fit, moved: Array, far: Ints, settings: PhysicsStepSettings
) -> str:
    """Which estimates would move, how far, and what to do."""
    sizes = []
    for i in far.tolist():
        parameter = problem.space[problem.space.names[i]]
        unit = f" {parameter.unit}" if parameter.unit else ""
        errors = abs(moved[i]) / fit.mean_se[i]
        sizes.append(f"{parameter.name} by {moved[i]:+.2g}{unit} ({errors:.1f} se)")
    simulator = problem.simulator
    skip = settings.finer * simulator.steps_per_action
    assert simulator.control_step is not None
    step = simulator.control_step / skip
    return (
        f"physics steps of half the length ({1e3 * step:.3g} ms) would move {', '.join(sizes)}:"
        " estimates and intervals hold for the model at its own step. Shorten it, with"
        f' `timestep="{step:.3g}"` in the model and `frame_skip: {skip}` in the problem file'
        " (import a log anew), until nothing moves"
    )
