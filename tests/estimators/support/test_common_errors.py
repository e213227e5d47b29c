"""Errors that all estimated starts have in common, in standard errors."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from dropo.estimators.support.common_errors import common_coordinates, with_common_errors
from dropo.estimators.support.standard_errors import StandardErrors

NAMES = ("qpos.base[0]", "qvel.base[0]", "qvel.knee", "qpos.knee")
ESTIMATED = {"qpos.base[0]": 0.1, "qvel.base[0]": 0.2, "qvel.knee": 0.3}
ROWS = 50


class Linear:
    """Predictions of a knee that follow one parameter and the base's start."""

    signals = tuple(SimpleNamespace(name=name) for name in NAMES)
    start_size = len(NAMES)

    def predict(self, values, segments, offsets=None):
        """The knee's angle is the parameter, and twice the base's velocity."""
        out = np.zeros((1, ROWS, len(NAMES)))
        out[:, :, 3] = values[0, 0]
        if offsets is not None:
            out[:, :, 3] += 2 * offsets[:, :, 1] + 9 * offsets[:, :, 2]
            out[:, :, :2] += offsets[:, :, :2]
        return out

    def targets(self, segments):
        """Those of a parameter of 1."""
        return self.predict(np.ones((1, 1)), segments)[0]


def linear_problem(estimated):
    """A problem of such a machine."""
    return SimpleNamespace(simulator=Linear(), segments=range(ROWS), estimated=estimated)


def errors(known=0.5):
    """Standard errors of one parameter, of which the knee's angle alone tells."""
    jacobian = np.zeros((ROWS, len(NAMES), 1))
    jacobian[:, 3] = 1.0
    return StandardErrors(np.array([known]), np.full(1, np.nan), np.ones(1), jacobian)


@pytest.mark.parametrize("known", [0.5, np.nan])
def test_a_common_velocity_moves_the_parameter(known):
    """The base's velocity is off by 0.2 in all starts: the parameter by 0.4, whatever the rows
    are. The knee's own estimate is of each row, and what was estimated tells nothing.
    """
    problem = linear_problem(ESTIMATED)
    run = SimpleNamespace(counting=nullcontext)
    predicted = problem.simulator.predict(np.ones((1, 1)), None)[0]
    noise = np.array([1e-6, 1e-6, 1e-6, 0.04])
    found = with_common_errors(problem, run, np.ones(1), predicted, noise, errors(known))
    np.testing.assert_allclose(found.mean, np.sqrt(known**2 + 0.4**2))


def test_only_joints_whose_position_was_estimated():
    """Smoothed velocities of measured positions are no common errors."""
    assert common_coordinates(linear_problem(ESTIMATED)) == {0: 0.1, 1: 0.2}
    assert common_coordinates(linear_problem({"qvel.knee": 0.3})) == {}
