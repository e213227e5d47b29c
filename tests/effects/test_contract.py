"""Every effect at every place of several robots keeps to the contract, and is seen if possible."""

import pickle
import re

import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.core.services.registry import find, names
from dropo.testing import check_effect
from tests.models.robots import ROBOTS

# what cannot be seen: a plane's third direction, contacts that do not come about, forces that a
# joint holds
NOWHERE = {
    "hopper": r"(body_com|external_force).*\.y|joint_limit.*|.*contact_.*",
    "arm": r"(body_com|external_force).*\.y|.*contact_.*",
    "cube": r"nothing",
    "cart": r"(body_com|external_force).*\.y|external_force:cart\.z|body_inertia:cart|.*contact_.*",
    "strange": r"(body_com|external_force):slider.*|.*contact_.*",
}


@pytest.fixture(scope="module", params=ROBOTS)
def name(request):
    """One robot after the other."""
    return request.param


@pytest.fixture(scope="module")
def robot(name):
    """The robot itself."""
    return ROBOTS[name]()


@pytest.fixture(scope="module")
def instances(robot):
    """All instances of the effect."""
    return [
        instance
        for effect in names("effects")
        for instance in find("effects", effect)(robot.simulator.effect_context)
    ]


@pytest.mark.parametrize("effect", names("effects"))
def test_contract(robot, effect):
    """Size 0 is the base model bit for bit; bounds, probes, continuity, proportion, inputs left
    alone, no NaN. Where a robot has no place for an effect, the check says so.
    """
    if instances_of(robot.simulator.effect_context, effect):
        check_effect(find("effects", effect), robot.simulator, robot.segments)
        return
    with pytest.raises(AssertionError, match=r"offers no instance .* nothing was checked"):
        check_effect(find("effects", effect), robot.simulator, robot.segments)


def test_every_effect_is_checked_on_some_robot():
    """But the law, which has a place once it has a formula."""
    contexts = [make().simulator.effect_context for make in ROBOTS.values()]
    unchecked = [
        effect
        for effect in names("effects")
        if not any(instances_of(context, effect) for context in contexts)
    ]
    assert unchecked == ["law"]


def largest(simulator, instances):
    """(K, d) for each instance its first and last trial, all else 0."""
    rows = []
    place = len(simulator.space) - sum(len(instance.quantities) for instance in instances)
    for instance in instances:
        for trial in (instance.trials[0][0], instance.trials[-1][-1]):
            rows.append(simulator.nominal.copy())
            rows[-1][place : place + len(trial)] = trial
        place += len(instance.quantities)
    return np.array(rows)


def test_seen_where_they_can_be(name, robot, instances):
    """Of each instance a trial changes the predictions, but for those that nothing can show on this
    robot.
    """
    labels = [instance.label for instance in instances]
    assert len(set(labels)) == len(labels)
    extended = robot.simulator.with_effects(instances)
    values = largest(extended, instances)
    changes = extended.predict(values, robot.segments) != robot.simulator.predict(
        robot.simulator.nominal[None], robot.segments
    )
    unseen = [
        label
        for label, pair in zip(labels, changes.reshape(len(instances), -1), strict=True)
        if not pair.any()
    ]
    assert [label for label in unseen if not re.fullmatch(NOWHERE[name], label)] == []


def test_any_number_of_threads_and_any_process(name, robot, instances):
    """Two threads, and a copy that went through pickle, give what one thread gives, bit for bit;
    the control: effects did act.
    """
    some = instances[::3]
    one = robot.simulator.with_effects(some)
    values = largest(one, some)
    wanted = one.predict(values, robot.segments)
    assert not np.array_equal(wanted, one.predict(0 * values + one.nominal, robot.segments))
    two = ROBOTS[name](threads=2).simulator.with_effects(some)
    sent = pickle.loads(pickle.dumps(two))
    assert np.array_equal(two.predict(values, robot.segments), wanted)
    assert np.array_equal(sent.predict(values, robot.segments), wanted)
    again = pickle.loads(pickle.dumps(ROBOTS[name](threads=2).simulator)).with_effects(
        pickle.loads(pickle.dumps(some))
    )
    assert np.array_equal(again.predict(values, robot.segments), wanted)


def test_none_where_there_is_nothing():
    """Effects of actuators are not offered for a cube, nor rotations' gains and delays; bodies at
    rest have no mass to be found.
    """
    offered = {
        name: [a.label for a in find("effects", name)(ROBOTS["cube"]().simulator.effect_context)]
        for name in names("effects")
    }
    assert [
        name for name in offered if name.startswith(("actuator", "joint", "gear")) and offered[name]
    ] == []
    assert "sensor_bias:qpos.cube.rx" in offered["sensor_bias"]
    assert not [
        label
        for kind in ("sensor_gain", "sensor_delay")
        for label in offered[kind]
        if label.endswith("rx")
    ]
    strange = ROBOTS["strange"]().simulator.effect_context
    assert not [
        instance for instance in find("effects", "body_mass")(strange) if instance.target == "world"
    ]
    assert [a.target for a in find("effects", "actuator_gain")(strange)] == [
        "actuator0",
        "actuator1",
        "socket",
        "actuator3",
        "speed",
        None,
    ]
    assert [a.label for a in find("effects", "gear_lash")(strange)] == []
