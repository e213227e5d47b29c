"""What motions tell only together is named, each number with what it is off by."""

import numpy as np

from dropo.diagnosis.far_off.ties import ties_of
from tests.models.far_off import torque_arm

LABELS = ("actuator_gain:elbow_motor", "joint_armature:elbow", "joint_friction:elbow")
SIZES = (-0.1, 0.02, 0.3)
SCALE = 0.2


def tied(errors, alone):
    """The sentences of an arm whose gain and armature are off together, its friction by itself."""
    arm = torque_arm(*LABELS)
    arm = arm.at(np.concatenate([arm.declared, SIZES]))
    together = np.array([errors[0], errors[1], 0.0])
    covariance = np.outer(together, together) + np.diag(np.square(alone))
    return ties_of(arm, covariance, arm.fitted, SCALE)


def test_numbers_that_move_together_are_one_set():
    """The gain comes first, known to a fifth of itself; the friction is no member."""
    (sentence,) = tied((0.36, 0.02), (1e-3, 1e-4, 1e-3))
    assert "only together: actuator_gain:elbow_motor -0.1 (0.18), " in sentence
    assert "joint_armature:elbow 0.02 (0.01) kg m^2. " in sentence
    assert "friction" not in sentence


def test_numbers_that_are_told_well_are_no_set():
    """Together, but to a fiftieth; or uncertain, but each by itself."""
    assert tied((0.02, 4e-4), (1e-4, 1e-5, 1e-3)) == ()
    assert tied((0.0, 0.0), (0.3, 0.02, 0.3)) == ()
