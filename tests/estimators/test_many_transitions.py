"""Fits of more transitions than memory holds: the same numbers, and no more memory."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics import kept_rows
from dropo.core.numerics.kept_rows import FileRows, MemorySettings
from dropo.core.records import segment_blocks
from dropo.core.records.fits.fit import Status
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.trust_region import OuterIterations, TrustRegionSettings
from dropo.evaluation import model_check
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.simulators.toy import SlidingBlock, simulate

NOISE = 1e-4
TRUTH = np.array([1.5, 0.8])


def pushes(rows, length=20, noise=NOISE):
    """A problem of so many transitions of a sliding block, in runs of 20."""
    rng = np.random.default_rng(7)
    simulator = SlidingBlock()
    count = rows // length
    actions = np.repeat(rng.normal(0.0, 3.0, (count, 4, 1)), length // 4, axis=1)
    values = np.broadcast_to(TRUTH, (count, 2))
    data = simulate(simulator, values, actions, np.zeros(2), noise_variance=noise, rng=rng)
    return Problem("pushes", simulator, data, epsilon=noise)


@pytest.mark.parametrize("likelihood", ["emulated", "unscented"])
def test_memory_and_blocks_change_nothing(likelihood, monkeypatch):
    """Rows in files, and a few rows a block, give the fit of one block in memory to rounding."""
    problem = pushes(600)
    whole = DROPO(likelihood=likelihood).fit(problem, rng=0)
    monkeypatch.setattr(kept_rows, "ROW_BYTES", 20_000)
    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 10_000)
    made = []

    class Recorded(FileRows):
        def __init__(self, shape, folder=None):
            made.append(shape)
            super().__init__(shape, folder)

    monkeypatch.setattr(kept_rows, "FileRows", Recorded)
    small = DROPO(likelihood=likelihood, memory=MemorySettings(limit=1)).fit(problem, rng=0)
    assert {shape[0] for shape in made} >= {60, 600}
    np.testing.assert_allclose(small.mean, whole.mean, rtol=1e-7)
    np.testing.assert_allclose(small.mean_se, whole.mean_se, rtol=1e-5)
    np.testing.assert_allclose(small.log_likelihood, whole.log_likelihood, rtol=1e-9)
    one, other = small.model_check.structure, whole.model_check.structure
    assert (one.signal, one.feature) == (other.signal, other.feature)
    np.testing.assert_allclose([one.z, one.held_out_z], [other.z, other.held_out_z], rtol=1e-4)


def test_memory_of_a_fit_is_bounded(monkeypatch):
    """More rows take no more than the data's own numbers and their scores; without a limit, the
    polynomials of all rows besides.
    """
    monkeypatch.setattr(kept_rows, "ROW_BYTES", 1 << 16)
    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 1 << 16)

    def floats_a_row(likelihood):
        peaks = []
        for rows in (400, 1600):
            problem = pushes(rows)
            family = TruncatedGaussian(problem.space)
            rng = np.random.default_rng(0)
            tracemalloc.start()
            local = likelihood.linearize_at(
                problem.simulator, problem.segments, family, NOISE, TRUTH, 0.05 * TRUTH, rng
            )
            local.value_score_information(family.phi(TRUTH, 0.01 * TRUTH))
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        return (peaks[1] - peaks[0]) / 1200 / 8

    bounded = floats_a_row(Emulated(3, memory=MemorySettings(limit=1)))
    unbounded = floats_a_row(Emulated(3))
    polynomials = 10 * 2 + 2 * 2  # coefficients, and the covariance of what they leave
    assert bounded < unbounded - 0.8 * polynomials


def test_a_sample_leads_to_the_fit_of_all():
    """Rounds on a sample, then one on all: within a tenth of a standard error of rounds on all,
    for fewer steps.
    """
    problem = pushes(4000)
    family = TruncatedGaussian(problem.space)

    def fit(settings):
        run = Run(problem, np.random.default_rng(0))
        rng = np.random.default_rng(1)
        before = problem.simulator.steps
        search = OuterIterations(problem, run, family, Emulated(), NOISE, rng, settings=settings)
        objective, found = search.fit(problem.space.from_unit(np.array([0.5, 0.5])))
        assert found.status is Status.CONVERGED
        assert len(objective.targets) == 4000
        information = objective.value_score_information(found.point)[2][:2, :2]
        error = np.sqrt(np.diagonal(np.linalg.inv(information)))
        return found.point[:2], error, problem.simulator.steps - before

    on_all, error, steps = fit(TrustRegionSettings(sample_segments=4000))
    sampled, _, fewer = fit(TrustRegionSettings(sample_segments=400))
    assert np.all(np.abs(sampled - on_all) < 0.1 * error)
    assert np.all(np.abs(sampled - TRUTH) < 4 * error)
    assert fewer < 0.8 * steps


def test_structure_is_tested_on_stretches(monkeypatch):
    """Of more rows than are tested, stretches all over the data find what all rows find, and
    nothing in a right model.
    """
    problem = pushes(4000)
    few = replace(model_check.SETTINGS, rows=1500, stretches=100)
    right = DROPO().fit(problem, rng=0)
    assert right.model_check.passed
    monkeypatch.setattr(
        model_check.check_model,
        "__kwdefaults__",
        {**model_check.check_model.__kwdefaults__, "settings": few},
    )
    stretches = DROPO().fit(problem, rng=0)
    assert stretches.model_check.passed
    assert stretches.model_check.structure.z != right.model_check.structure.z
    # A force that the model lacks.
    data = problem.trajectories
    wrong = data.next_observations + np.array([0.0, 0.005])
    lacking = replace(problem, trajectories=replace(data, next_observations=wrong))
    assert not DROPO().fit(lacking, rng=0).model_check.passed
