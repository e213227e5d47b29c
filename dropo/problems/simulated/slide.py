"""A block that slides with friction: the smallest problem, its answer known in closed form."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.simulators.toy import SlidingBlock, simulate

MEAN = np.array([1.5, 0.8])  # [kg], [N s/m]
SD = np.array([0.1, 0.05])  # [kg], [N s/m]
PUSHES = 50
NOISE = 1e-6  # variance, [m^2] and [m^2/s^2]


def slide(threads: int = 0) -> Problem:
    """Mass and damping of a sliding block, drawn anew for each of 50 pushes.

    A fit takes seconds, for trying things out.

    Parameters
    ----------
    threads : int
        Not used; every problem takes it.

    Returns
    -------
    Problem
    """
    return slide_data(50)[0]


def slide_data(seed: int) -> tuple[Problem, Array]:
    """The pushes of a seed.

    Parameters
    ----------
    seed : int
        Of parameters, forces and noise.

    Returns
    -------
    problem : Problem
        As `slide`.
    values : (50, 2) array
        The parameters of each push.
    """
    values_rng, forces_rng, noise_rng = np.random.default_rng(seed).spawn(3)
    simulator = SlidingBlock()
    values = MEAN + SD * values_rng.standard_normal((PUSHES, 2))
    # Each push is four forces, held for five control steps each.
    actions = np.repeat(forces_rng.normal(0.0, 3.0, (PUSHES, 4, 1)), 5, axis=1)
    data = simulate(simulator, values, actions, np.zeros(2), noise_variance=NOISE, rng=noise_rng)
    truth = dict(zip(simulator.space.names, MEAN.tolist(), strict=True))
    return Problem("slide", simulator, data, epsilon=NOISE, truth=truth), values
