"""Simulation-based calibration, on posteriors that are right and on ones that are not."""

import numpy as np
import pytest

from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.estimators.support.posterior_targets import PointLikelihood
from dropo.optimizers.samplers.emcee import Emcee
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.studies.engine.work import Work
from dropo.studies.intervals.calibration import (
    CASES,
    SAMPLERS,
    CalibrationSettings,
    _estimator,
    _hopper,
    _varying_block,
    _varying_hopper,
    calibration,
    methods_of,
    replication,
)
from dropo.testing.statistics import ranks, uniformity


@pytest.mark.study
def test_a_conjugate_posterior_is_calibrated_and_a_narrower_one_is_not():
    """100 truths of a linear simulator, each with its posterior by emcee: p > 0.01, and below it
    1.5 times too narrow.
    """
    simulator = LinearSimulator(np.ones((1, 1, 1)), low=-1.0, high=1.0)
    noise = 0.5
    found = []
    narrow = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        truth = rng.uniform(-1, 1, 1)
        problem = Problem(
            "line",
            simulator,
            simulate(
                simulator,
                truth[None],
                np.ones((1, 5, 1)),
                np.zeros(1),
                noise_variance=noise,
                rng=rng,
            ),
        )
        target = PointLikelihood(problem, Noise(noise))
        draws = (
            Emcee(walkers=16, steps=30, burn_in=20)
            .sample(target.many, target.unknowns, rng=rng, spread=0.2)
            .flat()
        )
        found.append(ranks(draws, truth))
        narrow.append(ranks(draws.mean(axis=0) + (draws - draws.mean(axis=0)) / 1.5, truth))
    assert uniformity(np.array(found))[0] > 0.01
    assert uniformity(np.array(narrow))[0] < 0.01


def test_a_replication_ranks_every_parameter():
    answer = replication(["sliding block", "emcee", 3])
    assert len(answer["ranks"]) == len(answer["control"]) == 2
    assert all(0 <= rank <= 99 for rank in answer["ranks"])
    assert answer["ranks"] == replication(["sliding block", "emcee", 3])["ranks"]
    with pytest.raises(BadArgument, match="'seeds' of calibration must be at least 50"):
        calibration(Work(), 10)


@pytest.mark.study
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("case", ["sliding block", "hopper"])
def test_posteriors_are_calibrated(case, sampler):
    """100 replications: the least p-value of d parameters is above 0.01 / d, and below it where
    posteriors are 1.5 times too narrow.
    """
    answers = Work().map(replication, [[case, sampler, seed] for seed in range(100)])
    p, control = (
        uniformity(np.array([answer[kind] for answer in answers])) for kind in ("ranks", "control")
    )
    assert len(p) * p.min() > 0.01
    assert len(control) * control.min() < 0.01


def test_the_table_tells_uniform_ranks_from_others(monkeypatch):
    """Replications that are made up: even ranks, and ones in the middle for the control; the least
    p-value counts as many times as there are parameters.
    """
    asked = []

    def given(self, task, items):
        asked.append(items)
        even = [[seed % 100, (37 * seed) % 100] for seed in range(len(items))]
        return [{"ranks": own, "control": [50, 50], "warnings": []} for own in even]

    monkeypatch.setattr(Work, "map", given)
    study = calibration(Work(threads=1), 100)
    (table,) = study.tables
    assert [row[:2] for row in table.rows] == [
        (case, sampler) for case in CASES[:2] for sampler in methods_of(case)
    ]
    assert {row[3] for row in table.rows} == {"uniform"}
    assert {row[5] for row in table.rows} == {"not uniform"}
    assert table.rows[0][2] == "1, 1"
    assert [item[2] for item in asked[0]] == list(range(100))
    assert set(study.data) == {f"{case}, {sampler}" for case, sampler, *_ in table.rows}
    strict = calibration(Work(threads=1), 100, settings=CalibrationSettings(minimum_p=3.0))
    assert {row[3] for row in strict.tables[0].rows} == {"not uniform"}


def test_the_hoppers_noise_is_that_of_its_likelihood():
    """Next states are what the model predicts at the truth, with errors of the stated variance."""
    problem, truth = _hopper(np.random.default_rng(5))
    assert len(problem.trajectories) == 12
    assert problem.space.low[0] <= truth[0] <= problem.space.high[0]
    predicted = problem.simulator.predict(truth[None], problem.segments)[0]
    errors = problem.simulator.targets(problem.segments) - predicted
    n = errors.size
    assert np.mean(errors**2) / problem.epsilon == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    again, same = _hopper(np.random.default_rng(6))
    assert not np.array_equal(truth, same)
    assert again.trajectories.observations == pytest.approx(problem.trajectories.observations)


def test_methods_other_than_samplers_are_ranked_too():
    """EPOpt on the block: the same seed gives the same ranks, and the control's lie further out."""
    answer = replication(["sliding block", "epopt", 3])
    assert len(answer["ranks"]) == 2
    assert answer["ranks"] == replication(["sliding block", "epopt", 3])["ranks"]
    for own, narrow in zip(answer["ranks"], answer["control"], strict=True):
        assert abs(narrow - 49.5) >= abs(own - 49.5)


def test_posteriors_of_distributions_are_of_means_and_scales():
    """Their cases take samplers alone; what varies shows beyond the noise, on its own rows."""
    case = "sliding block, distribution"
    assert methods_of(case) == tuple(SAMPLERS)
    assert {"emcee", "pyro-nuts", "pyro-svi", "epopt", "npe"} == set(methods_of("hopper"))
    assert _estimator(case, "emcee").over == "distribution"
    for make, numbers in ((_varying_block, 4), (_varying_hopper, 8)):
        problem, truth = make(np.random.default_rng(5))
        assert truth.shape == (numbers,)
        space = problem.space
        middle = space.from_unit(np.full((1, len(space)), 0.5))
        predicted = problem.simulator.predict(middle, problem.segments)[0]
        errors = problem.simulator.targets(problem.segments) - predicted
        assert np.mean(errors**2) > 5 * problem.epsilon
    with pytest.raises(UnknownName, match="sliding block"):
        calibration(Work(threads=1), 100, problems=["sliding bloc"])
