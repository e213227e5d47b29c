"""Effects of one kind at every joint or drive at once, and one kind in the place of another."""

from dataclasses import replace

import numpy as np

from dropo.diagnosis.far_off.families import late_otherwise, with_families
from tests.models.coupled_wrist import coupled_wrist_problem
from tests.models.far_off import torque_arm


def labels(model):
    """The labels of a model's effects."""
    return [instance.label for instance, _ in model.numbers]


def test_every_place_gets_the_effect():
    """At both joints, 0, also where one of them has it; that one stays as it is."""
    arm = torque_arm("joint_friction:elbow")
    arm = arm.at(np.append(arm.declared, 0.3))
    found = with_families(arm, ["joint_friction", "joint_load_friction"])
    assert labels(found) == [
        "joint_friction:elbow",
        "joint_friction:shoulder",
        "joint_load_friction:shoulder",
        "joint_load_friction:elbow",
    ]
    assert found.theta.tolist() == [*arm.declared, 0.3, 0.0, 0.0, 0.0]


def test_the_effect_everywhere_gives_way():
    """Every drive begins with what all drives had."""
    arm = torque_arm("joint_armature:elbow", "actuator_gain")
    arm = arm.at(np.concatenate([arm.declared, [0.01, -0.3]]))
    found = with_families(arm, ["actuator_gain"])
    assert labels(found) == [
        "joint_armature:elbow",
        "actuator_gain:shoulder_motor",
        "actuator_gain:elbow_motor",
    ]
    assert found.theta.tolist() == [*arm.declared, 0.01, -0.3, -0.3]


def test_declared_parameters_are_not_doubled():
    """A mass that is fitted as a parameter is no effect beside it; one that is not fitted is."""
    arm = torque_arm()
    assert len(labels(with_families(arm, ["body_mass"]))) == 2
    free = replace(arm, free=np.arange(2))
    assert with_families(free, ["body_mass"]) is free


def test_a_joint_that_follows_another_is_no_place():
    """What it has acts at its leader as if that had it."""
    wrist = torque_arm(problem=coupled_wrist_problem(1, runs=2, count=40))
    found = with_families(wrist, ["joint_damping"])
    assert labels(found) == ["joint_damping:pitch", "joint_damping:lift"]


def test_lags_take_the_place_of_delays_and_the_reverse():
    """As long, behind the other numbers; a model without either, or with both, stays as it is."""
    arm = torque_arm("actuator_delay:elbow_motor", "joint_armature:elbow")
    arm = arm.at(np.concatenate([arm.declared, [0.02, 0.01]]))
    found = late_otherwise(arm)
    assert labels(found) == ["joint_armature:elbow", "actuator_lag:elbow_motor"]
    assert found.theta.tolist() == [*arm.declared, 0.01, 0.02]
    assert labels(late_otherwise(found)) == ["joint_armature:elbow", "actuator_delay:elbow_motor"]
    for others in ((), ("actuator_delay:elbow_motor", "actuator_lag:elbow_motor")):
        same = torque_arm("joint_armature:elbow", *others)
        assert late_otherwise(same) is same
