"""Effects that come together at one place are one candidate."""

from dataclasses import replace

import pytest

from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.search.library import instances_for, partner_of
from dropo.diagnosis.settings import DiagnosisSettings
from tests.models.hidden_in_arm import problem

TRUE = {"actuator_delay": 0.013, "actuator_lag": 0.02}
PLACE = "elbow_motor"


@pytest.mark.parametrize("hidden", [("actuator_delay", "actuator_lag"), ("actuator_lag",)])
def test_a_late_motor_is_named_by_what_it_has(hidden):
    """Dead time and lag of one motor: both where both are there, within four standard errors, and
    only the one that is there otherwise.
    """
    made = problem([(f"{name}:{PLACE}", [TRUE[name]]) for name in hidden])
    search = Diagnose(
        (f"actuator_delay:{PLACE}", f"actuator_lag:{PLACE}", f"actuator_gain:{PLACE}"),
        length=5,
        windows=16,
        disturbances=False,
        settings=replace(DiagnosisSettings(), far_off=None),
    )
    found = search.run(made)
    assert {cause.effect for cause in found.causes} == set(hidden)
    for cause in found.causes:
        (size,) = cause.estimate.values()
        assert abs(size.value - TRUE[cause.effect]) < 4 * size.se


def test_partners_are_at_one_place():
    """A delay's partner is the lag of its own motor, and of nothing else there is one."""
    instances = instances_for(problem([], episodes=1))
    by_label = {instance.label: instance for instance in instances}
    delay = by_label[f"actuator_delay:{PLACE}"]
    assert partner_of(delay, instances) is by_label[f"actuator_lag:{PLACE}"]
    assert partner_of(by_label["actuator_delay"], instances) is by_label["actuator_lag"]
    assert partner_of(by_label["joint_damping:elbow"], instances) is None
    assert partner_of(delay, [delay]) is None


def test_what_was_estimated_has_no_sensor():
    """No sensor of a signal that was estimated is looked for, but where it is named with its place.
    Control: those of measured signals are, and all are where none was estimated.
    """
    measured = problem([], episodes=1)
    name = next(one.name for one in measured.simulator.signals if one.name.startswith("qvel"))
    estimated = replace(measured, estimated={name: 1e-3})
    before = {one.label for one in instances_for(measured)}
    after = {one.label for one in instances_for(estimated)}
    assert before - after == {label for label in before if label.rpartition(":")[2] == name}
    assert {f"sensor_delay:{name}", f"sensor_gain:{name}"} <= before - after
    (asked,) = instances_for(estimated, [f"sensor_gain:{name}"])
    assert asked.target == name
