"""Logs of positions alone: what is estimated is no cause, and what is hidden is found."""

from dataclasses import replace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.diagnosis.search.library import instances_for
from dropo.diagnosis.search.linearization import (
    FoundStartSettings,
    Library,
    estimate_noise,
    linearize,
)
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.studies.laws.machines import FINER, law_machine
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
    """A damping at its place, within a twentieth; the noise that is reported of a velocity is the
    error of its estimate, and explains all that a prediction is off from that.
    """
    found = Diagnose(SOME, windows=30, disturbances=False).run(
        positions_alone([("joint_damping:elbow", [0.05])], episodes=12)
    )
    ((effect, target, size),) = [
        (one.effect, one.target, one.estimate["damping"]) for one in found.causes
    ]
    assert (effect, target) == ("joint_damping", "elbow")
    assert size.value == pytest.approx(0.05, rel=0.05)
    error, noise = found.extended.horizons[0].units["rad/s"]
    assert error == pytest.approx(noise, rel=0.1)
    assert found.noise["qvel.elbow"] < 2 * noise


@pytest.fixture(scope="module")
def gantry():
    """Two slides on position servos whose commands jump, in their own physics steps; and the true
    velocities of all rows.
    """
    machine = law_machine("gantry")
    clean = machine.record([], np.random.default_rng(5), 1e-9)
    noise = machine.noise * np.random.default_rng(6).standard_normal((2, *clean.observations.shape))
    rows = clean.observations + noise[0]
    ends = clean.next_observations + noise[1]
    for first, last in clean.spans:
        ends[first : last - 1] = rows[first + 1 : last]
    made = machine.problem("gantry", replace(clean, observations=rows, next_observations=ends))
    own = made.simulator.with_integrator("RK4").with_finer_steps(FINER)
    return replace(made, simulator=own), clean.observations[:, 2:]


def test_starts_are_found_where_commands_jump(gantry):
    """A smoother bends where a command steps: its velocities are off by many of the errors that
    windows leave, and the encoders seem noisier than they are. Those that windows find are the true
    ones within these errors, and the noise is right.
    """
    problem, velocities = gantry
    windows, _ = split(problem, 20, 40)
    sigma = np.array([1e-4, 1e-4, 1.0, 1.0])
    rows = windows.segments.steps[:, 0]

    def found(rounds):
        """Errors of the starts in units of their own, and the noise of positions."""
        side = linearize(
            Library(problem.simulator, [], 0),
            windows,
            np.zeros(0),
            white(sigma),
            FoundStartSettings(rounds=rounds),
        )
        moved = side.whiten.latent(side.residuals)[:, 2:4]
        off = side.windows.segments.starts[:, 2:] + moved - velocities[rows]
        own = np.sqrt(np.diagonal(side.whiten.inner, axis1=1, axis2=2)[:, 2:4])
        noise = estimate_noise(side, white(sigma), np.array([1e-6, 1e-6, 1.0, 1.0]))
        return off / own, noise.sigma[:2] / sigma[:2]

    z, noise = found(FoundStartSettings().rounds)
    assert abs(np.mean(z**2) - 1) < 4 * np.sqrt(2 / z.size)
    assert np.all(np.abs(noise - 1) < 4 / np.sqrt(2 * 20 * len(windows)))
    z, _ = found(0)
    assert np.mean(z**2) - 1 > 4 * np.sqrt(2 / z.size)


def test_a_smoother_bends_without_noise(gantry):
    """Nothing is missing from the machine's own model; the encoders' noise is that which they have,
    and errors after all horizons are what it explains.
    """
    problem, _ = gantry
    found = Diagnose(["joint_friction", "joint_damping"], windows=24).run(problem)
    assert found.verdict == "consistent"
    assert found.noise["qpos.along"] == pytest.approx(1e-4, rel=0.15)
    for after in found.baseline.horizons:
        assert after.units["m"][0] < 1.5 * after.units["m"][1]


def test_an_imu_without_velocities():
    """Angles and an IMU: nothing is named where nothing is hidden, a damping where it is, with the
    orientation too, which has no gain. Nor is anything where starts are taken to be as far off as
    the arm is fast, in short windows, though an accelerometer shows the square of a velocity.
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
    assert short.run(far).verdict == "consistent"
