"""Neural posterior estimation against the conjugate posterior of a linear simulator."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("sbi", reason="needs the extra sbi")

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument, MissingPackage, UnknownName
from dropo.estimators import npe
from dropo.estimators.npe import NPE
from dropo.simulators.toy import LinearSimulator, simulate

TRUTH = np.array([1.5, -0.7])
NOISE = 0.04
MATRICES = np.array([[[1.0, 0.5], [0.0, 1.0]]])


def problem(**settings):
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(MATRICES)
    data = simulate(
        simulator,
        np.tile(TRUTH, (30, 1)),
        rng.uniform(0.5, 1.5, (30, 1, 1)),
        np.zeros(2),
        noise_variance=NOISE,
        rng=rng,
    )
    return Problem("line", simulator, data, **settings)


def conjugate(problem):
    design = np.concatenate([a * MATRICES[0] for a in problem.trajectories.actions[:, 0]])
    change = (problem.trajectories.next_observations - problem.trajectories.observations).ravel()
    covariance = np.linalg.inv(design.T @ design / NOISE)
    return covariance @ (design.T @ change / NOISE), covariance


@pytest.fixture(scope="module")
def fit():
    return NPE(simulations=200, draws=500).fit(problem(epsilon=NOISE), rng=0)


def test_the_posterior_is_near_the_conjugate_one(fit):
    """A network of 200 simulations a round is worth: the mean within half a standard deviation, the
    spread within a third, the sign of the correlation. A mean two deviations away fails, and so
    does a spread three times as large.
    """
    mean, covariance = conjugate(problem())
    sd = np.sqrt(np.diagonal(covariance))
    near = lambda found, spread: (
        (np.abs(found - mean) < 0.5 * sd).all()
        and (np.abs(np.log(spread / sd)) < np.log(1.5)).all()
    )
    assert near(fit.mean, fit.sd)
    assert not near(fit.mean + 2 * sd, fit.sd)
    assert not near(fit.mean, 3 * fit.sd)
    assert fit.correlation[0, 1] < -0.2  # -0.45 in truth
    assert fit.status is Status.CONVERGED
    assert fit.search_record.draws.shape == (500, 2)


def test_boxes_close_in(fit):
    """Each round's box lies in the one before and holds the truth; the last is a hundredth of the
    first.
    """
    boxes = fit.search_record.boxes
    assert (boxes[1:, 0] >= boxes[:-1, 0]).all()
    assert (boxes[1:, 1] <= boxes[:-1, 1]).all()
    assert ((boxes[:, 0] < TRUTH) & (boxes[:, 1] > TRUTH)).all()
    assert np.prod(boxes[-1, 1] - boxes[-1, 0]) < 0.01 * np.prod(boxes[0, 1] - boxes[0, 0])


def test_one_round_is_not_enough(fit):
    """The control of the rounds: from the whole box the posterior's area is more than five times as
    large (10 to 140 times for twelve seeds), and the fit says that it is not done. Also with the
    summary of BayesSim, and a flow; the problem's prior weighs the draws.
    """
    one = NPE(simulations=100, rounds=1, summary="moments", density="maf", draws=500).fit(
        problem(epsilon=NOISE, priors={"x0": "normal(1, 0.3)"}), rng=0
    )
    assert one.status is Status.OUT_OF_BUDGET
    assert (
        one.message
        == "1 rounds of 100 simulations; each cut the box: take more of them, or more simulations."
    )
    assert np.prod(one.sd) > 5 * np.prod(fit.sd)
    assert one.simulator_steps < fit.simulator_steps / 3
    assert one.sd[0] < 0.5


def test_learning_leaves_nothing_behind(tmp_path, monkeypatch, capsys):
    """The same seed gives the same draws whatever torch's stream holds, which goes on as if nothing
    had been; another seed others. Nothing is printed, and no file is written.
    """
    import torch

    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    points = rng.random((60, 1))
    summaries = points + 0.1 * rng.standard_normal((60, 1))
    torch.manual_seed(3)
    before = torch.random.get_rng_state()
    one = npe.learn(points, summaries, np.array([0.5]), "mdn", 100, seed=7)
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.manual_seed(4)
    same, other = (
        npe.learn(points, summaries, np.array([0.5]), "mdn", 100, seed=seed) for seed in (7, 8)
    )
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []


def test_slopes_are_the_estimate_of_least_squares():
    """Where the simulator is linear, the summary of the measurements is the least-squares estimate,
    in fractions of the box.
    """
    from dropo.core.contracts.estimator import Run
    from dropo.estimators.support.posterior_targets import PointLikelihood

    one = problem(epsilon=NOISE)
    target = PointLikelihood(one, NOISE)
    box = np.array([[0.0, 0.0], [1.0, 1.0]])
    run = Run(one, np.random.default_rng(0))
    summarize = npe._summarize_by_slopes(one, run, target, box, 0.01)
    np.testing.assert_allclose(
        20 * summarize(target.targets[None])[0], conjugate(one)[0], rtol=1e-9
    )
    moved = target.targets + 0.1
    assert np.abs(20 * summarize(moved[None])[0] - conjugate(one)[0]).max() > 0.01


def test_a_box_without_the_truth_ends_on_its_bound():
    """Of 1.5, in a box from 2 whose standard errors are 0.02: the fit ends, and says where."""
    simulator = LinearSimulator(MATRICES, low=2.0, high=4.0)
    narrow = replace(problem(epsilon=NOISE), simulator=simulator)
    fit = NPE(simulations=100, rounds=2, draws=200).fit(narrow, rng=0)
    assert any(" ends on its lower bound 2" in text for text in fit.warnings)


def test_refusals(monkeypatch):
    with pytest.raises(UnknownName, match="No density called 'made'"):
        NPE(density="made")
    with pytest.raises(BadArgument, match="'simulations' of NPE must be at least 50"):
        NPE(simulations=49)
    monkeypatch.setattr(
        "dropo.core.services.optional_dependencies.find_spec",
        lambda name: None if name == "sbi" else object(),
    )
    with pytest.raises(MissingPackage) as refusal:
        NPE()
    assert (
        str(refusal.value)
        == "Method 'npe' needs sbi, which is not installed: pip install 'dropo[sbi]'."
    )
