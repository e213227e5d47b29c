"""The steps of the Kalman filter and smoother, against conditional normal distributions and a slow
twin.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from dropo.core.numerics.kalman import Sensors, predict, smooth, update

PATH = Path(__file__).parents[2] / "reference" / "kalman_smoother.py"
SPEC = importlib.util.spec_from_file_location("kalman_smoother", PATH)
reference = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(reference)

INF = np.inf


def covariances(rng, *shape):
    root = rng.normal(size=shape)
    return root @ root.swapaxes(-1, -2)


def conditional(state, covariance, measured, variance):
    """Mean and covariance of a normal vector given noisy measurements of some components, by the
    textbook's formula.
    """
    seen = np.isfinite(variance)
    see = np.eye(len(state))[seen]
    total = see @ covariance @ see.T + np.diag(variance[seen])
    gain = covariance @ see.T @ np.linalg.inv(total)
    return state + gain @ (measured - state[seen]), covariance - gain @ see @ covariance


@pytest.mark.parametrize(
    "variance", [[0.3, 0.1, 0.2], [0.3, INF, 0.2], [INF, 0.1, 0.2], [INF, 0.1, INF]]
)
def test_an_update_is_the_conditional_distribution(variance):
    """All components, some beside each other or not, and one measured; the log density is that of
    the innovation.
    """
    rng = np.random.default_rng(0)
    variance = np.array(variance)
    seen = np.isfinite(variance)
    state = rng.normal(size=3)
    covariance = covariances(rng, 3, 3)
    measured = rng.normal(size=int(seen.sum()))
    found = update(state, covariance, measured, Sensors.of(variance))
    mean, spread = conditional(state, covariance, measured, variance)
    np.testing.assert_allclose(found.state, mean, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, spread, rtol=1e-11, atol=1e-13)
    total = covariance[np.ix_(seen, seen)] + np.diag(variance[seen])
    off = measured - state[seen]
    assert found.squared_distance == pytest.approx(off @ np.linalg.inv(total) @ off, rel=1e-12)
    expected = -0.5 * (off @ np.linalg.inv(total) @ off + np.log(np.linalg.det(total)))
    assert found.log_likelihood == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("variance", [[0.3, 0.1, 0.2], [INF, 0.1, INF]])
def test_trajectories_beside_each_other_are_those_alone(variance):
    """Leading axes broadcast in every step."""
    rng = np.random.default_rng(1)
    sensors = Sensors.of(np.array(variance))
    states = rng.normal(size=(5, 3))
    spreads = covariances(rng, 5, 3, 3)
    transition = rng.normal(size=(3, 3))
    process = 0.1 * np.eye(3)
    measured = rng.normal(size=(5, len(sensors.variance)))
    together = predict(states, spreads, transition, process)
    corrected = update(*together, measured, sensors)
    smoothed = smooth((states, spreads), transition, together, corrected[:2])
    for i in range(5):
        alone = predict(states[i], spreads[i], transition, process)
        found = update(*alone, measured[i], sensors)
        for one, all_of_them in zip(found, corrected, strict=True):
            np.testing.assert_allclose(all_of_them[i], one, rtol=1e-10, atol=1e-13)
        back = smooth((states[i], spreads[i]), transition, alone, found[:2])
        for one, all_of_them in zip(back, smoothed, strict=True):
            np.testing.assert_allclose(all_of_them[i], one, rtol=1e-10, atol=1e-12)


def test_steps_in_turn_are_the_slow_twin():
    """Filtered and smoothed states and the likelihood of motion as twice integrated white noise."""
    rng = np.random.default_rng(2)
    time = np.arange(40) * 0.1
    q = 3.0
    r = 0.04
    measured = np.sin(time) + 0.2 * rng.normal(size=40)
    smoothed, filtered, log_likelihood = reference.smooth(time, measured, 2, q, r, start=10.0)
    transition = np.array([[1.0, 0.1], [0.0, 1.0]])
    process = q * np.array([[0.1**3 / 3, 0.1**2 / 2], [0.1**2 / 2, 0.1]])
    sensors = Sensors.of(np.array([r, INF]))
    state = np.zeros(2)
    covariance = 10.0 * np.eye(2)
    before = []
    after = []
    total = 0.0
    for k, y in enumerate(measured):
        if k:
            state, covariance = predict(state, covariance, transition, process)
        before.append((state, covariance))
        found = update(state, covariance, np.array([y]), sensors)
        state = found.state
        covariance = found.covariance
        after.append((state, covariance))
        total += found.log_likelihood - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose([one for one, _ in after], filtered, rtol=1e-9, atol=1e-12)
    assert total == pytest.approx(log_likelihood, rel=1e-10)
    back = [after[-1]]
    for k in range(38, -1, -1):
        back.append(smooth(after[k], transition, before[k + 1], back[-1])[:2])
    np.testing.assert_allclose([one for one, _ in back[::-1]], smoothed, rtol=1e-8, atol=1e-10)


def test_covariances_stay_positive():
    """A start known to 1e5 and sensors that are exact to 1e-3: the least variance is right to 1e-4;
    by P - K H P it is 1 % off.
    """
    variance = 1e-6
    along = np.array([1.0, 0.9, 0.5])
    covariance = 1e10 * np.outer(along, along) + np.diag([1.0, 2.0, 3.0])
    found = update(
        np.zeros(3), covariance, np.ones(2), Sensors.of(np.array([variance, variance, INF]))
    )
    assert np.linalg.eigvalsh(found.covariance)[0] == pytest.approx(variance, rel=1e-4)
    plain = covariance - found.gain @ covariance[:2]
    assert np.linalg.eigvalsh(0.5 * (plain + plain.T))[0] != pytest.approx(variance, rel=1e-2)
