"""Tests of estimators: right ones pass at their level, controls are rejected."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.simulated.slide import slide
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.testing import (
    check_estimator,
    coverage,
    expected_coverage,
    simulation_based_calibration,
)
from dropo.testing.statistics import posterior_draws, rank_band, ranks, uniformity

SURE = 1e-3
"""Below this p-value a control counts as rejected."""


def draw(rng):
    """Two numbers from their prior N(0, 1), each measured once with noise of variance 1."""
    truth = rng.standard_normal(2)
    return truth + rng.standard_normal(2), truth


@dataclass(frozen=True)
class Conjugate:
    """The exact posterior N(y / 2, 1 / 2), moved by a bias, its spread by a factor."""

    bias: float = 0.0
    factor: float = 1.0

    def fit(self, problem, rng):
        sd = self.factor * np.sqrt(0.5)
        mean = problem / 2 + self.bias
        return SimpleNamespace(mean=mean, sd=sd, draws=rng.normal(mean, sd, (200, 2)))


def interval(fit, level):
    """Of the posterior."""
    half = {0.95: 1.959964, 0.5: 0.674490}[level] * fit.sd
    return np.stack([fit.mean - half, fit.mean + half], axis=1)


def drawn(fit):
    return fit.draws


def cover(estimator, rng=0, replications=400):
    return coverage(estimator, draw, intervals=interval, rng=rng, replications=replications)


def rank(estimator, rng=0, replications=400):
    return simulation_based_calibration(
        estimator, draw, draws=drawn, rng=rng, replications=replications
    )


def test_intervals_that_are_right_pass_and_others_do_not():
    """95 % within three standard errors; 20 % too narrow, and biased by a standard deviation, are
    rejected.
    """
    right = cover(Conjugate())
    assert abs(right.rates.mean() - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 800)
    assert right.p_value > 0.01
    assert cover(Conjugate(factor=0.8)).p_value < SURE
    assert cover(Conjugate(bias=0.7)).p_value < SURE
    assert str(right).startswith("coverage of 95% intervals, 400 replications")


def test_posteriors_that_are_right_pass_and_others_do_not():
    """Half the spread, and a bias of half a standard deviation, are rejected by both tests."""
    for controls in (Conjugate(factor=0.5), Conjugate(bias=0.35)):
        assert rank(controls).p_value < SURE
        found = expected_coverage(controls, draw, draws=drawn, replications=400)
        assert found.p_value < (SURE if controls.factor == 0.5 else 0.5)
    assert rank(Conjugate()).p_value > 0.01
    assert expected_coverage(Conjugate(), draw, draws=drawn, replications=400).p_value > 0.01


def test_right_ones_are_rejected_at_the_nominal_rate():
    """Over 100 repeats of each test, 5 % have p < 0.05, within three standard errors above."""
    repeats = 100
    most = 0.05 + 3 * np.sqrt(0.05 * 0.95 / repeats)
    small = [
        [
            cover(Conjugate(), seed, 60).p_value,
            rank(Conjugate(), seed, 60).p_value,
            expected_coverage(Conjugate(), draw, draws=drawn, replications=60, rng=seed).p_value,
        ]
        for seed in range(repeats)
    ]
    assert (np.mean(np.array(small) < 0.05, axis=0) <= most).all()


def test_results_do_not_depend_on_where_replications_run():
    with ThreadPoolExecutor(3) as executor:
        spread = coverage(Conjugate(), draw, intervals=interval, replications=20, executor=executor)
    alone = coverage(Conjugate(), draw, intervals=interval, replications=20)
    np.testing.assert_array_equal(spread.hits, alone.hits)


def test_the_band_holds_uniform_ranks():
    """95 % of sets of uniform ranks stay inside everywhere, within three standard errors."""
    band = rank_band(80)
    rng = np.random.default_rng(5)
    share = np.arange(1, 100) / 100
    inside = 0
    for _ in range(400):
        counts = np.bincount(rng.integers(0, 100, 80), minlength=100)[:-1]
        inside += bool((np.abs(np.cumsum(counts) / 80 - share) <= band).all())
    assert abs(inside / 400 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 400)


def test_ranks_by_hand():
    """Three of nine draws lie below 3.5, all below 20, none below -1."""
    draws = np.tile(np.arange(1.0, 10.0)[:, None], (1, 3))
    assert ranks(draws, np.array([3.5, 20.0, -1.0]), levels=9).tolist() == [3, 9, 0]
    with pytest.raises(BadArgument, match="'draws' of ranks must be at least 99"):
        ranks(draws, np.zeros(3))


def test_uniformity_by_hand():
    """Ten ranks in each of ten bins have a chi-square of 0, p = 1; all hundred in one bin p = 0."""
    even = np.arange(100)[:, None]
    p = uniformity(np.concatenate([even, np.full((100, 1), 55)], axis=1))
    assert p[0] == 1.0
    assert p[1] < 1e-100
    with pytest.raises(BadArgument, match="'bins' of uniformity must be a divisor of 100"):
        uniformity(even, bins=7)


def pushes(rng):
    """The sliding block with a truth of its own, which does not vary."""
    simulator = SlidingBlock()
    truth = np.array([1.5, 0.8])
    forces = np.repeat(rng.normal(0.0, 3.0, (6, 4, 1)), 5, axis=1)
    values = np.tile(truth, (6, 1))
    data = simulate(simulator, values, forces, np.zeros(2), noise_variance=1e-6, rng=rng)
    names = dict(zip(simulator.space.names, truth.tolist(), strict=True))
    return Problem("pushes", simulator, data, epsilon=1e-6, truth=names), truth


def test_least_squares_covers_and_keeps_the_contract():
    """A real estimator, by the default intervals of its means; 60 data sets."""
    found = coverage(LeastSquares(), pushes, replications=60)
    assert found.p_value > 0.01
    problem, _ = pushes(np.random.default_rng(1))
    assert check_estimator(LeastSquares(), problem).method == "least-squares"


@dataclass(frozen=True)
class Fickle(LeastSquares):
    """Another answer each time, from fewer transitions and from more in turn."""

    transitions: Iterator[int] = field(default_factory=lambda: cycle((20, 60)))

    def fit(self, problem, **options):
        return super().fit(problem.using(transitions=next(self.transitions)))


@dataclass(frozen=True)
class Global(LeastSquares):
    """Draws from the global stream."""

    def fit(self, problem, **options):
        np.random.random()  # noqa: NPY002
        return super().fit(problem, **options)


def test_estimators_that_break_a_rule_are_caught():
    problem, _ = pushes(np.random.default_rng(1))
    with pytest.raises(AssertionError, match="the same seed gives another mean"):
        check_estimator(Fickle(), problem)
    with pytest.raises(AssertionError, match="global random stream"):
        check_estimator(Global(), problem)
    with pytest.raises(AssertionError, match="from the truth"):
        # The parameters vary here, which a point without a spread does not know.
        check_estimator(LeastSquares(), slide(), max_z=1e-6)


def test_refusals():
    with pytest.raises(BadArgument, match="level"):
        coverage(Conjugate(), draw, level=1.0)
    with pytest.raises(BadArgument, match="at least 50, for five in a bin"):
        simulation_based_calibration(Conjugate(), draw, replications=49)
    with pytest.raises(Incompatible, match="has no draws of a posterior"):
        expected_coverage(LeastSquares(), pushes, replications=10)


def test_reports_are_read_by_people():
    """Mean ranks of a half and shares of each credibility where posteriors are right, and p."""
    right = rank(Conjugate(), replications=100)
    text = str(right)
    assert text.startswith("ranks of the truth, 100 replications")
    shown = [line.split() for line in text.splitlines() if line.split()[:1] in (["0"], ["1"])]
    assert [float(line[1]) for line in shown] == pytest.approx(
        right.ranks.mean(axis=0) / right.levels, abs=5e-4
    )
    found = expected_coverage(Conjugate(), draw, draws=drawn, replications=50)
    lines = str(found).splitlines()
    assert lines[0].startswith("expected coverage, 50 replications")
    (half,) = [line.split() for line in lines if line.strip().startswith("50%")]
    assert half[1] == f"{np.mean(found.credibility <= 0.5):.1%}"
    assert lines[-1].startswith("p of uniform: ")


def test_draws_are_those_of_the_chain_or_of_the_particles():
    """Of a fit that has neither, they must be named."""
    chain = np.arange(24.0).reshape(2, 4, 3)
    fit = SimpleNamespace(posterior=SimpleNamespace(chain=chain), method="posterior")
    np.testing.assert_array_equal(posterior_draws(fit), chain.reshape(8, 3))
    record = SimpleNamespace(draws=[[1, 2], [3, 4]])
    fit = SimpleNamespace(posterior=None, search_record=record, method="epopt")
    np.testing.assert_array_equal(posterior_draws(fit), [[1.0, 2.0], [3.0, 4.0]])
    fit = SimpleNamespace(posterior=None, search_record=None, method="dropo")
    with pytest.raises(Incompatible, match="A fit by 'dropo' has no draws of a posterior"):
        posterior_draws(fit)
