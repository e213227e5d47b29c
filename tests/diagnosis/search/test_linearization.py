"""Looks at windows: what starts are in doubt by."""

from dataclasses import replace

import numpy as np

from dropo import Diagnose
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.registry import find
from dropo.diagnosis.search.library import instances_for
from dropo.diagnosis.search.linearization import (
    Library,
    estimate_noise,
    linearize,
    shift_linearization,
    whitener,
)
from dropo.diagnosis.search.whitening import Whitener, white
from dropo.diagnosis.search.windows import split
from dropo.problems.simulated.robots import simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.hidden_in_arm import problem

NOISE = 1e-4


def late_arm():
    """Windows of an arm whose fast joint's velocity comes 2 ms late, with that delay at hand: the
    library and the windows.
    """
    robot = simulated_robot("torque-arm")
    instance = next(
        a
        for a in find("effects", "sensor_delay")(robot.simulator.effect_context)
        if a.target == "qvel.elbow"
    )
    data = robot.record([(instance, np.array([0.002]))], noise=NOISE, rng=np.random.default_rng(0))
    arm = Problem("arm", robot.simulator, data, start_noise=True)
    return Library(robot.simulator.with_effects([instance]), [instance], 0), split(arm, 5, 96)[0]


def test_starts_of_a_late_velocity_are_in_doubt():
    """Under the true delay and noise most windows are off by what is expected, (chi-squared)
    squared length by entry about 1; without the doubt in starts by a hundred times that.
    """
    library, windows = late_arm()
    theta = np.array([0.002])
    noise = white(np.full(4, NOISE))
    linearized = linearize(library, windows, theta, noise)
    length = (
        np.median(linearized.whiten.distances(linearized.residuals)) / linearized.residuals.shape[1]
    )
    certain = whitener(
        Library(simulated_robot("torque-arm").simulator, (), 0),
        windows,
        np.zeros(0),
        noise,
        linearized.loadings,
    )
    assert 0.5 < length < 2
    assert np.median(certain.distances(linearized.residuals)) / linearized.residuals.shape[1] > 100


def test_a_number_beyond_its_bounds_has_no_slope():
    """Neither side of it can be simulated within them: 0, without a warning."""
    given = problem([], name="position-arm", seed=3000)
    instances = instances_for(given, ["joint_damping"], np.array([], dtype=np.int64))
    library = Library(given.simulator.with_effects(instances), instances, len(given.space))
    train, _ = split(given, 5, 16)
    theta = np.array(library.simulator.nominal)
    free = library.indices_of[instances[0].label]
    assert np.any(library.jacobian(theta, free, train))
    theta[free] = 2 * library.simulator.space.high[free]
    assert not np.any(library.jacobian(theta, free, train))


def test_doubt_follows_theta():
    """A look that moves to another delay takes that delay's doubt, as a look that is taken there
    does; without one there is none.
    """
    library, windows = late_arm()
    noise = white(np.full(4, NOISE))
    prompt = linearize(library, windows, np.zeros(1), noise)
    there = shift_linearization(library, prompt, np.array([0.002]), noise)
    doubt = library.simulator.extra_start_sd(np.array([0.002]), windows.segments)
    assert prompt.extra_loadings.shape[2] == 0
    np.testing.assert_allclose(
        there.extra_loadings[..., 0], there.loadings[..., 3] * doubt[:, 3:], rtol=1e-12
    )
    assert np.array_equal(
        shift_linearization(library, there, np.zeros(1), noise).log_likelihood,
        prompt.log_likelihood,
    )


def test_noise_is_learned_beside_doubt():
    """At the true delay the noise of prompt signals within a tenth, of the late one within a third,
    from three times too high; without the doubt the late one is off by more than its double.
    """
    library, windows = late_arm()
    wrong = white(np.full(4, 3 * NOISE))
    linearized = linearize(library, windows, np.array([0.002]), wrong)
    found = estimate_noise(linearized, wrong, np.full(4, 1e-9))
    assert np.all(np.abs(found.sigma / NOISE - 1) < [0.1, 0.1, 0.1, 1 / 3])
    certain = estimate_noise(
        replace(linearized, whiten=Whitener(linearized.loadings, np.tile(wrong.sigma, 2), wrong)),
        wrong,
        np.full(4, 1e-9),
    )
    assert certain.sigma[3] > 2 * NOISE


def test_delay_of_a_fast_joints_velocity_is_named(monkeypatch):
    """Its size within four standard errors, which are below a thousandth of it, and nothing is
    left; with starts taken to be off by noise alone they are five times as large.
    """
    delay = 0.006
    late = problem([("sensor_delay:qvel.elbow", [delay])])
    effects = ["sensor_delay", "sensor_gain", "joint_damping", "joint_friction"]
    run = Diagnose(effects, windows=16).run
    found = run(late)
    size = found.causes[0].estimate["delay"]
    assert [(cause.effect, cause.target) for cause in found.causes] == [
        ("sensor_delay", "qvel.elbow")
    ]
    assert abs(size.value - delay) < 4 * size.se < 4e-3 * delay
    assert found.verdict == "explained"
    monkeypatch.setattr(MujocoSimulator, "extra_start_sd", Simulator.extra_start_sd)
    assert run(late).causes[0].estimate["delay"].se > 5 * size.se
