"""Data sets of a problem, drawn anew from a seed where that can be done."""

from collections.abc import Callable
from functools import partial

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import names
from dropo.core.services.validation import Array, known
from dropo.evaluation.bootstrap import redrawn
from dropo.problems.loading import is_file, load
from dropo.problems.simulated.hidden import NOISE, hide
from dropo.problems.simulated.slide import slide_data
from dropo.studies.tiboni_2021.hopper_sets import data_set as hopper_set

Drawn = tuple[Problem, Array | None]
"""A problem on one thread, and the parameters (G, d) behind each group of its data, if known."""
TABLES = {
    "hopper": ("6.1", "clean"),
    "hopper-noisy": ("6.1", "noisy"),
    "table-6.2": ("6.2", "clean"),
    "table-6.2-noisy": ("6.2", "noisy"),
    "table-6.3": ("6.3", "clean"),
    "table-6.3-noisy": ("6.3", "noisy"),
}
"""Problem -> the thesis' table, and its kind of data."""


def problem_names() -> list[str]:
    """List the names that `data_set` takes.

    Returns
    -------
    list of str
        The built-in problems, and the thesis' tables.
    """
    return sorted({*names("problems"), *TABLES})


def data_set(
    problem: str, seed: int, transitions: int | None = None
) -> tuple[Problem, Array | None]:
    """Draw a data set of a problem.

    Simulated problems are recorded anew, with other actions, parameters and noise for each seed. Of
    measured ones, and of problem files, seed 0 is the data themselves, and the others are pieces of
    them drawn with replacement.

    Parameters
    ----------
    problem : str
        One of `problem_names`, or a problem file.
    seed : int
        Seed of the data.
    transitions : int or None
        Use the first ones alone; None for all.

    Returns
    -------
    problem : Problem
        On one thread.
    mean : (d,) array or None
        The mean of the parameters behind these data.

    Raises
    ------
    UnknownName
        If there is no such problem; the message gives the nearest name.
    InvalidInput
        If the problem is refused.
    """
    made, values = _maker(problem)(seed)
    if transitions is not None:
        made = made.using(transitions=min(transitions, len(made.trajectories)))
    if values is None:
        return made, None
    group = made.trajectories.group
    used = values if len(values) == 1 or group is None else values[np.unique(group)]
    return made, used.mean(axis=0)


def _maker(problem: str) -> Callable[[int], Drawn]:
    """What draws the data sets of a problem."""
    if is_file(problem):
        return partial(_resampled, problem)
    known("problem", problem, problem_names())
    if problem in TABLES:
        return partial(_of_table, *TABLES[problem])
    if problem in NOISE:
        return partial(_recorded, problem)
    if problem == "slide":
        return slide_data
    return partial(_resampled, problem)


def _of_table(table: str, kind: str, seed: int) -> Drawn:
    """The thesis' data, and the masses that were drawn."""
    return hopper_set(table, kind, seed)


def _recorded(problem: str, seed: int) -> Drawn:
    """A recording of a simulated robot."""
    made = hide(problem, (), seed=seed, threads=1)
    return made, _truth(made)


def _resampled(problem: str, seed: int) -> Drawn:
    """The data as they are, or pieces of them drawn anew."""
    made = load(problem, threads=1, trusted=False)
    if seed > 0:
        made = redrawn(made, np.random.default_rng(seed))
    return made, _truth(made)


def _truth(problem: Problem) -> Array | None:
    """The true parameters (1, d), if all are known."""
    truth = problem.truth or {}
    if set(problem.space.names) - set(truth):
        return None
    return np.array([[truth[name] for name in problem.space.names]])
