"""Data sets like the built-in problem `slide`: pushes of a sliding block, each with its own draw of
mass and damping.
"""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.simulators.toy import SlidingBlock, simulate

# kg, N s/m
MEAN = np.array([1.5, 0.8])
SD = np.array([0.1, 0.05])
NOISE = 1e-6


def pushes(
    seed, *, mean=MEAN, sd=SD, noise=NOISE, count=50, grouped=True, simulator=None, **settings
):
    """A Problem of `count` pushes of 20 transitions; grouped: whether the data say which rows share
    a draw.
    """
    values, forces, rest = np.random.default_rng(seed).spawn(3)
    simulator = simulator or SlidingBlock()
    drawn = mean + sd * values.standard_normal((count, 2))
    actions = np.repeat(forces.normal(0.0, 3.0, (count, 4, 1)), 5, axis=1)
    data = simulate(
        simulator, drawn, actions, np.zeros(2), noise_variance=np.asarray(noise), rng=rest
    )
    return Problem("pushes", simulator, data if grouped else replace(data, group=None), **settings)


def z_of_mean(fit, truth):
    """(d,) how many of its standard errors the fit's mean lies from the truth."""
    return (fit.mean - truth) / fit.mean_se


def z_of_sd(fit, truth):
    """(d,) likewise of the standard deviation, whose error is the scale's in proportion."""
    return (fit.sd - truth) / (fit.scale_se * fit.sd / fit.scale)
