"""Effects on commands against slow filters in Python, on segments that begin in the middle of
trajectories.
"""

import mujoco
import numpy as np
import pytest

from tests.models.effects_on_arm import instance, predicted, same
from tests.models.robots import ARM, CART, ROBOTS
from tests.reference import effects as slow

STEP = 0.004
SKIP = 4
LEVER = 1.5  # gear of the servo


def arm():
    """The arm of motor 0 (|u| <= 1) and servo 1."""
    return ROBOTS["arm"]()


def each(change):
    """A command filter that works on what was given for a control step, before it is clamped."""
    return lambda robot, column: np.clip(before(robot, column, change), -1, 1)


def before(robot, column, change):
    """(T, nu) raw commands with one column changed trajectory by trajectory, each held for a
    control step.
    """
    out = robot.data.actions.copy()
    for first, last in robot.data.spans:
        out[first:last, column] = change(out[first:last, column])
    return np.repeat(out, SKIP, axis=0)


def after(change):
    """A command filter that works on clamped commands, physics step by physics step."""
    return lambda robot, column: slow.changed(robot, column, change)


CASES = [
    ("actuator_delay:push", 2 * STEP, 0, after(lambda u: slow.late(u, 2))),
    ("actuator_delay:push", 5.25 * STEP, 0, after(lambda u: slow.late(u, 5.25))),
    ("actuator_delay:servo", 0.4 * STEP, 1, after(lambda u: slow.late(u, 0.4))),
    ("actuator_lag:push", 0.02, 0, after(lambda u: slow.lagging(u, STEP, 0.02))),
    ("actuator_lag:servo", 0.001, 1, after(lambda u: slow.lagging(u, STEP, 0.001))),
    ("actuator_bias:push", 0.3, 0, after(lambda u: u + 0.3)),
    (
        "actuator_deadband:push",
        0.2,
        0,
        each(lambda u: np.array([0 if abs(x) < 0.2 else x - 0.2 if x > 0 else x + 0.2 for x in u])),
    ),
    ("actuator_deadband:servo.backlash", 0.3, 1, each(lambda u: slow.with_play(u, 0.3))),
    (
        "actuator_saturation:push",
        0.25,
        0,
        each(lambda u: np.array([min(max(x, -0.75), 0.75) for x in u])),
    ),
]


@pytest.mark.parametrize(("label", "size", "column", "commands"), CASES)
def test_command_filters(label, size, column, commands):
    """The trajectory's commands from its beginning, put through the filter by hand, and stepped one
    by one.
    """
    robot = arm()
    model = mujoco.MjModel.from_xml_string(ARM)
    model.actuator_ctrllimited[:] = 0  # the twin clamps by itself
    same(robot, predicted(robot, label, size), slow.replay(model, robot, commands(robot, column)))


def test_all_together():
    """A delay of all commands is that of each: once 3 steps for both."""
    robot = arm()
    model = mujoco.MjModel.from_xml_string(ARM)
    model.actuator_ctrllimited[:] = 0
    commands = slow.changed(robot, 0, lambda u: slow.late(u, 3))
    commands[:, 1] = slow.changed(robot, 1, lambda u: slow.late(u, 3))[:, 1]
    same(robot, predicted(robot, "actuator_delay", 3 * STEP), slow.replay(model, robot, commands))


def test_coupling():
    """A fraction of the clamped motor command also acts on the servo."""
    robot = arm()
    model = mujoco.MjModel.from_xml_string(ARM)
    model.actuator_ctrllimited[:] = 0
    commands = slow.changed(robot, 0, lambda u: u)
    commands[:, 1] += 0.4 * commands[:, 0]
    same(
        robot,
        predicted(robot, "actuator_coupling:push.on-servo", 0.4),
        slow.replay(model, robot, commands),
    )


def test_delay_knows_what_came_before():
    """A segment in the middle starts with the command of the step before it; one at a trajectory's
    start with its own first.
    """
    robot = arm()
    delayed = robot.simulator.with_effects(
        (), [(instance(robot, "actuator_delay"), np.array([STEP * SKIP]))]
    )
    cut = robot.data.segments()
    shifted = robot.data.actions[
        np.where(
            np.isin(np.arange(len(robot.data)), [first for first, _ in robot.data.spans]),
            np.arange(len(robot.data)),
            np.arange(len(robot.data)) - 1,
        )
    ]
    other = type(robot.data)(
        robot.data.observations, shifted, robot.data.next_observations, robot.data.terminals
    )
    nominal = robot.simulator.nominal[None]
    assert np.array_equal(
        delayed.predict(nominal, cut), robot.simulator.predict(nominal, other.segments())
    )


def test_saturation_without_a_limit():
    """An actuator that declares no limit is given one: |u| <= 1 / s."""
    robot = ROBOTS["cart"]()
    commands = np.repeat(np.clip(robot.data.actions, -0.5, 0.5), SKIP, axis=0)
    twin = slow.replay(mujoco.MjModel.from_xml_string(CART), robot, commands)
    same(robot, predicted(robot, "actuator_saturation:rail", 2.0), twin)


def test_lash_of_a_motor():
    """What passes the play is what a rotor that crosses it against its drag lets through, to the
    fine steps' width.
    """
    rng = np.random.default_rng(0)
    robot = arm()
    size = 1.3 * STEP
    hook = instance(robot, "gear_lash:shoulder").actuation
    for trial in range(5):
        commands = np.repeat(rng.uniform(-1, 1, (12, 2)), 2 if trial % 2 else 1, axis=0)
        found = hook(commands, STEP, np.array([size]))
        np.testing.assert_allclose(
            found[:, 0], slow.through_lash(commands[:, 0], STEP, size), atol=3 / slow.FINE
        )
        assert np.array_equal(found[:, 1], commands[:, 1])
        assert np.abs(found[:, 0] - commands[:, 0]).max() > 0.1
    still = np.full((9, 2), 0.7)
    np.testing.assert_allclose(
        hook(still, STEP, np.array([size]))[:, 0], still[:, 0], rtol=1e-12
    )  # taken up at the start


def test_lash_loses_one_impulse_a_reversal():
    """After each change of sign the play takes the same impulse, whatever the command's size."""
    robot = arm()
    size = 0.5 * STEP
    commands = np.zeros((40, 2))
    commands[:, 0] = np.repeat([0.9, -0.4, 0.7, -0.9], 10)
    found = instance(robot, "gear_lash:shoulder").actuation(commands, STEP, np.array([size]))
    lost = STEP * (commands[:, 0] - found[:, 0]).reshape(4, 10).sum(axis=1)
    np.testing.assert_allclose(lost, [0, -size, size, -size], atol=1e-15)


def test_lash_of_a_servo():
    """The joint feels no spring within half the play of where the rotor stands."""
    robot = arm()
    play = 0.1
    held = slow.changed(robot, 0, lambda u: u)
    model = mujoco.MjModel.from_xml_string(ARM)

    def spring(model, data):
        error = data.ctrl[1] - LEVER * data.qpos[1]
        felt = np.sign(error) * max(abs(error) - LEVER * play / 2, 0)
        return np.array([0.0, LEVER * 12 * (felt - error)])

    same(
        robot,
        predicted(robot, "gear_lash:elbow", play),
        slow.replay(model, robot, held, applied_force=spring),
    )
