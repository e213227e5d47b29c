"""A payload is named as one, with its mass and place, and not as the force that its weight is."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.search.library import instances_for
from dropo.diagnosis.settings import DiagnosisSettings
from tests.models.hidden_in_arm import problem

RIVALS = (
    "payload",
    "external_force:stick.z",
    "external_force:boom.z",
    "body_mass",
    "body_com:stick.x",
    "joint_friction:lift",
)
MASS = 0.3
PLACE = (0.25, 0.06, 0.08)
PAYLOAD = ("payload:stick", [MASS, *PLACE])


def diagnosed(hidden):
    """What is said of an arm of three joints, a few of its windows, by the search alone."""
    search = Diagnose(
        RIVALS,
        length=5,
        windows=16,
        disturbances=False,
        settings=replace(DiagnosisSettings(), far_off=None),
    )
    return search.run(problem(hidden, name="position-arm", seed=3000))


def test_a_payload_is_named_with_its_mass_and_place():
    """Beside dry friction: within four standard errors, and nothing else is named."""
    found = diagnosed([PAYLOAD, ("joint_friction:lift", [0.4])])
    told = {(cause.effect, cause.target): cause for cause in found.causes}
    assert set(told) == {("payload", "stick"), ("joint_friction", "lift")}
    assert found.verdict == "explained"
    sizes = told["payload", "stick"].estimate
    for name, true in zip(("mass", "x", "y", "z"), (MASS, *PLACE), strict=True):
        assert abs(sizes[name].value - true) < 4 * sizes[name].se
    assert sizes["mass"].se < 0.01 * MASS


@pytest.mark.study
def test_two_payloads():
    """At two bodies: each is named, though the first alone stands for both at first."""
    found = diagnosed([PAYLOAD, ("payload:boom", [0.4, 0.2, 0.03, 0.08])])
    told = {(cause.effect, cause.target): cause.estimate["mass"] for cause in found.causes}
    assert set(told) == {("payload", "stick"), ("payload", "boom")}
    for target, true in (("stick", MASS), ("boom", 0.4)):
        assert abs(told["payload", target].value - true) < 4 * told["payload", target].se


def test_a_payload_need_not_be_named_to_be_looked_for():
    """It is among the effects by default, at each body that moves."""
    instances = instances_for(problem([], episodes=1))
    at = {one.target for one in instances if one.effect == "payload" and not one.variant}
    assert at == {"upper", "fore"}


def test_ten_masses_span_all_inertial_numbers():
    """The trials' inertial numbers are independent, and in proportion to the mass."""
    instances = instances_for(problem([], episodes=1), ["payload:fore"])
    tried = np.array(instances[0].trials[0])
    numbers = instances[0].linear_in(tried)
    assert np.linalg.matrix_rank(numbers / np.abs(numbers).max(axis=0)) == numbers.shape[1] == 10
    np.testing.assert_allclose(instances[0].linear_in(tried * [3, 1, 1, 1]), 3 * numbers)
