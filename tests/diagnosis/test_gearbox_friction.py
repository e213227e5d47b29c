"""Dry friction that turns with the velocity, as a gearbox has it, is named as dry friction."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.diagnosis.diagnose import Diagnose
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
