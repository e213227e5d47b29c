"""A block on a slide whose predictions have known errors."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.problems.simulated.slide import NOISE
from dropo.simulators.toy import SlidingBlock, simulate

TRUTH = np.array([1.5, 0.8])


def problem(trajectories=40, noise=NOISE, **more):
    """A block of one mass and damping, pushed at random for 30 steps, measured with noise."""
    rng = np.random.default_rng(3)
    actions = np.repeat(rng.normal(0.0, 3.0, (trajectories, 6, 1)), 5, axis=1)
    values = np.repeat(TRUTH[None], trajectories, axis=0)
    data = simulate(SlidingBlock(), values, actions, np.zeros(2), noise_variance=noise, rng=rng)
    return Problem("block", SlidingBlock(), data, epsilon=noise, **more)
