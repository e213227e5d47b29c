"""Runs of a block that is pushed, with noise on every state."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.trajectory import Trajectory
from dropo.simulators.toy import SlidingBlock, simulate

SEED = 77_000
TRUTH = np.array([1.5, 0.8])
SD = np.array([2e-3, 1e-2])


def block(seed=0, runs=12, steps=60, spread=0.0, simulator=None):
    """Noisy states of a sliding block that is pushed at random; each run may have parameters of its
    own.
    """
    rng = np.random.default_rng([SEED, seed])
    forces = np.repeat(rng.normal(0, 3, (runs, steps // 5, 1)), 5, axis=1)
    values = TRUTH * np.exp(spread * rng.standard_normal((runs, 2)))
    clean = simulate(simulator or SlidingBlock(), values, forces, np.zeros(2))
    states = np.concatenate(
        [
            clean.observations.reshape(runs, steps, 2),
            clean.next_observations.reshape(runs, steps, 2)[:, -1:],
        ],
        axis=1,
    )
    states = states + SD * rng.standard_normal(states.shape)
    data = replace(
        clean,
        observations=states[:, :-1].reshape(-1, 2),
        next_observations=states[:, 1:].reshape(-1, 2),
    )
    return Problem("block", SlidingBlock(), data)


def along_runs(problem, likelihood=None, noise=None):
    """What the likelihood finds from the middle of the box."""
    likelihood = likelihood or Trajectory()
    noise = noise or Noise(np.full(len(problem.simulator.signals), 1e-2), "each")
    space = problem.space
    run = Run(problem, np.random.default_rng(0))
    family = TruncatedGaussian(space)
    return likelihood.fit_runs(problem, run, family, noise, (space.low + space.high) / 2)
