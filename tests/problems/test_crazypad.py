"""Flights of a quadrotor as a problem: states from positions alone, commands of both kinds of logs.

What needs the measured data is skipped where they are not at hand.
"""

import mujoco
import numpy as np
import pytest

from dropo import load
from dropo.core.contracts.effect import instances_of
from dropo.data.outliers.outlier_runs import OutlierRunSettings, fit_run
from dropo.problems.measured.crazypad import (
    AIRBORNE,
    FULL_COMMAND,
    FULL_THRUST,
    commanded,
    flown,
    states_of,
    yaw,
)
from dropo.problems.measured.external_data import find_data
from tests.models.quadrotor import MIXER, Flight, flights, fly

STEP = 0.01


def test_positions_give_tilt_and_rates():
    """On a circle at a constant speed with a turning heading: the thrust leans inward by a / g, and
    the rates are those of the rotation, within the kernel's loss.
    """
    time = np.arange(0, 10, STEP)
    turn, radius = 1.5, 0.4
    circle = radius * np.stack([np.cos(turn * time), np.sin(turn * time), 0 * time], axis=1)
    states = states_of(circle, 0.2 * time, STEP)[100:-100]
    inward = radius * turn**2 / 9.81
    upright = np.empty((len(states), 3))
    turned = np.empty((len(states), 3))
    for i, quaternion in enumerate(states[:, 3:7]):
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, quaternion)
        upright[i] = matrix.reshape(3, 3)[:, 2]
        after = quaternion.copy()
        mujoco.mju_quatIntegrate(after, states[i, 10:], STEP)
        turned[i] = after[1:] * np.sign(after[0])
    lean = np.linalg.norm(upright[:, :2], axis=1) / upright[:, 2]
    np.testing.assert_allclose(lean, inward, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(states[:, 7:10], axis=1), radius * turn, rtol=0.01)
    following = states[1:, 4:7] * np.sign(states[1:, 3:4])
    np.testing.assert_allclose(turned[:-1], following, atol=2e-5)


def test_controller_logs_are_mixed_as_the_firmware_does():
    """Roll raises the left rotors, pitch the front ones, yaw those that turn counter-clockwise; no
    command leaves its range.
    """
    run = {"cmd": [[30000, 0, 0, 0], [30000, 2000, 0, 0], [30000, 0, 400, 0], [65000, 0, 0, 3000]]}
    found = commanded({key: np.array(values) for key, values in run.items()}) * FULL_COMMAND
    away = np.round(found - found[:1])
    np.testing.assert_array_equal(away[1], [-1000, -1000, 1000, 1000])
    np.testing.assert_array_equal(away[2], [200, -200, -200, 200])
    np.testing.assert_allclose(found[3], [65535, 62000, 65535, 62000])


def test_the_heading_is_what_was_logged():
    """Yaw without jumps, else the gyro's integral, else 0."""
    time = np.arange(100) * STEP
    jumping = np.mod(3.0 + time + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(yaw({"time": time, "yaw": jumping}), 3.0 + time)
    gyro = np.stack([0 * time, 0 * time, 2 * time], axis=1)
    np.testing.assert_allclose(yaw({"time": time, "gyro": gyro}), time**2, atol=1e-12)
    assert not yaw({"time": time}).any()


def test_a_flight_is_cut_to_what_is_in_the_air():
    """Without the ground, and around a gap in the log; commands are newtons."""
    log = fly(Flight(), np.random.default_rng(0), seconds=6.0)
    log["pos"][:60, 2] = 0.01
    whole = flown(log, STEP)
    assert len(whole) == 1
    _, states, thrusts = whole[0]
    assert states[:, 2].min() > AIRBORNE
    np.testing.assert_allclose(thrusts.sum(axis=1).mean(), 0.027 * 9.81, rtol=0.01)
    rows = np.r_[:300, 320:550]
    parts = flown({name: values[rows] for name, values in log.items()}, STEP)
    gap = 0.5 * (log["time"][300] + log["time"][319]) - log["time"][0]
    assert len(parts) == 2
    assert parts[0][0][-1] < gap < parts[1][0][0]


def test_the_mixer_of_the_simulated_drone_lifts_evenly():
    """A total thrust alone goes to all rotors in equal parts."""
    np.testing.assert_allclose(MIXER @ [4 * FULL_THRUST, 0, 0, 0], FULL_THRUST, rtol=1e-12)


@pytest.mark.skipif(
    find_data("crazypad/runs.npz") is None,
    reason="the measured data are not at hand (DROPO_DATA names their folder)",
)
def test_the_flights_are_whole():
    """32 flights, each in at least its two legs, six of them normal; no fit, so no parameters."""
    problem = load("crazypad", threads=1)
    names = set(problem.run_names)
    assert len(names) == 32
    assert len(problem.run_names) == len(problem.trajectories.spans) >= 64
    assert sum("normal_flight" in name for name in names) == 6
    assert len(problem.space) == 0
    assert 25_000 < len(problem.trajectories) < 55_000


def test_a_flight_has_one_answer():
    """Gains found from 0 and from far below agree, since velocities lag as the model's own do.

    Without the lag, positions and velocities ask for thrusts that differ by a tenth, and a robust
    fit takes either side.
    """
    problem = flights({"weak": Flight(gain=(-0.3, -0.2, -0.3, -0.2))}, seed=5, normal=0)
    simulator = problem.simulator
    found = instances_of(simulator.effect_context, "actuator_gain")
    gains = simulator.with_effects([one for one in found if one.target])
    settings = OutlierRunSettings(windows=100)
    starts = (np.zeros(4), np.full(4, -0.45))
    fits = [fit_run(gains, problem.trajectories, start, 1, settings) for start in starts]
    np.testing.assert_allclose(fits[0].value, fits[1].value, atol=1e-3)
    assert np.all(np.abs(fits[0].value - [-0.3, -0.2, -0.3, -0.2]) < 0.05)
