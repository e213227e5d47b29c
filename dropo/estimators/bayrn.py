"""BayRn: the law whose policy gains most on the target, by Bayesian optimization."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.interactive_estimator import (
    Callbacks,
    Evaluate,
    InteractiveEstimator,
    distribution,
)
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.search_records import ReturnSearch
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit

SIGNATURE = "(fit, rng) -> float"
# of the search for the acquisition's highest point: starts, and candidates that they are taken from
RESTARTS = 4
RAW = 64


@dataclass(frozen=True, kw_only=True)
class BayRn(InteractiveEstimator):
    """Bayesian domain randomization: the law under which a policy is to be trained, by its return
    (Muratore et al. 2021, arXiv:2003.02471).

    evaluate(fit, rng) trains a policy under the law of `fit` and gives its return on the target.
    The numbers of the law (means and scales of `family`, in its box) are searched by Bayesian
    optimization: `first` laws from a scrambled Sobol set, then, up to `budget` in all, the highest
    expected improvement of a Gaussian process (BoTorch; extra `bo`). The fit is the tried law of
    the highest posterior mean, so that a lucky return does not win. It says nothing about which
    parameters the target has, only which law trained well. The problem's trajectories are not
    fitted; draws: for their log-likelihood. Distributions tried and returns are in `search_record`.
    """

    evaluate: Evaluate | None = None
    family: str = "truncated_gaussian"
    first: int = 5
    budget: int = 20
    draws: int = 100
    name = "bayrn"

    def __post_init__(self) -> None:
        self._check_callback("evaluate", SIGNATURE)
        need("botorch", extra="bo", caller="Method 'bayrn'")
        require(self.first >= 2, "first", "at least 2", self.first, "BayRn")
        require(
            self.budget >= self.first,
            "budget",
            f"at least first = {self.first}",
            self.budget,
            "BayRn",
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        family: Family = find("families", self.family)(problem.space)
        calls = Callbacks(run)
        rng = run.rng.spawn(1)[0]
        points = qmc.Sobol(len(family.unknowns), rng=rng).random_base2(
            int(np.ceil(np.log2(self.first)))
        )[: self.first]
        returns: list[float] = []
        status = Status.OUT_OF_BUDGET
        message = f"The best of {self.budget} laws, by the posterior mean of its return."
        try:
            while len(returns) < self.budget:
                if len(returns) == len(points):
                    points = np.vstack([points, propose(points, np.array(returns), rng)])
                returns.append(
                    self._return(problem, calls, family.unknowns.from_unit(points[len(returns)]))
                )
                run.progress(
                    len(returns) / self.budget,
                    f"{len(returns)} laws, highest return {max(returns):.5g}",
                )
        except KeyboardInterrupt:
            if len(returns) < 2:
                raise
            status = Status.INTERRUPTED
            message = f"Interrupted after {len(returns)} laws: this is the best so far."
        points = points[: len(returns)]
        expected = posterior_mean(points, np.array(returns), rng)
        distributions = family.unknowns.from_unit(points)
        fit = distribution(
            problem,
            self.name,
            self.family,
            distributions[int(expected.argmax())],
            status=status,
            message=message,
            search_record=ReturnSearch(
                distributions,
                np.array(returns),
                expected,
                float(expected.max()),
                target_transitions=calls.transitions,
            ),
        )
        return evaluate_fit(problem, run, fit, self.draws, run.rng.spawn(1)[0])

    def _return(self, problem: Problem, calls: Callbacks, phi: Array) -> float:
        assert self.evaluate is not None
        evaluate = self.evaluate
        present = distribution(problem, self.name, self.family, phi)
        return calls.number(phi, lambda rng: evaluate(present, rng))


def propose(points: Array, returns: Array, rng: np.random.Generator) -> Array:
    """(m,) the point of the unit box with the highest expected improvement, given points (n, m) and
    their returns (n,).
    """
    import torch
    from botorch.acquisition import LogExpectedImprovement
    from botorch.optim import optimize_acqf

    m = points.shape[1]
    with isolated_torch(int(rng.integers(2**63))):
        model = _process(points, returns)
        best = model.posterior(torch.as_tensor(points)).mean.max()
        box = torch.tensor([[0.0] * m, [1.0] * m], dtype=torch.float64)
        candidate, _ = optimize_acqf(
            LogExpectedImprovement(model, best_f=best),
            box,
            q=1,
            num_restarts=RESTARTS,
            raw_samples=RAW,
        )
    return np.clip(candidate[0].numpy(), 0.0, 1.0)


def posterior_mean(points: Array, returns: Array, rng: np.random.Generator) -> Array:
    """(n,) of the return at points (n, m), by the Gaussian process of their returns (n,)."""
    import torch

    with isolated_torch(int(rng.integers(2**63))), torch.no_grad():
        with torch.enable_grad():
            model = _process(points, returns)
        return np.asarray(model.posterior(torch.as_tensor(points)).mean[:, 0].numpy())


def _process(points: Array, returns: Array):  # type: ignore[no-untyped-def]
    """A Gaussian process with BoTorch's priors, its noise learned, on standardised returns."""
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch.mlls import ExactMarginalLogLikelihood

    model = SingleTaskGP(
        torch.as_tensor(points), torch.as_tensor(returns)[:, None]
    )  # standardises by itself
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model
