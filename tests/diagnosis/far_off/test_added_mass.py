"""A mass that a single link carries, where a weak drive does the same."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.estimator import silent
from dropo.core.contracts.problem import Problem
from dropo.diagnosis.far_off.added_mass import as_payloads, for_gain, for_payload
from dropo.diagnosis.far_off.model import FarOffModel
from dropo.diagnosis.far_off.search import FarOffSearch, FarOffSettings
from dropo.diagnosis.regression.quick import sides
from tests.models.holding_servo import FRICTION, recorded, servo

NONE = np.zeros(0, dtype=np.int64)
LOAD = 0.2  # [kg]


def model_with(data, **sizes):
    """The arm's model with numbers of some effects."""
    problem = Problem("servo", servo(), data)
    context = problem.simulator.effect_context
    numbers = [
        (next(iter(instances_of(context, name))), np.array([size])) for name, size in sizes.items()
    ]
    fitted, held_out = sides(problem, 0.25)
    divided = replace(problem, trajectories=fitted, held_out=held_out)
    return FarOffModel(divided, np.zeros(0), NONE, tuple(numbers))


def found(**other):
    """What a search that begins with a weak drive finds of an arm."""
    data = recorded(False, np.random.default_rng(3), finer=1, **other)
    begun = model_with(data, actuator_gain=-0.3, joint_friction=0.1)
    return FarOffSearch(FarOffSettings(), silent).run(begun)


def sizes_of(explained):
    """By effect, its sizes and their errors."""
    model = explained.model
    return {
        one.effect: (sizes, explained.errors[model.library.indices_of[one.label]])
        for one, sizes in model.numbers
    }


@pytest.mark.slow
def test_a_load_is_named_not_a_weak_drive():
    """Of the load its weight is certain, and the friction is right within its error."""
    explained = found(load=LOAD)
    assert "payload:arm" in explained.certain
    assert "actuator_gain:servo" not in explained.certain
    numbers = sizes_of(explained)
    mass, place = numbers["payload"][0][:2]
    assert abs(mass * place - LOAD * 0.2) < 0.2 * LOAD * 0.2
    friction, error = (float(one[0]) for one in numbers["joint_friction"])
    assert abs(friction - FRICTION) < 3 * error


@pytest.mark.slow
def test_a_strong_drive_is_no_load():
    """No mass makes up for it."""
    explained = found(gain=0.4)
    assert "payload" not in sizes_of(explained)
    assert "actuator_gain:servo" in explained.certain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "named"),
    [({"spring": 0.5}, "joint_stiffness:elbow"), ({"load": 0.1}, "payload:arm")],
)
def test_a_spring_is_no_load(hidden, named):
    """Also where the joint moves little, and a search begins with a load."""
    data = recorded(False, np.random.default_rng(3), finer=1, reach=0.15, **hidden)
    begun = as_payloads(model_with(data, body_mass=0.05, joint_friction=0.1))
    explained = FarOffSearch(FarOffSettings(), silent).run(begun)
    assert explained.certain == {"joint_friction:elbow", named}
    friction, error = (float(one[0]) for one in sizes_of(explained)["joint_friction"])
    assert abs(friction - FRICTION) < 3 * error


def test_all_of_a_joint_grows_with_its_load():
    """As much as the weight of the link; a drive that is no weaker has no such load."""
    data = recorded(False, np.random.default_rng(0), runs=2, count=100)
    model = model_with(data, actuator_gain=-0.2, joint_friction=0.1, joint_damping=0.3)
    other = for_gain(model)
    sizes = {one.effect: own for one, own in other.numbers}
    assert sizes["actuator_gain"] == 0
    np.testing.assert_allclose(sizes["joint_friction"], 0.1 / 0.8)
    np.testing.assert_allclose(sizes["joint_damping"], (0.1 + 0.3) / 0.8 - 0.1)
    np.testing.assert_allclose(sizes["payload"], [0.4 * 0.25, 0.1, 0, 0], atol=1e-12)
    assert for_gain(model_with(data, actuator_gain=0.2, joint_friction=0.1)) is None


def test_a_heavier_body_carries_something_at_its_centre():
    """Its inertia is what the place makes of it; a lighter body carries nothing."""
    data = recorded(False, np.random.default_rng(0), runs=2, count=100)
    carrying = as_payloads(model_with(data, body_mass=0.1, body_inertia=2.0))
    ((instance, sizes),) = carrying.numbers
    assert instance.effect == "payload"
    np.testing.assert_allclose(sizes, [0.1, 0.1, 0, 0], atol=1e-12)
    lighter = model_with(data, body_mass=-0.1)
    assert as_payloads(lighter) is lighter


def test_a_payload_whose_mass_is_not_told_may_be_a_spring():
    """A spring of nothing in its joint; none in the place of a mass that is told."""
    data = recorded(False, np.random.default_rng(0), runs=2, count=100)
    model = as_payloads(model_with(data, body_mass=0.1, joint_damping=0.2))
    errors = np.full(len(model.theta), 0.05)
    other = for_payload(model, errors, 3.0)
    sizes = {one.label: own for one, own in other.numbers}
    assert set(sizes) == {"joint_damping:elbow", "joint_stiffness:elbow"}
    assert sizes["joint_stiffness:elbow"] == 0
    assert for_payload(model, errors / 10, 3.0) is None
    assert for_payload(model_with(data, joint_damping=0.2), errors[:1], 3.0) is None
