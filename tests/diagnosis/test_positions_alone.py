"""Logs of positions alone: what is estimated is no cause, and what is hidden is found."""

from dataclasses import replace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.diagnosis.search.library import instances_for
from dropo.problems.file.estimated_velocities import with_velocities
from tests.models import imu_arm
from tests.models.hidden_in_arm import problem

ENCODER = 2 * np.pi / 4096
SOME = ["joint_damping", "joint_friction", "sensor_delay", "actuator_delay", "actuator_gain"]


def positions_alone(hidden, seed=3, episodes=24):
    """The arm's log by encoders of 4096 steps a turn, without velocities."""
    found = problem(hidden, sigma=1e-5, seed=seed, episodes=episodes, steps=60)
    data = found.trajectories
    read = lambda rows: np.round(rows[:, :2] / ENCODER) * ENCODER
    log = replace(
        data,
        observations=read(data.observations),
        next_observations=read(data.next_observations),
    )
    whole = found.simulator
    simulator = whole.observing(["qpos"])
    return with_velocities(replace(found, simulator=simulator, trajectories=log))


@pytest.fixture(scope="module")
def nothing():
    """A log of the model itself."""
    return positions_alone([])


def test_estimates_are_known_as_such(nothing):
    """By name, with the size of their errors in rad/s."""
    assert set(nothing.estimated) == {"qvel.shoulder", "qvel.elbow"}
    assert all(0.005 < size < 0.5 for size in nothing.estimated.values())


def test_estimates_are_no_cause(nothing):
    """With nothing hidden nothing is named. The control: taken for measured, estimates speak
    against the model.
    """
    diagnose = Diagnose(SOME, windows=60, disturbances=False)
    assert diagnose.run(nothing).verdict == "consistent"
    assert diagnose.run(replace(nothing, estimated={})).verdict != "consistent"


def test_what_is_hidden_is_found():
    """A damping at its place, within a twentieth; the noise that is reported of a velocity is that
    of its estimate, which windows leave out.
    """
    found = Diagnose(SOME, windows=30, disturbances=False).run(
        positions_alone([("joint_damping:elbow", [0.05])], episodes=12)
    )
    ((effect, target, size),) = [
        (one.effect, one.target, one.estimate["damping"]) for one in found.causes
    ]
    assert (effect, target) == ("joint_damping", "elbow")
    assert size.value == pytest.approx(0.05, rel=0.05)
    assert found.noise["qvel.elbow"] < 0.5


def test_an_imu_without_velocities():
    """Angles and an IMU: nothing is named where nothing is hidden, a damping where it is, with the
    orientation too, which has no gain. The control: starts that are taken to be as far off as the
    arm is fast turn gravity in short windows: an accelerometer shows the square of a velocity.
    """
    diagnose = Diagnose(["joint_damping", "gravity_tilt"], windows=30, disturbances=False)
    nothing = imu_arm.problem(2, runs=12, parameters=())
    assert diagnose.run(nothing).verdict == "consistent"
    sensors = (*imu_arm.IMU, "imu_quat")
    hidden = imu_arm.problem(2, sensors, runs=12, parameters=(), more_damping=0.04)
    assert not any(".r" in str(one.target) for one in instances_for(hidden, ["sensor_gain"]))
    (cause,) = diagnose.run(hidden).causes
    assert (cause.effect, cause.target) == ("joint_damping", "pitch")
    assert cause.estimate["damping"].value == pytest.approx(0.04, rel=0.05)
    far = replace(nothing, estimated=dict.fromkeys(nothing.estimated, 10.0))
    short = replace(diagnose, length=5, windows=90)
    assert short.run(nothing).verdict == "consistent"
    assert [one.effect for one in short.run(far).causes] == ["gravity_tilt"]
