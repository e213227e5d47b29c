"""Delays and clocks of simulated logs are found to a fraction of a time step, within what they say
of themselves.
"""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.logs.signals.delays import estimate_clock, estimate_delay
from tests.models.logged_arm import arm


@pytest.mark.parametrize("rate", [100, 1000])
@pytest.mark.parametrize("delay", [0.3e-3, 2.7e-3, -12e-3])
def test_a_delay_is_found(rate, delay):
    """Within 0.2 ms and 5 standard errors, under another gain and offset, with noise on both
    sensors and quantisation on one.
    """
    rng = np.random.default_rng(6)
    time = np.arange(0, 15, 1 / rate)
    reference = arm(time)[0] + 1e-3 * rng.normal(size=len(time))
    signal = 0.001 * np.round(
        (0.8 * arm(time - delay)[0] + 0.2 + 2e-3 * rng.normal(size=len(time))) / 0.001
    )
    found = estimate_delay(time, reference, signal)
    assert abs(found.seconds - delay) < min(0.2e-3, 5 * found.se)
    assert abs(found.seconds - delay - 1e-3) > 5 * found.se  # 1 ms more would be noticed
    assert found.explained > 0.99


def test_a_clock_that_runs_fast_is_found():
    """Delay within 0.2 ms and a skew of 1 % within 1e-5, between sensors of other rates and uneven
    stamps, and stamps are mapped back.
    """
    rng = np.random.default_rng(7)
    time = np.arange(0.2, 20, 1 / 200)
    true = np.cumsum(rng.uniform(0.7, 1.3, 5000)) / 300 + 0.4
    true = true[true < 19]
    stamps = true + 5e-3 + 0.01 * (true - time[0])
    reference, signal = (np.stack([arm(t)[0], arm(t + 1)[1] / 5], axis=1) for t in (time, true))
    found = estimate_clock(
        time,
        reference + 1e-3 * rng.normal(size=reference.shape),
        stamps,
        signal + 1e-3 * rng.normal(size=signal.shape),
    )
    assert abs(found.seconds - 5e-3) < min(0.2e-3, 5 * found.se)
    assert abs(found.skew - 0.01) < min(1e-5, 5 * found.skew_se)
    mapped = (stamps - found.seconds + found.skew * found.origin) / (1 + found.skew)
    np.testing.assert_allclose(mapped, true, atol=2e-4)
    assert np.abs(stamps - true).max() > 0.1


def test_standard_errors_hold():
    """Over 30 logs the errors are of the size that is stated: their mean square in standard errors
    is within 4.5 of its own from 1.
    """
    rng = np.random.default_rng(8)
    time = np.arange(0, 6, 1 / 100)
    scores = []
    for _ in range(30):
        found = estimate_delay(
            time,
            arm(time)[0] + 2e-3 * rng.normal(size=600),
            arm(time - 4e-3)[0] + 2e-3 * rng.normal(size=600),
        )
        scores.append((found.seconds - 4e-3) / found.se)
    assert abs(np.mean(np.square(scores)) - 1) < 4.5 * np.sqrt(2 / 30)
    assert abs(np.mean(scores)) < 4.5 / np.sqrt(30)


def test_unrelated_signals_explain_nothing():
    """Two motions that have nothing to do with each other: little is explained, where the same one
    explains all.
    """
    rng = np.random.default_rng(9)
    time = np.arange(0, 10, 1 / 100)
    noise = rng.normal(size=1000)
    assert estimate_delay(time, arm(time)[0], noise).explained < 0.05
    assert estimate_delay(time, arm(time)[0], arm(time)[0]).explained > 0.999


def test_refusals():
    """Other columns, a signal that stands still, and no room to search are refused."""
    time = np.arange(100) / 10
    with pytest.raises(BadArgument, match="of 1 columns"):
        estimate_delay(time, np.sin(time), np.zeros((100, 2)))
    with pytest.raises(BadArgument, match="moving"):
        estimate_delay(time, np.sin(time), np.ones(100))
    with pytest.raises(BadArgument, match="above 0"):
        estimate_delay(time, np.sin(time), np.sin(time), max_delay=0)
