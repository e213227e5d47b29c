"""Sensors in data, beside what the model's own show along the motion."""

from dataclasses import replace

import numpy as np

from dropo.data.checks.check import check, find_error
from dropo.data.checks.sensors import SensorPair, check_sensors
from tests.models import imu_arm


def test_data_that_the_motion_contradicts():
    """Nothing is odd in an arm's rows; a gyro in deg/s is an error before any fit."""
    problem = imu_arm.problem(3, runs=2)
    data = problem.trajectories
    assert check(data, problem) == []
    scale = np.ones(data.observations.shape[1])
    scale[2:5] = 180 / np.pi
    wrong = replace(
        data,
        observations=data.observations * scale,
        next_observations=data.next_observations * scale,
    )
    found = find_error(wrong, problem.simulator)
    assert found.signal == "sensordata.imu_gyro"
    assert "its numbers are in deg/s, not rad/s" in found.sentence


def pairs(gyro=1.0, acceleration=1.0, axis=(0.0, 1.0, 0.0)):
    """A gyro about one axis and an accelerometer in the plane across it, each with a factor."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(200, 1)) * axis
    falls = rng.normal(size=(200, 3)) * [3.0, 0.0, 1.0] + [0.0, 0.0, 9.8]
    return [
        SensorPair("sensordata.gyro", "site 0", "rad/s", gyro * turns, turns),
        SensorPair("sensordata.acc", "site 0", "m/s^2", acceleration * falls, falls),
    ]


def test_the_smallest_change_is_named():
    """Of what explains a motion in a plane; two faults at once may be a joint's one."""
    assert list(check_sensors(pairs())) == []
    (sign,) = check_sensors(pairs(acceleration=-1.0))
    assert sign.advice == "Map `sign: -1` of sensordata.acc."
    (both,) = check_sensors(pairs(-1.0, -1.0))
    assert "Map `sign: -1` of sensordata.gyro, and map `sign: -1` of sensordata.acc." in both.advice
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])
    mirrored = [replace(one, measured=one.measured @ swap) for one in pairs()]
    (finding,) = check_sensors(mirrored)
    assert "`rotation: [" in finding.advice


def test_what_nothing_explains():
    """A sensor of something else is a warning; one that hardly moves says nothing."""
    gyro, _ = pairs(axis=(1.0, 1.0, 0.5))
    other = replace(gyro, measured=np.random.default_rng(1).normal(size=(200, 3)))
    (finding,) = check_sensors([other])
    assert finding.level == "warning"
    still = replace(gyro, modelled=0.01 * gyro.modelled)
    assert list(check_sensors([still])) == []
