"""The likelihood of whole runs: starts that are found, noise as it is, and no invented spread."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.noise import Noise
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.trajectory import Trajectory, TrajectorySettings
from dropo.simulators.toy import SlidingBlock
from dropo.studies.intervals.data_sets import DryBlock
from dropo.studies.unlogged_states.machines import simulate_log
from dropo.testing import check_likelihood
from tests.models import imu_arm
from tests.models.runs_of_block import SD, SEED, TRUTH, along_runs, block


def test_it_keeps_to_the_contract():
    """All that every likelihood must do."""
    check_likelihood(Trajectory())


def test_velocities_that_were_not_logged():
    """Positions alone: within 4.5 of the optimal standard errors, which its own are near; control:
    velocities made of positions and taken for measured are ten times further off.
    """
    log = simulate_log("arm", "positions, white", SEED)
    fit = DROPO().fit(log.problem, rng=0)
    assert fit.likelihood == "trajectory"
    assert "not measured" in fit.message
    assert (np.abs(fit.mean - log.truth) < 4.5 * log.optimum).all()
    assert (fit.mean_se > 0.8 * log.optimum).all()
    assert (fit.mean_se < 1.5 * log.optimum).all()
    assert fit.trusted
    smoothed = DROPO(likelihood="emulated").fit(log.problem, rng=0)
    assert np.abs((smoothed.mean - log.truth) / log.optimum).max() > 45


def test_noisy_starts_are_no_spread():
    """All states of a mass on a spring noisy: found without a spread; control: measured starts give
    another stiffness, a spread of more than a tenth, and no doubt.
    """
    log = simulate_log("spring-mass", "all noisy", SEED)
    fit = DROPO().fit(log.problem, rng=0)
    assert fit.likelihood == "trajectory"
    assert "noisy measurements" in fit.message
    assert (np.abs(fit.mean - log.truth) < 4.5 * log.optimum).all()
    assert (fit.mean_se < 1.5 * log.optimum).all()
    assert (fit.sd < 0.01 * fit.mean).all()
    measured = DROPO(likelihood="emulated").fit(log.problem, rng=0)
    assert np.abs((measured.mean - log.truth) / log.optimum).max() > 20
    assert (measured.sd / measured.mean).max() > 0.1
    assert measured.trusted


def test_the_information_is_that_of_cramer_and_rao():
    """With noise that is known, to a percent: that of runs whose start is unknown."""
    log = simulate_log("arm", "all noisy", SEED)
    found = along_runs(log.problem, noise=Noise(np.array([1e-3, 1e-2]) ** 2))
    information = found.objective.information.sum(axis=0)
    errors = np.sqrt(np.diagonal(np.linalg.inv(information)))
    np.testing.assert_allclose(errors, log.optimum, rtol=0.01)


def test_windows_are_only_a_way_to_the_end():
    """Windows of 7 or of 60 steps are the same likelihood: a fiftieth of a standard error apart."""
    problem = block()
    short, whole = (
        along_runs(problem, Trajectory(settings=TrajectorySettings(window=window)))
        for window in (7, 60)
    )
    error = np.sqrt(np.diagonal(np.linalg.inv(whole.objective.information.sum(axis=0))))
    assert (np.abs(short.found.point[:2] - whole.found.point[:2]) < 0.02 * error).all()
    np.testing.assert_allclose(short.epsilon, whole.epsilon, rtol=1e-3)


def test_noise_is_as_it_is():
    """Memory and long tails are found where they are, and nowhere else."""
    expected = {
        "all noisy": (0.0, None),
        "AR(1) 0.9": (0.9, None),
        "Student t 3": (0.0, 3.0),
    }
    for noise, (memory, degrees) in expected.items():
        found = along_runs(simulate_log("arm", noise, SEED).problem)
        for sensor in found.details["trajectory"]["noise"].values():
            assert sensor["correlation"] == pytest.approx(memory, abs=0.08 if memory else 0.0)
            assert (sensor["degrees"] is None) == (degrees is None)
            if degrees is not None:
                assert 2 <= sensor["degrees"] <= 6


def test_levels_allow_for_the_starts():
    """Runs of six rows, whose starts eat two of twelve numbers: the restricted level is within 4.5
    standard errors of the true one; control: the plain mean square is not.
    """
    problem = block(runs=600, steps=5)
    found = along_runs(problem)
    error = np.sqrt(2 / (600 * 4))
    np.testing.assert_allclose(found.epsilon, SD**2, rtol=4.5 * error)
    left = found.problem.simulator.targets(found.problem.segments) - found.objective.mean(
        found.found.point
    )
    plain = np.mean(left**2, axis=0) / SD**2
    assert (plain < 1 - 4.5 * error).any()


def test_spreads_from_run_to_run():
    """Runs whose damping alone differs by 20 %: that spread is found within 4.5 of its standard
    errors and no other, and the noise is the sensors'. Where nothing varies, nothing is said to.
    """
    varied = along_runs(block(runs=30, spread=(0.0, 0.2)))
    error = 1 / np.sqrt(2 * 30)
    spread = varied.found.point[2:] / varied.found.point[:2]
    assert spread[0] < 1e-3
    assert abs(spread[1] / 0.2 - 1) < 4.5 * error
    np.testing.assert_allclose(varied.epsilon, SD**2, rtol=4.5 * np.sqrt(2 / 1800))
    plain = along_runs(block(runs=30)).found.point
    assert (plain[2:] / plain[:2] < 1e-3).all()


def test_a_model_that_lacks_something_is_doubted():
    """Dry friction that the model does not have: the fit says so; control: it says nothing of one
    that lacks nothing.
    """
    assert DROPO().fit(block(), rng=0).trusted
    fit = DROPO().fit(block(simulator=DryBlock()), rng=0)
    assert fit.likelihood == "trajectory"
    assert fit.trusted is False


def test_what_it_refuses():
    """Rows that do not follow each other, and parts that it does not take."""
    problem = block(runs=4, steps=10)
    data = problem.trajectories
    apart = replace(data, next_observations=data.next_observations + 1e-3)
    with pytest.raises(Incompatible, match="rows that follow each other"):
        DROPO(likelihood="trajectory").fit(replace(problem, trajectories=apart))
    with pytest.raises(Incompatible, match="a search of its own"):
        DROPO(likelihood="trajectory", optimizer="cma-es").fit(problem)
    with pytest.raises(Incompatible, match="partial"):
        DROPO(likelihood="trajectory").fit(replace(problem, reset="partial"))


def test_an_imu_tells_more_than_angles():
    """Angles and the IMU of an arm's last link, without velocities: within 4.5 standard errors of
    the truth, which are at most 0.7 of those that angles alone have.
    """
    angles = DROPO().fit(imu_arm.problem(12, ()), rng=0)
    both = DROPO().fit(imu_arm.problem(12), rng=0)
    assert angles.likelihood == both.likelihood == "trajectory"
    for fit in (angles, both):
        assert (np.abs(fit.mean - imu_arm.TRUTH) < 4.5 * fit.mean_se).all()
    assert (np.array(both.mean_se) < 0.7 * np.array(angles.mean_se)).all()


def logged(problem, path, progress=lambda fraction, text: None):
    """A fit whose rounds are recorded, as fit.json has it, and the simulator steps made for it."""
    before = problem.simulator.steps
    fit = DROPO(likelihood="trajectory").fit(
        problem, rng=0, evaluation_log=EvaluationLog(path), progress=progress
    )
    content = fit.to_json()
    del content["wall_time_s"]
    return content, problem.simulator.steps - before


@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_an_interrupted_search_goes_on_to_the_same_bits(spread, tmp_path):
    """From whatever round is recorded, turns of the groups among them: what it found, and what that
    cost in all, are those of a search that nothing interrupted; it simulates less again.
    """
    problem = block(runs=6, steps=30, spread=spread)
    path = tmp_path / "evaluations.jsonl"
    whole, steps = logged(problem, path)
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) > 4
    made_again = []
    for kept in sorted({2, 4, len(lines) - 1, len(lines)}):
        path.write_text("".join(lines[:kept]))
        again, more = logged(problem, path)
        assert again == whole, kept
        assert path.read_text() == "".join(lines)
        made_again.append(more)
    assert made_again == sorted(made_again, reverse=True)
    assert made_again[-1] < 0.6 * steps
    assert ("differ from group to group" in whole["message"]) == (spread > 0)


def test_ctrl_c_keeps_the_rounds_and_their_best(tmp_path):
    """Interrupted after three rounds, it gives the best so far; the same again goes on from it."""
    problem = block(runs=6, steps=30)
    whole, _ = logged(problem, tmp_path / "whole.jsonl")

    def stop(fraction, text):
        if text.startswith("round 3"):
            raise KeyboardInterrupt

    path = tmp_path / "evaluations.jsonl"
    assert logged(problem, path, stop)[0]["status"] == "interrupted"
    assert (tmp_path / "whole.jsonl").read_text().startswith(path.read_text())
    assert logged(problem, path)[0] == whole


class Bursting(SlidingBlock):
    """It diverges where the mass is large."""

    def _predict(self, values, segments, offsets):
        out = super()._predict(values, segments, offsets)
        out[values[..., 0].ravel()[: len(out)] > 1.0] = np.nan
        return out


def test_a_first_look_that_diverged_is_recorded(tmp_path):
    """What is recorded behind it keeps its place; it is refused in the same words."""
    problem = replace(block(runs=2, steps=20), simulator=Bursting())
    mean = (problem.space.low + problem.space.high) / 2
    noise = Noise(np.full(2, 1e-2), "each")
    family = TruncatedGaussian(problem.space)
    said = []
    for _ in range(2):
        log = EvaluationLog(tmp_path / "evaluations.jsonl")
        run = Run(problem, np.random.default_rng(0), log)
        with pytest.raises(SimulationFailed) as error:
            Trajectory().fit_runs(problem, run, family, noise, mean)
        said.append(str(error.value))
        run.evaluate(mean[None], lambda points: np.zeros((1, 1)))
    assert said[0] == said[1]
    assert log.replayed == 2


@pytest.mark.parametrize(("slow", "told"), [(0.0, ["an iteration takes 1 s"]), (3600.0, [])])
def test_slow_iterations_are_told_once(slow, told):
    """The first that is slow; quick ones say nothing."""
    said = []
    problem = block(runs=2, steps=20)
    run = Run(problem, np.random.default_rng(0), progress=lambda _, text: said.append(text))
    noise = Noise(SD**2)
    likelihood = Trajectory(settings=TrajectorySettings(slow_iteration=slow))
    likelihood.fit_runs(problem, run, TruncatedGaussian(problem.space), noise, TRUTH)
    assert [text for text in said if text.startswith("an iteration")] == told
