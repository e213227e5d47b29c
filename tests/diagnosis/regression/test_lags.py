"""Commands that lag, beside commands that are late."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.diagnosis.regression.kernels import apply_kernel, held_kernel, lagging_kernel
from dropo.diagnosis.regression.quick import QuickDiagnose, QuickSettings, estimate_missing
from dropo.problems.simulated.hidden import hide

WIDTH, STEP, TIME = 0.02, 0.01, 0.03  # [s]


def test_a_lags_kernel_smooths_what_follows_held_commands():
    """As a lag that is stepped finely and a Gaussian do; its weights add up to 1."""
    rng = np.random.default_rng(0)
    commands = rng.normal(size=(200, 1))
    fine = 100
    held = np.repeat(commands[:, 0], fine)
    keep = np.exp(-STEP / fine / TIME)
    lagging = np.zeros(len(held))
    for i in range(1, len(held)):
        lagging[i] = keep * lagging[i - 1] + (1 - keep) * held[i - 1]
    t = STEP / fine * np.arange(-8 * fine, 8 * fine + 1)
    gauss = np.exp(-0.5 * (t / WIDTH) ** 2)
    smooth = np.convolve(lagging, gauss / gauss.sum(), mode="same")[::fine]
    found = apply_kernel(lagging_kernel(WIDTH, STEP, 0.0, TIME), commands)[:, 0]
    np.testing.assert_allclose(found[60:-60], smooth[60:-60], atol=2e-3)
    assert lagging_kernel(WIDTH, STEP, 0.0, TIME).sum() == pytest.approx(1.0, abs=1e-3)


def test_a_short_lag_is_none():
    """Its kernel is nearly that of commands that are late by as much."""
    short = lagging_kernel(WIDTH, STEP, 0.004, 1e-4)
    late = held_kernel(WIDTH, STEP, 0.0041)
    middle = (len(short) - len(late)) // 2
    np.testing.assert_allclose(short[middle : len(short) - middle], late, atol=1e-4)


@pytest.mark.parametrize("robot", ["torque-arm", "position-arm"])
@pytest.mark.parametrize("late", ["actuator_lag", "actuator_delay"])
def test_commands_that_lag_are_told_from_those_that_are_late(robot, late):
    """One cause, of all drives, whose size is within its error."""
    (cause,) = QuickDiagnose().run(hide(robot, [f"{late}=0.03"], seed=0, threads=1)).causes
    assert (cause.effect, cause.target) == (late, None)
    ((_, size),) = cause.estimate.items()
    assert abs(size.value - 0.03) < 2 * size.se < 0.01


def test_a_lag_that_leaves_as_little_is_listed():
    """Beside the delay, at its place; the control: where it leaves more it is not."""
    problem = hide("position-arm", ["actuator_delay=0.016"], seed=0, threads=1)
    found = estimate_missing(problem, problem.trajectories, QuickSettings())
    assert found.rivals("actuator_delay", None) == ()
    (other,) = replace(found, or_lags=True).rivals("actuator_delay", "drive")
    assert (other.effect, other.target) == ("actuator_lag", "drive")
