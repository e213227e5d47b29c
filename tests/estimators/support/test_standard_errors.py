"""What standard errors rest on where there is no noise."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.estimators.support.standard_errors import rounding_errors
from dropo.simulators.toy import LinearSimulator, simulate


def test_errors_of_rounding_are_moves_of_the_estimate():
    """By a relative error of all motions of a signal, one signal at a time, in quadrature: in units
    of float64's precision they are what weighted least squares does with a larger one.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    truth = np.tile([1.0, -2.0], (30, 1))
    actions = rng.normal(size=(30, 1, 2))
    data = simulate(simulator, truth, actions, np.ones(3), noise_variance=0.0, rng=rng)
    problem = Problem("line", simulator, data)
    noise = np.array([1.0, 4.0, 0.25])
    jacobian = simulator.linearize(truth[0], problem.segments)[1]
    design = np.asarray(jacobian / np.sqrt(noise)[:, None]).reshape(-1, 2)
    change = data.next_observations - data.observations
    moves = []
    for signal in range(3):
        further = np.zeros_like(change)
        further[:, signal] = 1e-3 * change[:, signal]
        moves.append(np.linalg.lstsq(design, (further / np.sqrt(noise)).ravel(), rcond=None)[0])
    expected = np.linalg.norm(moves, axis=0) / 1e-3
    found = rounding_errors(problem, jacobian, noise) / np.finfo(float).eps
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert (rounding_errors(problem, np.zeros_like(jacobian), noise) == 0).all()
