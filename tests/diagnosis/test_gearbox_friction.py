"""Dry friction that turns with the velocity, as a gearbox has it, is named as dry friction."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.diagnosis import solving
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.search.arithmetic import HOLDING
from tests.models.holding_servo import FRICTION, recorded, servo


@pytest.mark.slow
@pytest.mark.parametrize("holding", [True, False])
def test_friction_of_either_kind_is_dry_friction(holding):
    """Of a servo whose model has none. The extended model has the kind that was recorded."""
    data = recorded(holding, np.random.default_rng(7))
    effects = ("joint_friction", "joint_stribeck", "joint_damping")
    found = Diagnose(effects=effects).run(Problem("servo", servo(), data))
    assert [cause.effect for cause in found.causes] == ["joint_friction"]
    friction = found.causes[0].estimate["frictionloss"]
    assert abs(friction.value - FRICTION) < 4 * friction.se < 0.2 * FRICTION
    assert any("holds what rests" in sentence for sentence in found.numerics) == holding


@pytest.mark.slow
@pytest.mark.parametrize("holding", [True, False])
def test_friction_of_another_kind_than_the_models_is_no_cause(monkeypatch, holding):
    """Of a servo whose model has all of it: nothing is named, also where a search does not ask for
    it at its end. That the machine's friction is not MuJoCo's is said where it is so.
    """
    monkeypatch.setattr(solving, "_with_other_friction", lambda setup, found: (setup, found))
    data = recorded(holding, np.random.default_rng(8))
    effects = ("joint_friction", "joint_stribeck", "joint_damping", "actuator_delay")
    found = Diagnose(effects=effects).run(Problem("servo", servo(FRICTION), data))
    assert found.causes == ()
    assert any("holds what rests" in sentence for sentence in found.numerics) == holding


@pytest.mark.slow
def test_how_friction_turns_may_show_in_more_exact_steps_alone(monkeypatch):
    """Beside the damping of Euler's steps it does not: they are taken together with it where no
    search before its end has asked for them. Control: in the model's own steps they are not.
    """
    monkeypatch.setattr(solving.ArithmeticAlternatives, "is_preferred", lambda *_: False)
    monkeypatch.setattr(solving.ArithmeticAlternatives, "__call__", lambda *_: False)
    data = recorded(True, np.random.default_rng(7))
    problem = Problem("servo", servo(), data)
    settings = Diagnose(effects=("joint_friction", "joint_damping"))
    found = settings.run(problem)
    assert [cause.effect for cause in found.causes] == ["joint_friction"]
    assert any('integrator="RK4"' in sentence for sentence in found.numerics)
    monkeypatch.setattr(solving, "_steps_of_other_friction", lambda setup: [HOLDING])
    assert not any('integrator="RK4"' in sentence for sentence in settings.run(problem).numerics)


@pytest.mark.slow
def test_friction_that_turns_over_little_velocity_is_no_cause():
    """Of a servo whose model has all of it, in MuJoCo's way, stepped by Euler: that is said."""
    data = recorded(False, np.random.default_rng(9), finer=1, turning=True)
    effects = ("joint_friction", "joint_stribeck", "joint_damping")
    found = Diagnose(effects=effects).run(Problem("servo", servo(FRICTION), data))
    assert found.causes == ()
    assert any("turns here over little velocity" in sentence for sentence in found.numerics)
