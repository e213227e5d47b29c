"""Linearization in the parameters and in the start states."""

import numpy as np
import pytest

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.simulators.function import FunctionSimulator

MATRIX = np.array([[1.0, 0.1], [-0.4, 0.9]])


def linear(values, starts, actions):
    """x' = A x + (xi, a), exactly linear in the start."""
    out = np.empty((*actions.shape[:2], 2))
    state = starts
    for j in range(actions.shape[1]):
        state = state @ MATRIX.T + np.stack(
            [np.full(len(state), values[0]), actions[:, j, 0]], axis=1
        )
        out[:, j] = state
    return out


def exploding(values, starts, actions):
    out = linear(values, starts, actions)
    out[starts[:, 0] > 0] = np.nan
    return out


def simulator(function=linear):
    return FunctionSimulator(function, [Parameter("xi", -1.0, 1.0)], ["x", "v"])


def data(seed=0):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(13, 2))
    return Trajectories(rows[:-1], rng.normal(size=(12, 1)), rows[1:], np.arange(12) == 11)


@pytest.mark.parametrize("step", [None, [0.3, 0.02]])
@pytest.mark.parametrize("length", [1, 3])
def test_jacobians_in_the_starts_of_a_linear_system(length, step):
    """Powers of the matrix in every row, whatever the step; the prediction is that of `predict`;
    one batch of 2 s + 1.
    """
    made = simulator()
    segments = data().segments(length)
    prediction, jacobian = made.linearize_starts([0.3], segments, step=step)
    assert made.steps == 5 * 12
    np.testing.assert_array_equal(prediction, made.predict([[0.3]], segments)[0])
    expected = np.linalg.matrix_power(MATRIX, length)
    np.testing.assert_allclose(jacobian, np.broadcast_to(expected, jacobian.shape), atol=1e-9)


def test_chained_segments_are_moved_one_at_a_time():
    """With `partial` resets of x, a later segment answers to its own x alone: v comes from the
    segment before.
    """
    made = simulator()
    segments = data().segments(2, reset="partial", set_columns=[True, False])
    _, jacobian = made.linearize_starts([0.3], segments)
    whole = np.linalg.matrix_power(MATRIX, 2)
    later = segments.previous >= 0
    assert later.sum() == 5
    np.testing.assert_allclose(jacobian[~later], [whole], atol=1e-9)
    np.testing.assert_allclose(
        jacobian[later], np.broadcast_to(whole * [1, 0], (5, 2, 2)), atol=1e-9
    )


def test_refusals():
    """A step of another length; a simulation that diverges, with its parameters."""
    with pytest.raises(BadArgument, match="step"):
        simulator().linearize_starts([0.3], data().segments(1), step=[0.1])
    with pytest.raises(SimulationFailed, match=r"diverged, .* xi = 0\.3"):
        simulator(exploding).linearize_starts([0.3], data().segments(1))
