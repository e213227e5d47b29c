"""Velocities of simulated logs are as far from the truth as the estimate says, and so are the
positions.
"""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.logs.signals.velocities import estimate_velocities, quantum
from tests.models.logged_arm import arm


def ball(time, height=1.0, bounce=0.93):
    """Height, velocity and the rows before which a ball bounced."""
    fall = np.sqrt(2 * height / 9.81)
    starts = [-fall]
    speeds = [9.81 * fall]
    while starts[-1] < time[-1]:
        starts.append(starts[-1] + 2 * speeds[-1] / 9.81)
        speeds.append(bounce * speeds[-1])
    which = np.searchsorted(starts, time, side="right") - 1
    since = time - np.array(starts)[which]
    speed = np.array(speeds)[which]
    return (
        speed * since - 4.905 * since**2,
        speed - 9.81 * since,
        np.flatnonzero(np.diff(which)) + 1,
    )


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize(
    ("rate", "noise", "step"),
    [
        (100, 2e-3, 0),
        (250, 5e-4, 0),
        (1000, 2e-3, 0),
        (250, 0, 1.5e-3),
        (500, 0, 1e-3),
        (500, 5e-4, 1e-3),
    ],
)
def test_stated_noise_levels_are_right(rate, noise, step):
    """Within 20 %: the sensor's noise, the smoothed positions' and velocities' errors; noisy,
    quantised and both, at uneven times.
    """
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.7, 1.3, 20 * rate)) / rate
    angle, velocity = arm(time)
    measured = angle + noise * rng.normal(size=len(time))
    measured = step * np.round(measured / step) if step else measured
    found = estimate_velocities(time, measured[:, None])
    inside = slice(10, -10)
    assert found.position_noise[0] == pytest.approx(rms(measured - angle), rel=0.2)
    assert found.velocity_noise[0] == pytest.approx(
        rms((found.velocities[:, 0] - velocity)[inside]), rel=0.2
    )
    assert found.smoothed_noise[0] == pytest.approx(
        rms((found.positions[:, 0] - angle)[inside]), rel=0.2
    )
    assert found.velocity_noise[0] < 0.3 * rms(np.gradient(measured, time) - velocity)
    assert len(found.jumps[0]) == 0


def test_a_filter_knows_the_past_alone():
    """Rows of the causal estimate do not change when the future does; its stated error is right,
    and larger than the smoother's.
    """
    rng = np.random.default_rng(0)
    time = np.arange(4000) / 400
    angle, velocity = arm(time)
    measured = (angle + 1e-3 * rng.normal(size=4000))[:, None]
    causal, smooth = (
        estimate_velocities(time, measured, noise=[1e-3], causal=causal) for causal in (True, False)
    )
    assert causal.causal
    assert not smooth.causal
    error = rms((causal.velocities[:, 0] - velocity)[20:])
    assert causal.velocity_noise[0] == pytest.approx(error, rel=0.2)
    assert error > 1.5 * rms(smooth.velocities[:, 0] - velocity)
    other = measured.copy()
    other[3000:] += 0.3 * np.sin(time[3000:, None])
    again = estimate_velocities(time, other, noise=[1e-3], causal=True)
    change = [
        rms((b.velocities - a.velocities)[2000:2990])
        for a, b in ((causal, again), (smooth, estimate_velocities(time, other)))
    ]
    assert change[0] < 0.2 * error  # by the bandwidth alone, which is one for the whole log
    assert rms((again.velocities - causal.velocities)[3000:]) > 10 * change[0]


def test_impacts_are_found_and_not_smoothed_across():
    """A bouncing ball: every bounce and none else is named; between them velocities are as exact as
    the estimate says.
    """
    rng = np.random.default_rng(1)
    time = np.arange(3000) / 500
    height, velocity, bounces = ball(time)
    found = estimate_velocities(time, (height + 2e-4 * rng.normal(size=3000))[:, None])
    np.testing.assert_array_equal(found.jumps[0], bounces)
    error = rms(found.velocities[:, 0] - velocity)
    assert found.velocity_noise[0] == pytest.approx(
        error, rel=0.35
    )  # ends of pieces make most of it, and they are few
    assert found.position_noise[0] == pytest.approx(2e-4, rel=0.2)
    assert error < 0.01 * rms(velocity)


def test_a_switched_command_is_no_impact():
    """Where the acceleration jumps, as under bang-bang control, the velocity does not."""
    rng = np.random.default_rng(2)
    time = np.arange(5000) / 500
    acceleration = 20 * np.sign(np.sin(2 * np.pi * 0.7 * time))
    velocity = np.cumsum(acceleration) / 500
    angle = np.cumsum(velocity) / 500
    found = estimate_velocities(time, (angle + 1e-3 * rng.normal(size=5000))[:, None])
    assert len(found.jumps[0]) == 0
    assert found.position_noise[0] == pytest.approx(1e-3, rel=0.2)


def test_columns_do_not_depend_on_each_other():
    """Two columns together are each alone; one that stands still has velocity 0 and noise 0."""
    rng = np.random.default_rng(4)
    time = np.arange(500) / 100
    columns = np.stack([arm(time)[0] + 1e-3 * rng.normal(size=500), np.full(500, 0.7)], axis=1)
    both = estimate_velocities(time, columns, causal=True)
    alone = estimate_velocities(time, columns[:, :1], causal=True)
    np.testing.assert_allclose(both.velocities[:, 0], alone.velocities[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(both.velocities[10:, 1], 0, atol=1e-4)
    assert both.position_noise[1] == 0


@pytest.mark.parametrize("rows", [20, 500])
def test_what_stands_still_has_no_velocity(rows):
    """Exactly 0, also in a few rows, and nothing is lost of it."""
    found = estimate_velocities(np.arange(rows) / 1000, np.full((rows, 1), -0.00145724))
    assert (found.velocities == 0).all()
    assert (found.positions == -0.00145724).all()
    assert (found.velocity_noise, found.smoothed_noise, found.position_noise) == (0, 0, 0)


def test_the_step_of_a_quantised_column_is_found():
    """Also through rounding of single precision; measurements that are not quantised have none."""
    rng = np.random.default_rng(5)
    walk = np.cumsum(rng.integers(-3, 4, 2000))
    assert quantum(walk * 0.0015) == pytest.approx(0.0015, rel=1e-6)
    assert quantum((walk * 0.0015).astype(np.float32).astype(float)) == pytest.approx(
        0.0015, rel=1e-3
    )
    assert quantum(rng.normal(size=2000)) == 0
    assert quantum(np.full(5, 0.3)) == 0


def test_refusals():
    """Few rows, time that stands still and a known noise of 0 are refused."""
    with pytest.raises(BadArgument, match="at least 7 rows"):
        estimate_velocities(np.arange(4), np.zeros((4, 1)))
    with pytest.raises(BadArgument, match="strictly increasing"):
        estimate_velocities([0, 1, 2, 2, 3, 4, 5, 6], np.zeros((8, 1)))
    broken = np.append(0.01 * np.arange(59), 1e308)
    with pytest.raises(BadArgument, match="without a step of more than 1e\\+09 usual ones"):
        estimate_velocities(broken, np.zeros((60, 1)))
    with pytest.raises(BadArgument, match="above 0"):
        estimate_velocities(np.arange(8), np.zeros((8, 1)), noise=[0])
