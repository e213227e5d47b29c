"""The data sets of the thesis' tables 6.1 to 6.3, drawn anew from a seed.

Beside them, what the thesis found on its own.
"""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import NOISE, hopper_problem

MASSES = ("m1", "m2", "m3", "m4")  # torso, thigh, leg, foot
MEAN = np.array(list(TRUTH.values()))  # [kg]
SPREAD = {
    "6.1": np.zeros(4),
    "6.2": np.array([0.5, 1e-5, 1e-5, 1e-5]),
    "6.3": np.array([1e-5, 0.25, 0.25, 0.25]),
}
"""Table -> standard deviations of the masses [kg]."""
EPSILON = {"clean": 1e-8, "noisy": NOISE}
BLOCK = 10  # transitions under one draw of the masses
PUBLISHED_STEPS = 5000 * 100 * 1000 * 4
"""Simulator steps of the thesis' fit: evaluations x K x transitions x physics steps."""

THESIS: dict[tuple[str, str, str], tuple[tuple[float, ...], tuple[float, ...]]] = {
    ("6.1", "clean", "dropo"): ((3.534, 3.927, 2.714, 5.089), (1.0e-5, 1.1e-5, 1.1e-5, 1.0e-5)),
    ("6.1", "clean", "droid"): ((3.534, 3.927, 2.714, 5.089), (1.2e-12, 2.1e-12, 2.0e-12, 1.1e-12)),
    ("6.1", "noisy", "dropo"): ((3.534, 3.927, 2.714, 5.089), (1.0e-5,) * 4),
    ("6.1", "noisy", "droid"): ((3.534, 3.927, 2.714, 5.089), (1.2e-12, 2.4e-11, 2.0e-12, 1.2e-12)),
    ("6.2", "clean", "dropo"): ((3.524, 3.927, 2.714, 5.090), (0.478, 3.1e-4, 3.4e-4, 1.1e-5)),
    ("6.2", "clean", "droid"): (
        (3.465, 3.925, 2.715, 5.097),
        (4.91e-10, 4.59e-10, 9.36e-10, 2.97e-10),
    ),
    ("6.2", "noisy", "dropo"): (
        (3.652, 3.926, 2.719, 5.096),
        (2.32e-12, 1.19e-11, 3.96e-11, 1.16e-11),
    ),
    ("6.2", "noisy", "droid"): (
        (3.664, 3.942, 2.722, 5.101),
        (6.07e-11, 5.99e-11, 2.51e-10, 4.74e-11),
    ),
    ("6.3", "clean", "dropo"): ((3.534, 3.873, 2.704, 5.083), (0.0004, 0.280, 0.259, 0.226)),
    ("6.3", "clean", "droid"): (
        (3.531, 3.843, 2.741, 5.145),
        (4.91e-10, 4.59e-10, 9.36e-10, 2.97e-10),
    ),
    ("6.3", "noisy", "dropo"): ((3.537, 3.912, 2.721, 5.105), (0.005, 0.242, 0.216, 0.237)),
    ("6.3", "noisy", "droid"): (
        (3.544, 3.901, 2.711, 5.124),
        (1.01e-10, 2.52e-10, 4.04e-10, 6.93e-11),
    ),
}
"""(table, data, method) -> the means and the scales [kg] that it prints."""


@dataclass(frozen=True)
class HopperStudySize:
    """How large a study is; the defaults are the thesis' own, and what its text asks for.

    Attributes
    ----------
    transitions : int
        Transitions of a data set, in two trajectories.
    seeds : int
        Number of data sets.
    starts : int
        Random starts of one fit.
    droid : int
        Evaluations of DROID.
    draws : int
        Simulations of a distribution by which likelihoods are compared.
    published : (int, int, int)
        K, evaluations, and the stride between transitions, at which the published method is run.
    full : (int, int)
        K and evaluations of the thesis, on all transitions.
    """

    transitions: int = 1000
    seeds: int = 20
    starts: int = 20
    droid: int = 1000
    draws: int = 128
    published: tuple[int, int, int] = (10, 2000, 10)
    full: tuple[int, int] = (100, 5000)


FULL = HopperStudySize()


def data_set(
    table: str, kind: str, seed: int, transitions: int = 1000, *, threads: int = 1
) -> tuple[Problem, Array]:
    """Draw a data set of a table.

    Parameters
    ----------
    table : str
        "6.1", "6.2" or "6.3".
    kind : str
        "clean" or "noisy".
    seed : int
        Seed of the data.
    transitions : int
        Number of transitions, in two trajectories.
    threads : int
        Of the simulator.

    Returns
    -------
    problem : Problem
        The problem.
    masses : (B, 4) array
        Masses [kg] behind its data: other ones every 10 transitions, the truth in table 6.1.
    """
    noise = NOISE if kind == "noisy" else 0.0

    def masses(rng: np.random.Generator, blocks: int) -> Array:
        return MEAN + SPREAD[table] * rng.standard_normal((blocks, 4))

    varies = table != "6.1"
    data, sample = simulate(
        transitions // 2,
        2,
        rng=seed,
        masses=masses if varies else None,
        block=BLOCK if varies else None,
        noise_variance=noise,
    )
    name = f"table {table}, {kind}, data set {seed}"
    return hopper_problem(name, data, EPSILON[kind], threads=threads), sample


def every(stride: int, problem: Problem) -> Problem:
    """Thin a problem's data.

    Parameters
    ----------
    stride : int
        Every `stride`-th transition stays.
    problem : Problem
        The problem.

    Returns
    -------
    Problem
        The same with fewer transitions.
    """
    rows = np.arange(0, len(problem.trajectories), stride)
    return replace(problem, trajectories=problem.trajectories.rows(rows), everything=None)
