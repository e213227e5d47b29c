"""A fit whose residuals have structure says which usual effect they look like."""

import numpy as np
import pytest

from dropo import hide, load
from dropo.estimators.least_squares import LeastSquares
from dropo.evaluation.likely_cause import likely_cause
from dropo.problems.simulated.slide import slide

HIDDEN = {
    "joint_friction:elbow=0.05": "joint friction at elbow, frictionloss about 0.0",
    "actuator_delay=0.012": "actuator delay of all commands, delay about 0.0",
    "joint_armature:shoulder=0.01": "joint armature at shoulder, armature about 0.0",
    "actuator_gain:elbow_motor=-0.1": "actuator gain at elbow_motor, gain about -0.",
}


def fitted(problem):
    """Least squares on windows of five steps."""
    return LeastSquares().fit(problem.using(horizon=5, transitions=400), rng=0)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_is_hidden_is_what_they_look_like(hidden):
    """With its place and the order of its size, in one sentence that says what to do next."""
    fit = fitted(hide("torque-arm", [hidden], seed=3, threads=1))
    (said,) = [text for text in fit.warnings if "residuals look like" in text]
    assert HIDDEN[hidden] in said
    assert said.endswith("run `dropo diagnose`")
    size = float(said.split(" about ")[1].split()[0].rstrip(","))
    assert size == pytest.approx(float(hidden.split("=")[1]), rel=0.5)


def test_a_right_model_looks_like_nothing():
    """Nothing is said where nothing speaks against the model."""
    fit = fitted(load("torque-arm", threads=1))
    assert fit.trusted
    assert not any("look like" in text for text in fit.warnings)


def test_a_simulator_without_a_robot_has_no_effects():
    """The sliding block in closed form."""
    problem = slide()
    jacobian = np.ones((len(problem.segments), len(problem.simulator.signals), 2))
    assert likely_cause(problem, np.array([1.5, 0.8]), jacobian) is None
