"""Effects on measurements: the true start from the measured one, and what the sensors make of where
the simulation gets.
"""

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.observation import exponential, multiply
from tests.models.effects_on_arm import instance, predicted, same
from tests.models.robots import ARM, ROBOTS
from tests.reference.effects import replay


def test_bias():
    """What starts b too high in the data is simulated from where it was, and seen b too high."""
    robot = ROBOTS["arm"]()
    off = np.array([0.0, 0.07, 0.0, 0.0])
    model = mujoco.MjModel.from_xml_string(ARM)
    same(
        robot,
        predicted(robot, "sensor_bias:qpos.elbow", 0.07),
        replay(model, robot, move=-off) + off,
    )


def test_gain():
    """The same for a scale."""
    robot = ROBOTS["arm"]()
    model = mujoco.MjModel.from_xml_string(ARM)
    gain = np.array([1.0, 1.0, 1.25, 1.0])
    twin = replay(model, robot, move=robot.segments.starts * (1 / gain - 1)) * gain
    same(robot, predicted(robot, "sensor_gain:qvel.shoulder", 0.25), twin)


def recorded(robot, simulated, turn):
    """Data as a sensor gives them that is turned by a rotation vector."""

    def measured(rows):
        out = rows.copy()
        out[:, 3:7] = multiply(rows[:, 3:7], exponential(np.broadcast_to(turn, (len(rows), 3))))
        return out

    true = robot.data.observations
    return Trajectories(
        measured(true), robot.data.actions, measured(simulated), robot.data.terminals
    )


def stepped(robot):
    """(N, nq + nv) the state a control step after every row of the data."""
    model = robot.simulator.model
    out = []
    for start in robot.data.observations:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
        for _ in range(robot.simulator.frame_skip):
            mujoco.mj_step(model, data)
        out.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(out)


def test_bias_of_an_orientation():
    """A turned sensor of a free body: its data are predicted in the tangent space once the turn is
    known.
    """
    robot = ROBOTS["cube"]()
    turn = np.array([0.2, 0.0, 0.0])
    own = robot.simulator
    none = np.zeros((1, 0))
    segments = recorded(robot, stepped(robot), turn).segments()
    turned = own.with_effects((), [(instance(robot, "sensor_bias:qpos.cube.rx"), turn[:1])])
    np.testing.assert_allclose(turned.predict(none, segments)[0], own.targets(segments), atol=1e-9)
    assert np.abs(own.predict(none, segments)[0] - own.targets(segments)).max() > 0.01


def delayed(robot, column, steps):
    """States after every control step, with one column measured so many physics steps late; starts
    moved on by what they then lag.
    """
    skip = robot.simulator.frame_skip
    model = robot.simulator.model
    fine = []
    for window, start in zip(robot.segments.steps, robot.segments.starts, strict=True):
        first = window[0]
        begin = next(a for a, b in robot.data.spans if a <= first < b)
        back = max(first - 1, begin)
        speed = (robot.data.next_observations[first] - robot.data.observations[back])[column] / (
            (1 + first - back) * skip
        )
        data = mujoco.MjData(model)
        true = start.copy()
        true[column] += steps * speed
        data.qpos[:], data.qvel[:] = true[: model.nq], true[model.nq :]
        trace = [true]
        for row in window:
            data.ctrl[:] = robot.data.actions[row]
            for _ in range(skip):
                mujoco.mj_step(model, data)
                trace.append(np.concatenate([data.qpos, data.qvel]))
        for j in range(1, len(window) + 1):
            fine.append(trace[j * skip].copy())
            at = j * skip - steps
            whole = int(np.floor(at)) if at > 0 else 0
            fine[-1][column] = trace[whole][column] + (at - whole) * (
                trace[whole + 1][column] - trace[whole][column]
            )
    return np.array(fine)


@pytest.mark.parametrize("steps", [2, 4, 2.5, 7])
def test_delay(steps):
    """A signal's value some physics steps ago; before the start, its first step continued
    backwards.
    """
    robot = ROBOTS["arm"]()
    same(
        robot,
        predicted(robot, "sensor_delay:qpos.shoulder", steps * 0.004),
        delayed(robot, 0, steps),
    )


def test_delay_of_a_sensor():
    """A sensor's reading a control step late is its reading a step before, at the start that of the
    start; others stay.
    """
    robot = ROBOTS["strange"]()
    none = np.zeros((1, 0))
    height = [signal.name for signal in robot.simulator.signals].index("sensordata.height")
    late = robot.simulator.with_effects(
        (), [(instance(robot, "sensor_delay:sensordata.height"), np.array([0.02]))]
    )
    found, prompt = (
        simulator.predict(none, robot.segments)[0] for simulator in (late, robot.simulator)
    )
    assert np.array_equal(np.delete(found, height, axis=1), np.delete(prompt, height, axis=1))
    np.testing.assert_allclose(
        np.delete(found[:, height], [0, 3, 6]), np.delete(prompt[:, height], [2, 5, 8]), rtol=1e-9
    )
    track = robot.simulator.layout.names.index("qpos.track")
    np.testing.assert_allclose(found[[0, 3, 6], height], robot.segments.starts[:, track], rtol=1e-9)


@pytest.mark.parametrize(("delay", "longer"), [(0.003, 1.0), (0.04, 2.5)])
def test_doubt_of_late_starts(delay, longer):
    """Half the delay times the root mean square of how much the signal's speed changes between
    steps, more of delays above a control step (16 ms); none of prompt signals.
    """
    robot = ROBOTS["arm"]()
    late = robot.simulator.with_effects(
        (), [(instance(robot, "sensor_delay:qvel.elbow"), np.array([delay]))]
    )
    found = late.extra_start_sd(np.zeros(0), robot.segments)
    for first, sd in zip(robot.segments.steps[:, 0], found, strict=True):
        begin, end = next(span for span in robot.data.spans if span[0] <= first < span[1])
        signal = np.append(
            robot.data.observations[begin:end, 3], robot.data.next_observations[end - 1, 3]
        )
        around = [
            k for k in range(first - begin - 1, first - begin + 2) if 1 <= k < len(signal) - 1
        ]
        bends = [signal[k + 1] - 2 * signal[k] + signal[k - 1] for k in around]
        wanted = (
            longer * 0.5 * delay / robot.simulator.control_step * np.sqrt(np.mean(np.square(bends)))
        )
        np.testing.assert_allclose(sd, [0, 0, 0, wanted], rtol=1e-9)
    assert found[:, 3].min() > 0
    assert not robot.simulator.extra_start_sd(np.zeros(0), robot.segments).any()
