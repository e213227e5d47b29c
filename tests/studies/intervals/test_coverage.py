"""The coverage study in small: its table, and the friction that it simulates."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, UnknownName
from dropo.simulators.toy import SlidingBlock
from dropo.studies.engine.work import Work
from dropo.studies.intervals.coverage import CASES, MANY, coverage
from dropo.studies.intervals.data_sets import (
    DRY,
    LATE,
    NOISE,
    STATES,
    DryBlock,
    autocorrelated,
    data_set,
    measured,
)


@pytest.mark.study
def test_intervals_cover_and_missing_friction_is_told():
    """20 data sets of each: with a right model at least 32 of 40 intervals hold the truth (1 set
    in 7,700 has fewer); without the friction no damping's does, and the fit says so in at least
    15.
    """
    cases = (CASES[0], CASES[3], CASES[10])
    study = coverage(Work(), 20, cases=cases)
    independent, autocorrelated, dry = study.data.values()
    for found in (independent, autocorrelated):
        assert np.sum(20 * found["coverage"]) >= 32
        assert found["flagged"] <= 0.1
    assert dry["coverage"][1] < 0.2
    assert dry["flagged"] >= 0.75
    assert [row[0] for row in study.tables[0].rows] == [
        "block, independent",
        "block, autocorrelated",
        "block, dry friction",
    ]


def test_the_table_of_few_data_sets():
    """Three of each: most intervals hold the truth where the model is right, damping's never does
    without the friction, and the fits say so; a row for each case.
    """
    study = coverage(Work(threads=1), 3, cases=(CASES[0], CASES[10]))
    right, dry = study.data.values()
    assert np.sum(3 * right["coverage"]) >= 4
    assert right["flagged"] == 0
    assert dry["coverage"][1] == 0
    assert dry["flagged"] > 0.5
    assert [row[0] for row in study.tables[0].rows] == ["block, independent", "block, dry friction"]


def test_some_kinds_of_data_alone():
    """By robot and noise, as they are listed; others are refused with the nearest name."""
    study = coverage(Work(threads=1), 2, problems=["block, quantised"])
    assert [row[0] for row in study.tables[0].rows] == ["block, quantised"]
    assert not any("friction" in text for text in study.remarks)
    with pytest.raises(UnknownName, match="Did you mean 'block, quantised'"):
        coverage(Work(threads=1), 2, problems=["block, quantized"])


def test_a_posterior_of_one_value_is_told_of_runs_that_differ():
    """Two of each: silent where the model is right, loud where each run has values of its own."""
    cases = (CASES[-3], CASES[-1])
    study = coverage(Work(threads=1), 2, cases=cases)
    assert [found["flagged"] for found in study.data.values()] == [0.0, 1.0]
    assert not any("not within" in text for text in study.remarks if "spread" in text)


def test_friction_stops_and_holds_the_block():
    """A block at rest stays under less than the friction; a sliding one stops; far above it, it
    slides as under a weaker push.
    """
    values = np.array([1.5, 0.8])
    starts = np.array([[0.0, 0.0], [0.0, 0.005], [0.0, 3.0]])
    actions = np.array([[[0.9 * DRY]], [[0.0]], [[2.0]]])
    after = DryBlock()._replay(values, starts, actions)[:, 0]
    assert after[0].tolist() == [0.0, 0.0]
    assert after[1, 1] == 0.0
    assert 0 < after[1, 0] < 0.005 * 0.05
    np.testing.assert_allclose(
        after[2], SlidingBlock()._replay(values, starts[2:], actions[2:] - DRY)[0, 0], rtol=1e-12
    )


def test_autocorrelated_noise_is_so():
    """Of variance NOISE^2 and correlation 0.9 from step to step, within 4.5 standard errors."""
    errors = autocorrelated((2000, 30, 1), np.random.default_rng(0))[:, :, 0] / 5e-3
    assert np.var(errors[:, -1]) == pytest.approx(1, abs=4.5 * np.sqrt(2 / 2000))
    assert np.corrcoef(errors[:, -1], errors[:, -2])[0, 1] == pytest.approx(
        0.9, abs=4.5 * 0.19 / np.sqrt(2000)
    )


def test_start_noise_is_that_of_the_step_before():
    """The measured end of a step is the measured start of the next one."""
    problem, _ = data_set("block", "start", *MANY, np.random.default_rng(0))
    data = problem.trajectories
    inner = np.flatnonzero(~data.terminals)
    np.testing.assert_array_equal(data.next_observations[inner], data.observations[inner + 1])
    assert problem.start_noise


@pytest.mark.parametrize("noise", STATES)
def test_errors_of_sensors_have_one_size(noise):
    """The variance of NOISE; with outliers 2 % of 400 times as much; rounding to few values."""
    states = np.random.default_rng(1).normal(0, 1, (20_000, 2))
    errors = (measured(noise, states, np.random.default_rng(2)) - states) / NOISE
    expected = {"outliers": np.sqrt(0.98 + 0.02 * 400)}.get(noise, 1.0)
    spread = errors.std()
    assert spread == pytest.approx(expected, rel=0.2 if noise == "Student t 3" else 0.05)
    long = np.mean(np.abs(errors) > 4 * np.median(np.abs(errors)) / 0.6745)
    assert (long > 5e-3) == (noise in ("Student t 3", "outliers"))
    assert (np.abs(errors).max() < 1.75) == (noise == "quantised")


def test_jitter_is_that_of_the_steps():
    """Every fifth step or so is a tenth longer or shorter: the block is off by that of its way."""
    problem, truth = data_set("block", "jitter", *MANY, np.random.default_rng(0))
    predicted = problem.simulator.predict(truth[None], problem.segments)[0]
    off = problem.segments.targets - predicted
    speed = np.abs(problem.segments.starts[:, 1])
    fast = speed > np.quantile(speed, 0.7)
    size = np.sqrt(0.2) * LATE * problem.simulator.dt * speed[fast]
    assert 0.5 < np.std(off[fast, 0]) / np.sqrt(np.mean(size**2) + 2 * NOISE**2) < 1.5


def test_refusals():
    with pytest.raises(BadArgument, match="'seeds' of coverage must be at least 2"):
        coverage(Work(), 1)
    with pytest.raises(UnknownName, match="pink"):
        data_set("block", "pink", *MANY, np.random.default_rng(0))
