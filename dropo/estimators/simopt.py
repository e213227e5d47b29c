"""SimOpt: a Gaussian that moves towards target data which the present policy collects."""

from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.interactive_estimator import (
    Callbacks,
    Collect,
    InteractiveEstimator,
    distribution,
    joined,
)
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import GaussianHistory
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit
from dropo.estimators.support.summary import at_bounds, with_model_check

SIGNATURE = "(fit, rng) -> Trajectories"

Gaussian = tuple[Array, Array]
"""Mean (d,) and covariance (d, d)."""


@dataclass(frozen=True)
class TemperatureSettings:
    """Which temperatures of the weights are tried, from the hottest down.

    Attributes
    ----------
    lowest : float
        The coldest temperature, in units of the standard deviation of the costs.
    highest : float
        The hottest one, in the same units.
    count : int
        So many are tried, with equal ratios.
    """

    lowest: float = 1e-6
    highest: float = 1e6
    count: int = 241


DEFAULTS = TemperatureSettings()


@dataclass(frozen=True, kw_only=True)
class SimOpt(InteractiveEstimator):
    """Move a Gaussian over the parameters so that simulated motion comes near the target's.

    In each iteration, a policy trained under the present Gaussian collects data on the target. Then
    the Gaussian is updated: parameter vectors are drawn from it, and it becomes the Gaussian with
    their moments, weighted by exp(-D / eta) with D the discrepancy of each, as in relative entropy
    policy search [2]_. eta is the least whose Gaussian is within the bound of the divergence.

    Attributes
    ----------
    collect : callable
        collect(fit, rng) trains a policy under the present distribution and brings data that it
        collected on the target.
    iterations : int
        Collections of data.
    updates : int
        Updates after each.
    samples : int
        Parameter vectors in each update; at least 4 for each parameter.
    bound : float
        Largest Kullback-Leibler divergence of the new Gaussian from the old one [nats].
    l1, l2 : float
        Weights of the discrepancy D = l1 sum |e| + l2 sum e^2 on average over the rows, with e
        prediction - measurement, each signal divided by its root mean square error under the first
        mean.
    spread : float
        Standard deviations of the first Gaussian, as a fraction of each interval; its mean is the
        middle of the box.
    draws : int
        By which the log-likelihood is estimated.
    temperatures : TemperatureSettings

    Raises
    ------
    Incompatible
        Without `collect`.
    BadArgument
        If `collect` cannot be called, `iterations` or `updates` is below 1, `bound` is not above 0,
        a weight is negative or both are 0, or `spread` is not in (0, 0.5]; by `fit`, if there are
        fewer than 4 samples for each parameter.

    Notes
    -----
    The simulator replays the collected actions over segments as the problem cuts them, where the
    paper runs the policy itself for whole episodes. The problem's own trajectories say what is
    measured, and are not fitted.

    References
    ----------
    .. [1] Chebotar et al., "Closing the sim-to-real loop", 2019, arXiv:1810.05687.
    .. [2] Peters, Muelling, Altun, "Relative entropy policy search", AAAI 2010.
    """

    collect: Collect | None = None
    iterations: int = 5
    updates: int = 5
    samples: int = 100
    bound: float = 1.0
    l1: float = 1.0
    l2: float = 1.0
    spread: float = 0.25
    draws: int = 100
    temperatures: TemperatureSettings = field(default_factory=TemperatureSettings)
    name = "simopt"

    def __post_init__(self) -> None:
        self._check_callback("collect", SIGNATURE)
        counts = (self.iterations, self.updates)
        require(min(counts) >= 1, "iterations, updates", "at least 1", counts, "SimOpt")
        require(self.bound > 0, "bound", "above 0 nats", self.bound, "SimOpt")
        weights = (self.l1, self.l2)
        positive = min(weights) >= 0 < sum(weights)
        require(positive, "l1, l2", "not negative, one above 0", weights, "SimOpt")
        require(0 < self.spread <= 0.5, "spread", "in (0, 0.5]", self.spread, "SimOpt")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Collect and update in turn."""
        space = problem.space
        d = len(space)
        rule = f"at least {4 * d}, four a parameter"
        require(self.samples >= 4 * d, "samples", rule, self.samples, "SimOpt")
        family = find("families", "full")(space)
        calls = Callbacks(run)
        mean = (space.low + space.high) / 2
        covariance = np.diag((self.spread * (space.high - space.low)) ** 2)
        phi = family.phi_of(mean, covariance)
        means = [mean]
        covariances = [covariance]
        collected: list[Trajectories] = []
        size = None
        status = Status.DONE
        message = f"All {self.iterations} iterations were made."
        try:
            for iteration in range(self.iterations):
                # Collect data under the present Gaussian; the first sets the scale of errors.
                data = self._call_collect(problem, calls, phi)
                collected.append(data)
                segments = problem.cut(data)
                if size is None:
                    size = _error_scale(problem, run, segments, mean)

                # Move the Gaussian towards them.
                for update in range(self.updates):
                    values = family.sample(phi, self.samples, run.rng.spawn(1)[0])
                    costs = self._costs(problem, run, segments, values, size)
                    present = (mean, covariance)
                    mean, covariance = step(present, values, costs, self.bound, self.temperatures)
                    phi = family.phi_of(mean, covariance)
                    means.append(mean)
                    covariances.append(covariance)
                    done = (iteration + (update + 1) / self.updates) / self.iterations
                    text = f"iteration {iteration + 1}, least discrepancy {np.min(costs):.4g}"
                    run.progress(done, text)
        except KeyboardInterrupt:
            if not collected:
                raise
            status = Status.INTERRUPTED
            message = (
                f"Interrupted after {len(means) - 1} updates: this is the distribution so far."
            )

        whole = replace(problem, trajectories=joined(collected), everything=None)
        history = GaussianHistory(
            np.array(means), np.array(covariances), target_transitions=calls.transitions
        )
        fit = distribution(
            whole,
            self.name,
            "full",
            phi,
            status=status,
            message=message,
            warnings=tuple(at_bounds(family.unknowns, phi)),
            search_record=history,
        )
        fit = evaluate_fit(whole, run, fit, self.draws, run.rng.spawn(1)[0])
        return with_model_check(whole, run, fit)

    def _call_collect(self, problem: Problem, calls: Callbacks, phi: Array) -> Trajectories:
        """The data of a policy trained under the member phi (m,), counted."""
        assert self.collect is not None
        collect = self.collect
        present = distribution(problem, self.name, "full", phi)
        return calls.data(phi, lambda rng: collect(present, rng))

    def _costs(
        self, problem: Problem, run: Run, segments: Segments, values: Array, size: Array
    ) -> Array:
        """(K,) discrepancies under values (K, d); infinite if a simulation failed."""
        targets = problem.simulator.targets(segments)

        def minus_discrepancy(values: Array) -> Array:
            errors = np.abs(problem.simulator.predict(values, segments) - targets) / size
            return -(self.l1 * errors + self.l2 * errors**2).sum(axis=2).mean(axis=1)

        costs = -run.evaluate(values, minus_discrepancy)
        if not np.isfinite(costs).any():
            raise SimulationFailed(
                "All simulations under SimOpt's distribution diverged: narrow the bounds, or take"
                " a smaller spread."
            )
        return np.where(np.isfinite(costs), costs, np.inf)


def _error_scale(problem: Problem, run: Run, segments: Segments, mean: Array) -> Array:
    """(p,) each signal's root mean square error under the mean (d,), never 0."""
    targets = problem.simulator.targets(segments)
    with run.counting(evaluations=1):
        errors = problem.simulator.predict(mean[None], segments)[0] - targets
    if not np.isfinite(errors).all():
        raise SimulationFailed(
            "A simulation in the middle of the box diverged, where SimOpt begins: narrow the"
            " bounds."
        )
    lowest = np.maximum(1e-24 * np.mean(targets**2, axis=0), 1e-300)
    return np.sqrt(np.maximum(np.mean(errors**2, axis=0), lowest))


def step(
    before: Gaussian,
    values: Array,
    costs: Array,
    bound: float,
    settings: TemperatureSettings = DEFAULTS,
) -> Gaussian:
    """Find the next Gaussian from samples of the one before and their costs.

    The hottest temperature weights all samples almost equally; from there the temperature falls
    while the divergence stays within the bound.

    Parameters
    ----------
    before : ((d,) array, (d, d) array)
        Mean and covariance.
    values : (K, d) array
        Samples.
    costs : (K,) array
        Infinite ones have no weight.
    bound : float
        Of the Kullback-Leibler divergence [nats].
    settings : TemperatureSettings

    Returns
    -------
    ((d,) array, (d, d) array)
        Mean and covariance; those before if no temperature keeps the bound.
    """
    finite = costs[np.isfinite(costs)]
    spread = max(float(np.std(finite)), 1e-300)
    temperatures = np.geomspace(settings.lowest, settings.highest, settings.count)
    found = before
    for eta in temperatures[::-1] * spread:
        weights = np.exp(-(costs - finite.min()) / eta)
        moments = _moments(values, weights / weights.sum())
        if not divergence(moments, before) <= bound:
            break
        found = moments
    return found


def _moments(values: Array, weights: Array) -> Gaussian:
    """Mean and covariance of weighted samples."""
    mean = weights @ values
    return mean, (values - mean).T @ ((values - mean) * weights[:, None])


def divergence(after: Gaussian, before: Gaussian) -> float:
    """Find the Kullback-Leibler divergence of one Gaussian from another.

    Parameters
    ----------
    after, before : ((d,) array, (d, d) array)
        Mean and covariance.

    Returns
    -------
    float
        KL(after || before) [nats]; infinite if the first is degenerate.
    """
    mean, covariance = after
    old_mean, old_covariance = before
    root = np.linalg.cholesky(old_covariance)
    shift = np.linalg.solve(root, mean - old_mean)
    inner = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    sign, logarithm = np.linalg.slogdet(inner)
    if sign <= 0:
        return np.inf
    return float(0.5 * (np.trace(inner) + shift @ shift - len(mean) - logarithm))
