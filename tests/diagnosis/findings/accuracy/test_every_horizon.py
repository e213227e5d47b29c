"""What errors after every printed horizon say of an effect and of the verdict."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import dropo.diagnosis.diagnose as module
from dropo import Diagnose
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Signal
from dropo.diagnosis.findings.accuracy import horizons
from dropo.diagnosis.findings.accuracy.every_horizon import (
    OF_MOTION,
    Beyond,
    EveryHorizonSettings,
    beyond_noise,
    in_words,
    worse_after,
)
from dropo.diagnosis.findings.accuracy.horizons import AfterHorizon, apart, with_numbers
from dropo.diagnosis.parts import Leader
from dropo.diagnosis.settings import DiagnosisSettings
from dropo.report.pages.diagnosis_page import _remaining
from tests.models.hidden_in_arm import problem

SIGNALS = (Signal("qpos.elbow", "rad"), Signal("qvel.elbow", "rad/s"))
WINDOWS = 120


def after(steps, *sizes, seed=0, blocks=12, noise=0.01, spread=1.0):
    """Normal errors of models with these standard deviations, in units of the signals."""
    rng = np.random.default_rng(seed + steps)
    size = np.reshape(sizes, (len(sizes), 1, -1))
    errors = size * rng.standard_normal((len(sizes), WINDOWS, len(SIGNALS)))
    return AfterHorizon(
        steps=steps,
        signals=SIGNALS,
        models=(),
        errors=errors,
        by_noise=noise * rng.standard_normal((2, WINDOWS, len(SIGNALS))),
        spread=np.full(len(SIGNALS), spread),
        block=np.arange(WINDOWS) * blocks // WINDOWS,
    )


def test_what_was_estimated_does_not_count():
    """Of signals of which one alone is off, its errors are beyond noise, unless it is no
    measurement.
    """
    off = np.full(len(SIGNALS), 0.01)
    off[-1] = 0.05
    found = [after(20, off)]
    measured = np.arange(len(SIGNALS)) < len(SIGNALS) - 1
    assert beyond_noise(found, 0)
    assert beyond_noise(found, 0, measured=~measured)
    assert not beyond_noise(found, 0, measured=measured)


def test_noise_is_told_from_what_remains():
    """Errors as large as noise makes them are explained at every horizon in 100 draws of the data
    but one at most; twice as large ones are not, and it is said after which horizon.
    """
    alarms = 0
    for seed in range(100):
        found = [after(steps, 0.01, seed=1000 * seed) for steps in (1, 5, 20, 100)]
        alarms += bool(beyond_noise(found, 0))
    assert alarms <= 1
    told = beyond_noise([after(1, 0.01), after(20, 0.02), after(100, 0.03)], 0)
    assert [one.steps for one in told] == [20, 100]
    assert told[1].ratio == pytest.approx(3, rel=0.1)
    assert in_words(told).startswith("errors after 20 and 100 steps, up to 2.")
    assert in_words(told[:1]).startswith("errors after 20 steps, 2")
    assert "what noise explains (" in in_words(told)


def test_one_unit_is_enough():
    """The printed errors of one unit, hidden among larger ones of another, and its name."""
    (told,) = beyond_noise([after(20, [0.01, 0.02])], 0)
    assert told.unit in ("rad/s", OF_MOTION)
    larger = replace(after(20, [0.02, 0.01]), spread=np.array([100.0, 1.0]))
    (told,) = beyond_noise([larger], 0)
    assert told.unit == "rad"


def test_a_single_run_is_no_reason():
    """Where one of twelve blocks makes all of the excess, its spread says that this is chance; the
    control: the same excess in every block is none.
    """
    one = after(20, 0.01)
    errors = one.errors.copy()
    errors[:, one.block == 3] *= 6.0
    assert beyond_noise([replace(one, errors=errors)], 0) == ()
    every = one.errors * np.sqrt(1 + 35 / 12)
    assert len(beyond_noise([replace(one, errors=every)], 0)) == 1


def test_few_runs_need_a_large_excess():
    """Of two runs the spread says little: half as much again is not told, three times is."""
    assert beyond_noise([after(20, 0.015, blocks=2)], 0) == ()
    assert len(beyond_noise([after(20, 0.03, blocks=2)], 0)) == 1


def test_noise_that_is_known_in_windows_alone():
    """Errors that are as much larger after a window are no more than usual."""
    found = [after(1, 0.02), after(5, 0.02), after(20, 0.02)]
    assert len(beyond_noise(found, 0)) == 3
    assert beyond_noise(found, 0, usual=5) == ()
    assert [one.steps for one in beyond_noise([*found, after(100, 0.08)], 0, usual=5)] == [100]


def test_an_effect_that_makes_errors_larger_is_told():
    """After one horizon of three, by its steps and how much; not where it helps, where the errors
    stay within the noise, or where they differ by chance.
    """
    helps = [after(1, 0.02, 0.01), after(5, 0.04, 0.01)]
    assert worse_after(helps, 0, 1) is None
    worse = worse_after([*helps, after(100, 0.05, 0.08)], 0, 1)
    assert (worse.steps, round(worse.ratio, 1)) == (100, 1.6)
    assert worse_after([after(1, 0.004, 0.009)], 0, 1) is None
    assert worse_after([after(1, 0.05, 0.0505)], 0, 1) is None


def test_errors_of_what_was_estimated_speak_against_no_effect():
    """An effect that makes those alone larger is kept; the control: where they are measured."""
    off = np.full(len(SIGNALS), 0.05)
    worse = off.copy()
    worse[-1] = 0.1
    found = [after(20, off, worse)]
    measured = np.arange(len(SIGNALS)) < len(SIGNALS) - 1
    assert worse_after(found, 0, 1) is not None
    assert worse_after(found, 0, 1, measured=~measured) is not None
    assert worse_after(found, 0, 1, measured=measured) is None


def test_motion_that_is_lost_is_lost_for_both():
    """Errors beyond the spread count alike, however large, and so does a simulation that fails; an
    effect with which the motion is lost that was followed makes it worse.
    """
    lost = after(400, 20.0, 90.0)
    errors = np.sign(lost.errors) * (3.0 + np.abs(lost.errors))
    errors[1, :30] = np.nan
    lost = replace(lost, errors=errors, by_noise=40.0 + lost.by_noise)
    assert worse_after([lost], 0, 1) is None
    assert beyond_noise([lost], 1) == ()
    followed = replace(lost, errors=np.stack([after(400, 0.1).errors[0], errors[1]]))
    followed = replace(followed, by_noise=after(400, 0.1).by_noise)
    assert worse_after([followed], 0, 1).steps == 400
    assert len(beyond_noise([followed], 1)) == 1


def test_noise_makes_errors_of_the_numbers_fitted(monkeypatch):
    """A prediction that is a number's own is off by that number's error; a direction that the data
    do not tell, here the second number, is no error that noise makes.
    """
    shape = (-1, WINDOWS, 2)
    predict = lambda thetas, windows: np.repeat(thetas.sum(axis=1), WINDOWS * 2).reshape(shape)
    bounds = ParameterSpace((Parameter("a", -1.0, 1.0), Parameter("b", -1.0, 1.0)))
    library = SimpleNamespace(simulator=SimpleNamespace(space=bounds, predict=predict))
    last = SimpleNamespace(theta=np.array([0.2, 0.3]), free=np.arange(2))
    monkeypatch.setattr(horizons, "_part_and_spread", lambda *given: (None, None))
    monkeypatch.setattr(horizons, "held_out_windows", lambda *given: None)
    exact = replace(after(20, 0.1), by_noise=np.zeros((2, WINDOWS, 2)))
    (told,) = with_numbers(
        None, library, last, np.diag([0.05**2, 9.0]), [exact], np.random.default_rng(0), 400
    )
    assert told.by_noise.shape == (400, WINDOWS, 2)
    assert told.by_noise.std() == pytest.approx(0.05, rel=4 / np.sqrt(800))


def test_pieces_of_few_runs_hardly_overlap():
    """Eight runs stay; of two, windows of 400 rows within 500 are one piece each, of 20 rows
    twelve.
    """
    runs = np.repeat(np.arange(8), 3) * 7
    assert apart(runs, np.arange(24), 400).tolist() == np.repeat(np.arange(8), 3).tolist()
    starts = np.concatenate([np.arange(0, 100, 5), 600 + np.arange(0, 100, 5)])
    assert set(apart(starts // 600, starts, 400)) == {0, 1}
    starts = np.concatenate([np.arange(0, 480, 5), 600 + np.arange(0, 480, 5)])
    assert set(apart(starts // 600, starts, 20)) == set(range(24))


def test_a_verdict_holds_after_every_horizon():
    """An arm with a little more damping than its model, of which windows of one step say nothing:
    the search may not name it, and the errors after 20 steps say that something is missing, and
    after how many. The control: without the check the verdict is that nothing is.
    """
    hidden = problem([("joint_damping:elbow", [6e-4])])
    blind = EveryHorizonSettings(misfit=np.inf)
    settings = DiagnosisSettings(horizons=blind)
    one_step = Diagnose(("sensor_bias",), length=1, windows=24, disturbances=False)
    assert replace(one_step, settings=settings).run(hidden).verdict == "consistent"
    found = one_step.run(hidden)
    assert found.verdict == "unexplained"
    assert not found.remaining.calibrated
    assert "after 5 steps" in found.remaining.where[-1]
    assert "what noise explains" in found.headline()
    assert any("diagnose with --steps 5" in text for text in found.warnings)


def test_an_effect_that_makes_some_horizon_worse_is_not_accepted(monkeypatch):
    """Of an effect that windows confirm it is taken to be found that errors after 20 steps grow: it
    is a leader with the reason, in the text, in JSON and on the page, and no cause, the search goes
    on without it, and something remains. The control is the same diagnosis left alone.
    """
    hidden = problem([("joint_damping:elbow", [0.05])])
    diagnose = Diagnose(
        ("joint_damping:elbow", "sensor_bias"), length=5, windows=16, disturbances=False
    )
    alone = diagnose.run(hidden)
    assert [one.place for one in alone.causes] == ["joint damping at elbow"]
    assert alone.leaders == ()
    grown = [Beyond(20, "rad", 1.5, 2.0)]
    beyond = lambda *given, measured: grown.pop() if grown else None
    monkeypatch.setattr(module, "worse_after", beyond)
    found = diagnose.run(hidden)
    assert "joint_damping" not in [one.effect for one in found.causes]
    (leader, *_) = found.leaders
    assert (leader.effect, leader.target, leader.steps) == ("joint_damping", "elbow", 20)
    assert leader.gain > 100
    assert "errors after 20 steps are 1.5 times those without it (rad)" in str(found)
    assert found.verdict in ("partly", "unexplained")
    saved = found.to_json()
    assert Leader.from_json(saved["leaders"][0]) == leader
    advice = "something else that the model lacks may act like it"
    assert advice in _remaining(saved, None).body
    assert saved["leaders"][0]["record"] == advice
    assert np.all(found.problem.simulator.model.dof_damping == hidden.simulator.model.dof_damping)
