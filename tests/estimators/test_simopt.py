"""SimOpt against the Gaussian's closed form, and on a linear simulator whose truth is known."""

from itertools import pairwise

import numpy as np
import pytest

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.simopt import SimOpt, divergence, step
from dropo.simulators.toy import LinearSimulator, simulate

TRUTH = np.array([1.5, -0.7])
NOISE = 0.04
SIMULATOR = LinearSimulator(np.array([[[1.0, 0.5], [0.0, 1.0]]]))


def data(rng, truth=TRUTH, rows=30):
    actions = rng.uniform(0.5, 1.5, (rows, 1, 1))
    return simulate(
        SIMULATOR, np.tile(truth, (rows, 1)), actions, np.zeros(2), noise_variance=NOISE, rng=rng
    )


def problem():
    return Problem("line", SIMULATOR, data(np.random.default_rng(5)), epsilon=NOISE)


def test_a_step_is_that_of_the_closed_form():
    """Of a quadratic cost the weighted law is N(m, C): C^-1 = P + 2 A / eta, m = C (P mu + 2 A best
    / eta). At the eta where its divergence is the bound, the mean of 40,000 samples is within
    4.5 standard errors; with half the bound it is not.
    """
    rng = np.random.default_rng(0)
    mu = np.array([1.0, 0.0])
    precision = np.diag([1.0, 4.0])
    best = np.array([0.0, 0.4])
    curvature = np.array([[2.0, 0.5], [0.5, 1.0]])
    before = mu, np.linalg.inv(precision)
    values = rng.multivariate_normal(*before, 40_000)
    costs = np.einsum("ki,ij,kj->k", values - best, curvature, values - best)
    mean, covariance = step(before, values, costs, 0.5)

    def exact(eta):
        wide = np.linalg.inv(precision + 2 * curvature / eta)
        return wide @ (precision @ mu + 2 * curvature @ best / eta), wide

    grid = [exact(eta) for eta in np.geomspace(0.1, 100, 4001)]
    near = lambda bound: min(
        grid, key=lambda distribution: abs(divergence(distribution, before) - bound)
    )
    found = min(
        grid,
        key=lambda distribution: abs(
            divergence(distribution, before) - divergence((mean, covariance), before)
        ),
    )
    error = np.sqrt(np.diagonal(covariance) / 4_000)  # at least a tenth of the samples count
    assert (np.abs(mean - found[0]) < 4.5 * error).all()
    assert (np.abs(mean - near(0.25)[0]) > 4.5 * error).any()
    assert divergence((mean, covariance), before) == pytest.approx(
        0.5, rel=0.15
    )  # the temperatures are a grid
    assert divergence((mean, covariance), before) <= 0.5


def test_divergence_of_gaussians():
    """Known in one dimension: log(s / t) + (t^2 + m^2) / (2 s^2) - 1/2; 0 of itself, infinite of a
    degenerate one.
    """
    one = (np.array([0.5]), np.array([[0.25]])), (np.array([0.0]), np.array([[1.0]]))
    assert divergence(*one) == pytest.approx(np.log(2) + (0.25 + 0.25) / 2 - 0.5)
    assert divergence(one[1], one[1]) == pytest.approx(0, abs=1e-12)
    assert divergence((np.zeros(2), np.diag([1.0, 0.0])), (np.zeros(2), np.eye(2))) == np.inf


def test_every_update_keeps_the_bound():
    """The divergence of each law from the one before it is at most `bound`; of one that is four
    times as large, it is not.
    """
    for bound, kept in ((0.3, True), (1.2, False)):
        fit = SimOpt(collect=lambda fit, rng: data(rng), iterations=1, updates=3, bound=bound).fit(
            problem()
        )
        distributions = list(
            zip(fit.search_record.means, fit.search_record.covariances, strict=True)
        )
        assert len(distributions) == 4
        assert (
            max(divergence(distributions[i + 1], distributions[i]) for i in range(3)) <= 0.3
        ) is kept


def test_it_goes_where_the_target_is():
    """Within 0.1 (2.5 standard deviations of what 120 rows tell) of the target's parameters,
    whichever those are, not of others; with a bound that lets it move less, it is still on its
    way.
    """
    for truth in (TRUTH, -TRUTH):
        fit = SimOpt(collect=lambda fit, rng, truth=truth: data(rng, truth), iterations=4).fit(
            problem(), rng=1
        )
        assert np.abs(fit.mean - truth).max() < 0.1
        assert np.abs(fit.mean + truth).max() > 0.1
        assert (fit.transitions, fit.search_record.target_transitions) == (120, 120)
        assert fit.objective_evaluations == 4 + 1 + 4 * 5 * 100 + 2
    slow = SimOpt(collect=lambda fit, rng: data(rng), iterations=2, updates=2, bound=0.05).fit(
        problem(), rng=1
    )
    assert np.abs(slow.mean - TRUTH).max() > 0.1


def test_the_callback_gets_the_present_law():
    """The first one is in the middle of the box, the next ones narrower and nearer; policies can be
    trained under them.
    """
    seen = []

    def collect(fit, rng):
        seen.append(fit)
        assert fit.sample(3, rng).shape == (3, 2)
        return data(rng)

    SimOpt(collect=collect, iterations=3).fit(problem())
    np.testing.assert_allclose(seen[0].mean, 0, atol=1e-12)
    np.testing.assert_allclose(seen[0].sd, 5)
    assert all((later.sd < earlier.sd).all() for earlier, later in pairwise(seen))


def test_same_seed_same_fit_and_an_evaluation_log_that_resumes(tmp_path):
    """Taken up from its evaluation log, a run gives the same without asking the target; another
    seed gives another law.
    """

    def not_again(fit, rng):
        raise AssertionError("asked again")

    settings = {"iterations": 2, "updates": 2, "samples": 20}
    fits = [
        SimOpt(collect=lambda fit, rng: data(rng), **settings).fit(problem(), rng=seed)
        for seed in (1, 1, 2)
    ]
    assert fits[0].mean.tolist() == fits[1].mean.tolist() != fits[2].mean.tolist()
    whole = SimOpt(collect=lambda fit, rng: data(rng), **settings).fit(
        problem(), rng=1, evaluation_log=EvaluationLog(tmp_path / "j.jsonl")
    )
    resumed = SimOpt(collect=not_again, **settings).fit(
        problem(), rng=1, evaluation_log=EvaluationLog(tmp_path / "j.jsonl")
    )
    assert whole.mean.tolist() == resumed.mean.tolist() == fits[0].mean.tolist()
    assert resumed.search_record.target_transitions == 60


def test_interrupted_it_keeps_its_law():
    """The distribution so far; before any data there is none."""

    def once(fit, rng, asked=[]):  # noqa: B006
        if asked:
            raise KeyboardInterrupt
        asked.append(1)
        return data(rng)

    fit = SimOpt(collect=once).fit(problem())
    assert fit.status is Status.INTERRUPTED
    assert fit.message == "Interrupted after 5 updates: this is the distribution so far."


def test_refusals():
    collect = lambda fit, rng: data(rng)
    assert issubclass(SimOpt, Estimator)
    with pytest.raises(
        BadArgument, match="'samples' of SimOpt must be at least 8, four a parameter"
    ):
        SimOpt(collect=collect, samples=7).fit(problem())
    with pytest.raises(BadArgument, match="'bound' of SimOpt must be above 0 nats"):
        SimOpt(collect=collect, bound=0.0)
    with pytest.raises(BadArgument, match="'l1, l2' of SimOpt must be"):
        SimOpt(collect=collect, l1=0.0, l2=0.0)
