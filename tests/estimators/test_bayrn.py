"""BayRn: the law of the highest return, when the return is known."""

import numpy as np
import pytest

pytest.importorskip("botorch", reason="needs the extra bo")

from dropo.core.contracts.interactive_estimator import Answer
from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument, MissingPackage
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.bayrn import BayRn, posterior_mean, propose
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.problems.simulated.slide import slide

BEST = np.array([0.3, 0.6, 0.5, 0.7])  # of the unit box of means and scales


def gain(fit):
    """A return that is highest, 100, under one law."""
    unit = TruncatedGaussian(fit.space).unknowns.to_unit(fit.phi)
    return 100 - 100 * float(np.sum((unit - BEST) ** 2))


@pytest.fixture(scope="module")
def fit():
    return BayRn(
        evaluate=lambda fit, rng: Answer(gain(fit) + rng.standard_normal(), 500, 1000),
        first=5,
        budget=16,
    ).fit(slide(), rng=0)


def test_it_finds_the_best_law(fit):
    """Within 4 of the highest return, of which each is known to 1; the best of 16 random laws is
    farther away, in 18 of 20 sets.
    """
    assert 100 - gain(fit) < 4
    random = 100 * ((np.random.default_rng(0).random((20, 16, 4)) - BEST) ** 2).sum(axis=2).min(
        axis=1
    )
    assert (random > 4).sum() >= 18
    assert fit.family == "truncated_gaussian"
    assert fit.status is Status.OUT_OF_BUDGET


def test_the_target_s_cost_is_counted(fit):
    """16 policies were tried: their target transitions, and their training beside the simulations
    that judge the law at the end.
    """
    assert fit.search_record.target_transitions == 16 * 500
    assert fit.simulator_steps == 16 * 1000 + 100 * 1000
    assert fit.search_record.returns.shape == (16,)
    np.testing.assert_array_equal(
        fit.phi, fit.search_record.distributions[fit.search_record.expected.argmax()]
    )


def test_a_lucky_return_does_not_win():
    """Where one of many returns of the same law is far off by chance, the posterior mean is not: it
    is the average of its neighbours.
    """
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [np.full((10, 1), 0.2), np.full((10, 1), 0.8)]
    ) + 0.001 * rng.standard_normal((20, 1))
    returns = np.repeat([0.0, 1.0], 10) + 0.3 * rng.standard_normal(20)
    returns[0] = 2.0
    expected = posterior_mean(points, returns, rng)
    assert returns.argmax() == 0
    assert expected[10:].mean() > expected[0] + 0.2


def test_proposals_are_reproducible_and_leave_torch_alone():
    """The same generator gives the same point whatever torch's stream holds; one far from bad
    returns, inside the box.
    """
    import torch

    points = np.array([[0.1], [0.2], [0.9]])
    returns = np.array([0.0, 0.1, 0.5])
    torch.manual_seed(3)
    before = torch.random.get_rng_state()
    one = propose(points, returns, np.random.default_rng(1))
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.manual_seed(4)
    np.testing.assert_array_equal(one, propose(points, returns, np.random.default_rng(1)))
    assert 0.3 < one[0] <= 1


def test_an_evaluation_log_resumes(tmp_path):
    """The target is not asked again, and the result is the same."""

    def not_again(fit, rng):
        raise AssertionError("asked again")

    settings = {"first": 2, "budget": 3, "draws": 10}
    first, resumed = (
        BayRn(evaluate=evaluate, **settings).fit(
            slide(), rng=0, evaluation_log=EvaluationLog(tmp_path / "j.jsonl")
        )
        for evaluate in (lambda fit, rng: gain(fit), not_again)
    )
    assert first.phi.tolist() == resumed.phi.tolist()


def test_refusals(monkeypatch):
    with pytest.raises(BadArgument, match="'budget' of BayRn must be at least first = 5"):
        BayRn(evaluate=lambda fit, rng: 0.0, budget=4)
    monkeypatch.setattr(
        "dropo.core.services.optional_dependencies.find_spec",
        lambda name: None if name == "botorch" else object(),
    )
    with pytest.raises(MissingPackage) as refusal:
        BayRn(evaluate=lambda fit, rng: 0.0)
    assert (
        str(refusal.value)
        == "Method 'bayrn' needs botorch, which is not installed: pip install 'dropo[bo]'."
    )
