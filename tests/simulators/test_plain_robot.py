"""The robot that is written into model.py files moves as the simulator does."""

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.numbers import changed_numbers
from dropo.simulators.mujoco.plain_robot import Robot, write_numbers
from tests.models.hidden_in_arm import UPPER, instance, problem

SAME = 1e-9
MASS = np.array([1.2])


@pytest.fixture(scope="module")
def arm():
    """An arm with a declared mass, and a short recording."""
    return problem([], parameters=[UPPER], episodes=1, steps=24)


def robot_with(arm, *labels):
    """The simulator with effects at their largest trials, and a robot of the same numbers."""
    context = arm.simulator
    chosen = [instance(context, label) for label in labels]
    active = [(one, np.sum(one.trials[-1], axis=0)) for one in chosen]
    simulator = arm.simulator.with_effects((), active)
    model = simulator.model_of(MASS, simulator.fixed)
    return simulator, Robot(model, simulator.frame_skip, active)


@pytest.mark.parametrize(
    "labels",
    [
        (),
        ("actuator_delay",),
        ("actuator_lag:elbow_motor", "actuator_gain:shoulder_motor"),
        ("joint_stribeck:elbow", "joint_cogging:shoulder.6-a-turn"),
        ("joint_load_friction:shoulder",),
        ("gear_lash:elbow",),
        ("external_force:fore.x",),
    ],
)
def test_it_moves_as_the_simulator(arm, labels):
    """From a run's first state on, command by command; the control: without its effects it goes
    elsewhere.
    """
    simulator, robot = robot_with(arm, *labels)
    run = arm.trajectories.select(0)
    ours = simulator.predict(MASS[None], run.segments(reset="start"))[0, -1]
    robot.reset(*np.split(run.observations[0], 2))
    for command in run.actions:
        robot.step(command)
    there = np.concatenate([robot.data.qpos, robot.data.qvel])
    np.testing.assert_allclose(there, ours, rtol=0, atol=SAME)
    assert robot.state()[0] == pytest.approx(len(run.actions) * simulator.control_step)
    if labels:
        bare = arm.simulator.predict(MASS[None], run.segments(reset="start"))[0, -1]
        assert np.abs(bare - ours).max() > 1e4 * SAME


def test_a_reset_forgets(arm):
    """Delayed commands, what play remembers and the time of the motion before."""
    _, robot = robot_with(arm, "actuator_delay", "gear_lash:elbow")
    run = arm.trajectories.select(0)
    ends = []
    for _ in range(2):
        robot.reset(*np.split(run.observations[0], 2))
        for command in run.actions[:8]:
            robot.step(command)
        ends.append(robot.state())
    np.testing.assert_array_equal(*ends)


def test_the_given_model_stays_as_it_is(arm):
    """Friction that depends on the state is set in the copy that is stepped; clamps behind which an
    effect acts are off there alone.
    """
    _, robot = robot_with(arm, "joint_load_friction:shoulder", "actuator_bias:elbow_motor")
    before = robot.given_model.dof_frictionloss.copy()
    for _ in range(3):
        robot.step(np.array([0.5, 0.5]))
    np.testing.assert_array_equal(robot.given_model.dof_frictionloss, before)
    assert (robot.model.dof_frictionloss != before).any()
    assert robot.given_model.actuator_ctrllimited.all()


def test_sensors_are_of_the_present_state():
    """Right after a reset, too, before any step."""
    xml = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
    <geom size="0.1" mass="1" pos="0 0 -0.3"/></body></worldbody>
    <sensor><jointpos joint="hinge"/><jointvel joint="hinge"/></sensor></mujoco>"""
    robot = Robot(mujoco.MjModel.from_xml_string(xml), 2)
    robot.reset(np.array([0.4]), np.array([-0.1]))
    np.testing.assert_array_equal(robot.sensors(), [0.4, -0.1])
    robot.step(np.zeros(0))
    np.testing.assert_array_equal(robot.sensors(), robot.state()[1:])
    assert robot.state()[1] != 0.4


def test_numbers_are_written_whole():
    """Those of arrays and of options, of these single numbers and vectors."""
    spec = """<mujoco><option timestep="%g" gravity="0 0 %g"/><worldbody><body>
    <joint axis="0 1 0" damping="%.17g"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
    one = mujoco.MjModel.from_xml_string(spec % (0.002, -9.81, 0.1))
    other = mujoco.MjModel.from_xml_string(spec % (0.001, -9.0, 1 / 3))
    numbers = changed_numbers(one, other)
    assert {"opt.timestep", "opt.gravity", "dof_damping"} <= set(numbers)
    write_numbers(one, numbers)
    assert changed_numbers(one, other) == {}
    assert one.opt.timestep == 0.001
