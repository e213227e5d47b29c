"""Effects that come together at one place are one candidate."""

from dataclasses import replace

import pytest

from dropo.diagnosis.diagnose import Diagnose, DiagnosisSettings
from dropo.diagnosis.search.library import instances_for, partner_of
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
