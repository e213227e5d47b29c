"""A block that slides with friction: the smallest problem, its answer known in closed form."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.simulators.toy import SlidingBlock, simulate

# kg, N s/m
MEAN = np.array([1.5, 0.8])
SD = np.array([0.1, 0.05])
NOISE = 1e-6  # variance, m^2 and m^2/s^2


def slide(threads: int = 0) -> Problem:
    """Mass and damping of a sliding block, another draw for each of 50 pushes; seconds, for trying
    things out.
    """
    masses, forces, noise = np.random.default_rng(50).spawn(3)
    simulator = SlidingBlock()
    values = MEAN + SD * masses.standard_normal((50, 2))
    actions = np.repeat(forces.normal(0.0, 3.0, (50, 4, 1)), 5, axis=1)
    data = simulate(simulator, values, actions, np.zeros(2), noise_variance=NOISE, rng=noise)
    truth = dict(zip(simulator.space.names, MEAN.tolist(), strict=True))
    return Problem("slide", simulator, data, epsilon=NOISE, truth=truth)
