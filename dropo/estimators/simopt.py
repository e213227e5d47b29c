"""SimOpt: a Gaussian over the parameters, moved towards target data that the present policy
collects.
"""

from dataclasses import dataclass, replace

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
from dropo.core.records.fit import Fit, Status
from dropo.core.records.search_records import GaussianHistory
from dropo.core.records.trajectories import Segments, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit
from dropo.estimators.support.summary import at_bounds

TEMPERATURES = np.geomspace(1e-6, 1e6, 241)  # eta, in units of the costs' spread
SIGNATURE = "(fit, rng) -> Trajectories"


@dataclass(frozen=True, kw_only=True)
class SimOpt(InteractiveEstimator):
    """Moves a Gaussian over the parameters so that simulated motion comes near the target's
    (Chebotar et al. 2019, arXiv:1810.05687).

    In each of `iterations`, collect(fit, rng) trains a policy under the present law and brings data
    that it collected on the target. Then `updates` times: `samples` parameter vectors are drawn
    from the law, each costs the discrepancy D = `l1` sum |e| + `l2` sum e^2 on average over the
    rows, and the law becomes the Gaussian with the moments of the samples weighted by exp(-D /
    eta), as in relative entropy policy search (Peters, Muelling, Altun 2010); eta is the least
    whose Gaussian has a Kullback-Leibler divergence from the one before of at most `bound` [nats].
    e is prediction - measurement, each signal divided by its root mean square under the first law's
    mean. The first law has its mean in the middle of the box and standard deviations of `spread` of
    each interval.

    The simulator replays the collected actions over segments as the problem cuts them, where the
    paper runs the policy itself for whole episodes. The problem's own trajectories say what is
    measured, and are not fitted. draws: for the log-likelihood.
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
    name = "simopt"

    def __post_init__(self) -> None:
        self._check_callback("collect", SIGNATURE)
        require(
            min(self.iterations, self.updates) >= 1,
            "iterations, updates",
            "at least 1",
            (self.iterations, self.updates),
            "SimOpt",
        )
        require(self.bound > 0, "bound", "above 0 nats", self.bound, "SimOpt")
        require(
            min(self.l1, self.l2) >= 0 < self.l1 + self.l2,
            "l1, l2",
            "not negative, one above 0",
            (self.l1, self.l2),
            "SimOpt",
        )
        require(0 < self.spread <= 0.5, "spread", "in (0, 0.5]", self.spread, "SimOpt")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        d = len(problem.space)
        require(
            self.samples >= 4 * d,
            "samples",
            f"at least {4 * d}, four a parameter",
            self.samples,
            "SimOpt",
        )
        family = find("families", "full")(problem.space)
        calls = Callbacks(run)
        mean = (problem.space.low + problem.space.high) / 2
        covariance = np.diag((self.spread * (problem.space.high - problem.space.low)) ** 2)
        phi = family.phi_of(mean, covariance)
        means = [mean]
        covariances = [covariance]
        seen = list[Trajectories]()
        status = Status.DONE
        message = f"All {self.iterations} iterations were made."
        size = None
        try:
            for iteration in range(self.iterations):
                data = self._collect(problem, calls, phi)
                seen.append(data)
                segments = problem.cut(data)
                size = _size(problem, run, segments, mean) if size is None else size
                for update in range(self.updates):
                    values = family.sample(phi, self.samples, run.rng.spawn(1)[0])
                    costs = self._costs(problem, run, segments, values, size)
                    mean, covariance = step((mean, covariance), values, costs, self.bound)
                    phi = family.phi_of(mean, covariance)
                    means.append(mean)
                    covariances.append(covariance)
                    done = (iteration + (update + 1) / self.updates) / self.iterations
                    run.progress(
                        done, f"iteration {iteration + 1}, least discrepancy {np.min(costs):.4g}"
                    )
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
            message = f"Interrupted after {len(means) - 1} updates: this is the law so far."
            if not seen:
                raise
        everything = replace(problem, trajectories=joined(seen), everything=None)
        fit = distribution(
            everything,
            self.name,
            "full",
            phi,
            status=status,
            message=message,
            warnings=tuple(at_bounds(family.unknowns, phi)),
            search_record=GaussianHistory(
                np.array(means), np.array(covariances), target_transitions=calls.transitions
            ),
        )
        return evaluate_fit(everything, run, fit, self.draws, run.rng.spawn(1)[0])

    def _collect(self, problem: Problem, calls: Callbacks, phi: Array) -> Trajectories:
        assert self.collect is not None
        collect = self.collect
        present = distribution(problem, self.name, "full", phi)
        return calls.data(phi, lambda rng: collect(present, rng))

    def _costs(
        self, problem: Problem, run: Run, segments: Segments, values: Array, size: Array
    ) -> Array:
        """(K,) the discrepancy under each of the values (K, d); infinite where a simulation failed."""
        targets = problem.simulator.targets(segments)

        def minus_discrepancy(values: Array) -> Array:
            errors = np.abs(problem.simulator.predict(values, segments) - targets) / size
            return -(self.l1 * errors + self.l2 * errors**2).sum(axis=2).mean(axis=1)

        costs = -run.evaluate(values, minus_discrepancy)
        if not np.isfinite(costs).any():
            raise SimulationFailed(
                "All simulations under SimOpt's law diverged: narrow the bounds, or take a "
                "smaller spread."
            )
        return np.where(np.isfinite(costs), costs, np.inf)


def _size(problem: Problem, run: Run, segments: Segments, mean: Array) -> Array:
    """(p,) each signal's root mean square error under the mean, kept off 0."""
    targets = problem.simulator.targets(segments)
    with run.counting(evaluations=1):
        errors = problem.simulator.predict(mean[None], segments)[0] - targets
    if not np.isfinite(errors).all():
        raise SimulationFailed(
            "A simulation in the middle of the box diverged, where SimOpt begins: narrow "
            "the bounds."
        )
    return np.sqrt(
        np.maximum(
            np.mean(errors**2, axis=0), np.maximum(1e-24 * np.mean(targets**2, axis=0), 1e-300)
        )
    )


def step(
    before: tuple[Array, Array], values: Array, costs: Array, bound: float
) -> tuple[Array, Array]:
    """The next mean (d,) and covariance (d, d), from samples (K, d) of the law before and their
    costs (K,); the same law, where none fits.

    The hottest of `TEMPERATURES` is nearly the samples' own moments; from there the temperature
    falls while the bound holds.
    """
    finite = costs[np.isfinite(costs)]
    spread = max(float(np.std(finite)), 1e-300)
    found = before
    for eta in TEMPERATURES[::-1] * spread:
        weights = np.exp(-(costs - finite.min()) / eta)
        moments = _moments(values, weights / weights.sum())
        if not divergence(moments, before) <= bound:
            break
        found = moments
    return found


def _moments(values: Array, weights: Array) -> tuple[Array, Array]:
    mean = weights @ values
    return mean, (values - mean).T @ ((values - mean) * weights[:, None])


def divergence(after: tuple[Array, Array], before: tuple[Array, Array]) -> float:
    """KL(after || before) of two Gaussians, each a mean (d,) and covariance (d, d) [nats]; infinite
    where the first is degenerate.
    """
    (mean, covariance), (old, wide) = after, before
    root = np.linalg.cholesky(wide)
    shift = np.linalg.solve(root, mean - old)
    inner = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    sign, logarithm = np.linalg.slogdet(inner)
    return (
        float(0.5 * (np.trace(inner) + shift @ shift - len(mean) - logarithm))
        if sign > 0
        else np.inf
    )
