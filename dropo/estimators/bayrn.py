"""BayRn: the distribution whose policy gains most on the target, by Bayesian optimization."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.interactive_estimator import (
    Callbacks,
    Evaluate,
    InteractiveEstimator,
    distribution,
)
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.sobol import sobol_points
from dropo.core.records.fits.fit import Fit, Status, interrupted
from dropo.core.records.fits.search_records import ReturnSearch
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit

SIGNATURE = "(fit, rng) -> float"


@dataclass(frozen=True)
class AcquisitionSettings:
    """How the highest expected improvement is searched.

    Attributes
    ----------
    restarts : int
        So many local searches are made.
    candidates : int
        Their starts are chosen from so many random points.
    """

    restarts: int = 4
    candidates: int = 64


DEFAULTS = AcquisitionSettings()


@dataclass(frozen=True, kw_only=True)
class BayRn(InteractiveEstimator):
    """Bayesian domain randomization: the distribution under which a policy is best trained.

    The unknowns of the distribution (means and scales of `family`, in its box) are searched by
    Bayesian optimization: first a scrambled Sobol set, then the highest expected improvement of a
    Gaussian process of the returns (BoTorch; extra `bo`). The fit is the tried distribution of the
    highest posterior mean, so that a lucky return does not win. It says nothing about the target's
    parameters, only which distribution trained well; the problem's trajectories are not fitted.
    Distributions and returns are in `search_record`.

    Attributes
    ----------
    evaluate : callable
        evaluate(fit, rng) trains a policy under the distribution of `fit` and gives its return on
        the target.
    family : str
        The family of distributions.
    first : int
        Distributions of the Sobol set.
    budget : int
        Distributions in all.
    draws : int
        By which the log-likelihood of the problem's data is estimated.
    acquisition : AcquisitionSettings

    Raises
    ------
    Incompatible
        Without `evaluate`.
    MissingPackage
        If BoTorch is missing.
    BadArgument
        If `evaluate` cannot be called, `first` is below 2, or `budget` is below `first`.

    References
    ----------
    Muratore et al., "Data-efficient domain randomization with Bayesian optimization", 2021,
    arXiv:2003.02471.
    """

    evaluate: Evaluate | None = None
    family: str = "truncated_gaussian"
    first: int = 5
    budget: int = 20
    draws: int = 100
    acquisition: AcquisitionSettings = field(default_factory=AcquisitionSettings)
    name = "bayrn"

    def __post_init__(self) -> None:
        self._check_callback("evaluate", SIGNATURE)
        need("botorch", extra="bo", caller="Method 'bayrn'")
        require(self.first >= 2, "first", "at least 2", self.first, "BayRn")
        rule = f"at least first = {self.first}"
        require(self.budget >= self.first, "budget", rule, self.budget, "BayRn")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Try distributions until the budget is spent, and take the best."""
        family: Family = find("families", self.family)(problem.space)
        calls = Callbacks(run)
        rng = run.rng.spawn(1)[0]
        exponent = int(np.ceil(np.log2(self.first)))
        points = sobol_points(len(family.unknowns), exponent, rng)[: self.first]
        returns: list[float] = []
        status = Status.OUT_OF_BUDGET
        message = f"The best of {self.budget} distributions, by the posterior mean of its return."
        try:
            while len(returns) < self.budget:
                if len(returns) == len(points):
                    following = propose(points, np.array(returns), rng, self.acquisition)
                    points = np.vstack([points, following])
                phi = family.unknowns.from_unit(points[len(returns)])
                returns.append(self._call_evaluate(problem, calls, phi))
                text = f"{len(returns)} distributions, highest return {max(returns):.5g}"
                run.progress(len(returns) / self.budget, text)
        except KeyboardInterrupt:
            if len(returns) < 2:
                raise
            status = Status.INTERRUPTED
            message = interrupted(len(returns), "distributions")

        points = points[: len(returns)]
        expected = posterior_mean(points, np.array(returns), rng)
        distributions = family.unknowns.from_unit(points)
        search = ReturnSearch(
            distributions,
            np.array(returns),
            expected,
            float(expected.max()),
            target_transitions=calls.transitions,
        )
        fit = distribution(
            problem,
            self.name,
            self.family,
            distributions[int(expected.argmax())],
            status=status,
            message=message,
            search_record=search,
        )
        return evaluate_fit(problem, run, fit, self.draws, run.rng.spawn(1)[0])

    def _call_evaluate(self, problem: Problem, calls: Callbacks, phi: Array) -> float:
        """The return of a policy trained under the member phi (m,), counted."""
        assert self.evaluate is not None
        evaluate = self.evaluate
        present = distribution(problem, self.name, self.family, phi)
        return calls.number(phi, lambda rng: evaluate(present, rng))


def propose(
    points: Array,
    returns: Array,
    rng: np.random.Generator,
    settings: AcquisitionSettings = DEFAULTS,
) -> Array:
    """Find the point of the unit box with the highest expected improvement.

    Parameters
    ----------
    points : (n, m) array
        What was tried.
    returns : (n,) array
        Their returns.
    rng : numpy.random.Generator
    settings : AcquisitionSettings

    Returns
    -------
    (m,) array
    """
    import torch
    from botorch.acquisition import LogExpectedImprovement
    from botorch.optim import optimize_acqf

    m = points.shape[1]
    with isolated_torch(int(rng.integers(2**63))):
        model = _make_process(points, returns)
        best = model.posterior(torch.as_tensor(points)).mean.max()
        box = torch.tensor([[0.0] * m, [1.0] * m], dtype=torch.float64)
        candidate, _ = optimize_acqf(
            LogExpectedImprovement(model, best_f=best),
            box,
            q=1,
            num_restarts=settings.restarts,
            raw_samples=settings.candidates,
        )
    return np.clip(candidate[0].numpy(), 0.0, 1.0)


def posterior_mean(points: Array, returns: Array, rng: np.random.Generator) -> Array:
    """Find the mean of a Gaussian process of the returns at the points themselves.

    Parameters
    ----------
    points : (n, m) array
    returns : (n,) array
    rng : numpy.random.Generator

    Returns
    -------
    (n,) array
    """
    import torch

    with isolated_torch(int(rng.integers(2**63))), torch.no_grad():
        with torch.enable_grad():
            model = _make_process(points, returns)
        return np.asarray(model.posterior(torch.as_tensor(points)).mean[:, 0].numpy())


def _make_process(points: Array, returns: Array) -> Any:
    """A Gaussian process with BoTorch's priors, its noise learned, on standardised returns."""
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch.mlls import ExactMarginalLogLikelihood

    # It standardises the returns by itself.
    model = SingleTaskGP(torch.as_tensor(points), torch.as_tensor(returns)[:, None])
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model
