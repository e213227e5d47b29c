"""The model check: silent where the model is right, loud where friction is missing, and it names
what the residuals follow.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.dropo import DROPO
from dropo.estimators.epopt import EPOpt
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.posterior import Posterior
from dropo.evaluation import model_check
from dropo.evaluation.model_check import check_model
from dropo.mjmodel.fields import FieldParameter
from dropo.optimizers.samplers.emcee import Emcee
from dropo.problems.simulated.slide import slide
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.studies.intervals.coverage import FEW, MANY
from dropo.studies.intervals.data_sets import NOISE, data_set
from tests.reference.pushes import pushes

SETS = 15


def fitted(noise, seed, size=MANY, estimator=None, **settings):
    problem, truth = data_set("block", noise, *size, np.random.default_rng([7, seed]))
    return (estimator or LeastSquares()).fit(replace(problem, **settings)), truth


def test_limits_are_those_of_chance():
    """At 2 % false alarms, 3 of 15 come in 1 of 300 cases; at 95 % detection, 11 of 15 or fewer in
    1 of 180.
    """
    assert stats.binom.sf(2, SETS, 0.02) < 1 / 300
    assert stats.binom.cdf(11, SETS, 0.95) < 1 / 180


@pytest.mark.parametrize(("noise", "size"), [("independent", FEW), ("autocorrelated", MANY)])
def test_a_right_model_is_not_accused(noise, size):
    """Fewer than 3 of 15 data sets, with many short trajectories and with two long ones."""
    assert sum(not fitted(noise, seed, size)[0].trusted for seed in range(SETS)) < 3


def rounded_pushes(seed):
    """A fit as it comes of encoders' readings of motions that all begin alike, one of 14 whose
    errors of rounding follow the first pushes.
    """
    problem, _ = data_set("block", "quantised", *MANY, np.random.default_rng([seed, 25, 1]))
    return DROPO().fit(problem, rng=seed)


def test_errors_of_rounding_are_not_the_model(monkeypatch):
    """They follow what moves, by a little; a control where rounding is not known."""
    assert rounded_pushes(20025).trusted
    monkeypatch.setattr(model_check, "lattice_step", lambda column: None)
    assert not rounded_pushes(20025).trusted


def test_friction_is_missing_in_rounded_data_too():
    """What residuals follow is more than a twentieth of a step then."""
    for seed in range(5):
        problem, _ = data_set("block", "dry friction", *MANY, np.random.default_rng([7, seed]))
        data = problem.trajectories
        step = np.sqrt(12) * NOISE
        read = {
            name: np.round(getattr(data, name) / step) * step
            for name in ("observations", "next_observations")
        }
        fit = DROPO().fit(replace(problem, trajectories=replace(data, **read)), rng=seed)
        assert not fit.trusted


def test_start_noise_that_is_modelled_is_not_accused():
    """Fewer than 2 of 5."""
    estimator = DROPO(family="point", epsilon="learn")
    assert sum(not fitted("start", seed, estimator=estimator)[0].trusted for seed in range(5)) < 2


def test_draws_that_differ_between_groups_are_not_accused():
    """Mass and damping that differ from push to push are no missing physics: what a draw for each
    group explains is left out.
    """
    assert sum(not LeastSquares().fit(pushes(seed)).trusted for seed in range(SETS)) < 3


@pytest.mark.parametrize(
    "estimator",
    [
        Posterior(over="parameters", sampler=Emcee(steps=80, burn_in=40)),
        EPOpt(particles=100, rounds=4),
        LeastSquares(),
    ],
    ids=["posterior", "epopt", "least-squares"],
)
def test_every_method_that_fits_is_checked(estimator):
    """With the right model and with friction missing; what was not checked is None, and the table's
    header says what its intervals are then.
    """
    right = fitted("independent", 3, estimator=estimator)[0]
    wrong = fitted("dry friction", 3, estimator=estimator)[0]
    assert (right.trusted, wrong.trusted) == (True, False)
    assert any("the model is wrong" in text for text in wrong.warnings)
    assert "95 % interval" in str(right)
    assert "(95 % if the model were right)" in str(wrong)
    unchecked = replace(right, model_check=None)
    assert unchecked.trusted is None
    assert "95 % if the model is right" in str(unchecked)


@pytest.mark.parametrize(
    "estimator",
    [Posterior(sampler=Emcee(steps=80, burn_in=40)), EPOpt()],
    ids=["posterior", "epopt"],
)
def test_intervals_that_runs_contradict_are_told(estimator):
    """Mass and damping differ from push to push, and a posterior of one value of both takes all
    rows for independent: its interval of the mass is a thirtieth of what it ought to be.
    """
    problem = slide()
    fit = estimator.fit(problem, rng=0)
    assert fit.trusted is False
    assert any("the intervals are too narrow: that of mass" in text for text in fit.warnings)
    low, high = fit.interval()[0]
    assert not low <= problem.truth["mass"] <= high
    assert "(95 % if the model were right)" in str(fit)


def test_intervals_of_right_models_are_not_called_narrow():
    """With independent noise nothing is said: fewer than 3 of 15 data sets."""
    estimator = EPOpt(particles=100, rounds=4)
    fits = [fitted("independent", seed, estimator=estimator)[0] for seed in range(SETS)]
    assert sum(not fit.trusted for fit in fits) < 3
    assert not any("too narrow" in text for fit in fits for text in fit.warnings)


@pytest.mark.parametrize("size", [MANY, FEW])
def test_missing_friction_is_told(size):
    """In more than 11 of 15 data sets; the sentence names velocity and its sign, and the intervals
    are not shown as if they held.
    """
    fits = [fitted("dry friction", seed, size)[0] for seed in range(SETS)]
    assert sum(not fit.trusted for fit in fits) > 11
    named = [
        w
        for fit in fits
        for w in fit.warnings
        if w.startswith("the model is wrong: residuals of velocity follow sign(velocity) (z ")
    ]
    assert len(named) > 7
    assert "(95 % if the model were right)" in str(fits[0])
    assert fits[0].to_json()["model_check"]["passed"] is False


def test_epsilon_that_is_too_small_is_told():
    """Half the true standard deviation: residuals twice as large as the fit allows; at the true one
    nothing is said.
    """
    estimator = lambda variance: DROPO(family="point", epsilon=variance)
    right, wrong = (
        fitted("independent", 0, estimator=estimator(v))[0] for v in (2.5e-5, 2.5e-5 / 4)
    )
    assert right.trusted
    assert right.model_check.size.mean_square == pytest.approx(1, abs=4.5 * np.sqrt(1 / 1000))
    assert wrong.model_check.size.mean_square == pytest.approx(4, abs=4 * 4.5 * np.sqrt(1 / 1000))
    assert any(
        text.startswith("the model is wrong or epsilon too small: residuals are ")
        for text in wrong.warnings
    )


def test_noise_far_above_the_stated_one_is_told():
    """Stated at a fifth of what it is; at half, within the allowance of 3.5, nothing is said."""
    loud, fine = (fitted("independent", 0, epsilon=2.5e-5 / factor**2)[0] for factor in (5, 2))
    assert any("times the stated noise" in text for text in loud.warnings)
    assert fine.trusted


def test_signals_that_do_not_move_and_single_trajectories():
    """A signal of zero variance beside another one, and one trajectory of 30 rows: no alarm, no
    failure.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(np.array([[[1.0], [0.0]]]))
    data = simulate(
        simulator,
        np.ones((1, 1)),
        rng.normal(size=(1, 30, 1)),
        np.zeros(2),
        noise_variance=np.array([0.01, 0.0]),
        rng=rng,
    )
    fit = LeastSquares().fit(Problem("half blind", simulator, data))
    assert fit.trusted
    assert "y1 does not move" in fit.identifiability


def test_perfect_data_are_no_evidence():
    """Without noise the residuals are rounding, and their structure says nothing."""
    assert LeastSquares().fit(pushes(0, sd=0.0, noise=0.0, count=5)).trusted


def swinging(noise):
    """A mass on a spring of 100 N/m that swings freely for 4 s, with noise on every sensor [m]."""
    xml = """<mujoco><option timestep="0.005"><flag contact="disable"/></option><worldbody><body>
    <joint name="slide" type="slide" stiffness="100" damping="0.2"/><geom size="0.05" mass="1"/>
    </body></worldbody></mujoco>"""
    stiffness = FieldParameter("stiffness", 10.0, 1000.0, field="jnt_stiffness", element="slide")
    spec = mujoco.MjSpec.from_string(xml)
    simulator = MujocoSimulator(spec, [stiffness], observation=["qpos"], action=(), threads=1)
    rows = np.zeros((800, 1))
    rows[0] = 0.1
    blank = Trajectories(rows, np.zeros((800, 0)), rows, np.arange(800) == 799)
    motion = simulator.predict([[100.0]], blank.segments(reset="start"))[0]
    measured = motion + noise * np.random.default_rng(0).standard_normal(motion.shape)
    data = replace(
        blank, observations=np.concatenate([rows[:1], measured[:-1]]), next_observations=measured
    )
    return Problem("spring", simulator, data, reset="start")


def test_a_motion_that_is_not_followed_is_told():
    """Another frequency leaves residuals as large as the motion; noise of that size is none of it,
    nor are small errors.
    """
    for noise, stiffness, lost in ((1e-3, 140.0, True), (1e-3, 100.0, False), (0.1, 100.0, False)):
        problem = swinging(noise)
        at = np.array([[stiffness - 1], [stiffness], [stiffness + 1]])
        below, predicted, above = problem.simulator.predict(at, problem.segments)
        jacobian = (above - below)[..., None] / 2
        check = check_model(problem, predicted, jacobian, np.array([noise**2]))
        assert any("does not follow the motion" in text for text in check.sentences) == lost
