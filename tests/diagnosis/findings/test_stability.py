"""What is told beside a cause: where else it is named, what was not confirmed, what is alike."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.contracts.estimator import silent
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.diagnosis.findings.causes import leaders
from dropo.diagnosis.findings.stability import stability
from dropo.diagnosis.parts import Leader, Stability
from dropo.diagnosis.search import arithmetic
from dropo.diagnosis.search.arithmetic import ArithmeticAlternatives
from dropo.diagnosis.search.confirmation import SETTINGS
from dropo.diagnosis.search.windows import split
from dropo.diagnosis.setup import DiagnosisTask
from dropo.diagnosis.solving import search_effects
from tests.models.hidden_in_arm import problem

SEARCH = Diagnose(
    ("joint_damping", "joint_friction", "joint_stiffness"), windows=24, disturbances=False
)
SIZE = Quantity("size", "N m", 0.0, 1.0, (0.01,))


@pytest.fixture(scope="module")
def searched():
    """The search on an arm with more damping at the elbow: setup, the effect and its review."""
    damped = problem([("joint_damping:elbow", [0.05])])
    task = DiagnosisTask(damped, damped, np.random.default_rng(0), EvaluationLog())
    setup = SEARCH._set_up(task, None, silent)
    _, found = search_effects(setup)
    (instance,) = found.last.accepted
    return setup, instance, found.reviews[instance.label]


def again(searched, instance):
    """The effect screened again."""
    setup, _, found = searched
    cut = lambda length: split(setup.problem, length, 24)[0]
    return stability(setup.selection, cut, instance, found)


def test_a_true_cause_is_named_everywhere(searched):
    found = again(searched, searched[1])
    assert set(found.windows) == {searched[0].train.length * k // 2 for k in (1, 2, 4)}
    assert (found.named, found.of) == (5, 5)
    assert found.doubt() is None


def test_a_wrong_one_is_not(searched):
    """The control: another effect in its place."""
    library = searched[0].library
    other = next(one for one in library.instances if one.label == "joint_stiffness:shoulder")
    found = again(searched, other)
    assert found.named == 0


def test_without_candidates_there_is_nothing_to_say(searched):
    setup, instance, found = searched
    assert stability(setup.selection, None, instance, replace(found, origin=None)) is None


def test_where_it_is_not_named_is_said():
    found = Stability({1: False, 10: True, 20: False}, (True, False))
    assert found.doubt() == "windows of 1 step, 20 steps and the second half of the data"
    assert (found.named, found.of) == (2, 5)
    assert Stability.from_json(found.to_json()) == found


def trial(label, held_out_gain, z, fitted_gain=20.0):
    """A candidate refitted, with its gain on data held out."""
    effect, target = label.split(":")
    instance = EffectInstance(effect, target, (SIZE,))
    candidate = SimpleNamespace(instance=instance)
    return SimpleNamespace(
        candidate=candidate, held_out_gain=held_out_gain, z=z, fitted_gain=fitted_gain
    )


def test_leaders_are_what_gains_enough_and_is_not_sure():
    """Of the last model's batches; those below the needed gain are left to chance.

    700 nats with z = 2 take (3 / 2)^2 times as much data to reach three standard errors.
    """
    before = SimpleNamespace(accepted=())
    found = SimpleNamespace(accepted=(EffectInstance("payload", "hand", (SIZE,)),))
    needed = SETTINGS.needed_gain(40)
    batches = [
        SimpleNamespace(before=before, trials=[trial("joint_friction:a", 900.0, 2.0)]),
        SimpleNamespace(
            before=found,
            trials=[
                trial("joint_friction:b", 0.9 * needed, 1.0),
                trial("joint_friction:c", 700.0, 2.0),
                trial("joint_friction:d", 50.0, 0.0),
                trial("joint_friction:e", 60.0, 2.0, fitted_gain=1.0),
            ],
        ),
    ]
    selection = SimpleNamespace(batches=batches, settings=SETTINGS)
    first, second = leaders(selection, found, 40)
    assert (first.target, first.gain, first.gain_se) == ("c", 700.0, 350.0)
    assert first.times == pytest.approx((3 * 350 / 700) ** 2)
    assert first.sentence == (
        "not confirmed: joint friction at c, 700 +- 3.5e+02 nats on data held out;"
        " record 2.2 times as much to be sure"
    )
    assert first.to_json()["record"] == "record 2.2 times as much to be sure"
    assert second.target == "d"
    assert second.to_json()["times"] is None
    assert second.to_json()["record"] == "record other motion"
    for leader in (first, second):
        read = Leader.from_json(leader.to_json())
        assert (read.gain, read.target) == (leader.gain, leader.target)
        assert np.isnan(read.times) or read.times == leader.times


def test_steps_under_which_there_is_no_likelihood_win_nothing(searched, monkeypatch):
    """Where a model loses the motion, that of every rival may be NaN. The control: as it is, a
    rival has a finite one.
    """
    setup = searched[0]
    selection = setup.selection
    last = setup.first()
    others = ArithmeticAlternatives(
        setup.library, selection.floor, selection.settings, EvaluationLog(), last
    )
    simulator = setup.library.simulator
    there = arithmetic.alternatives_of(simulator)
    assert np.isfinite(others._most_promising(simulator, last, there)[1])
    none = SimpleNamespace(log_likelihood=np.array([np.nan]))
    monkeypatch.setattr(arithmetic, "settle", lambda *args, **more: none)
    assert not others(last, None)
    assert not others.is_preferred(last)
