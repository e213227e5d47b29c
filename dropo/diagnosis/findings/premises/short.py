"""Data that are short: numbers from a few seconds are rough."""

from dataclasses import dataclass

from dropo.core.contracts.problem import Problem
from dropo.core.services.tables import number


@dataclass(frozen=True)
class ShortSettings:
    """When data are short.

    Attributes
    ----------
    short : float
        Data of fewer seconds are, those held out among them.
    enough : float
        How many are recommended [s].
    """

    short: float = 5.0
    enough: float = 20.0


SHORT = ShortSettings()


def short_sentences(problem: Problem, settings: ShortSettings = SHORT) -> tuple[str, ...]:
    """Say that a problem's data are short.

    Parameters
    ----------
    problem : Problem
        A robot and its data.
    settings : ShortSettings, optional
        What is short.

    Returns
    -------
    tuple of str
        A sentence at most.
    """
    step = problem.simulator.control_step
    if step is None:
        return ()
    held_out = 0 if problem.held_out is None else len(problem.held_out)
    seconds = step * (len(problem.trajectories) + held_out)
    if seconds >= settings.short:
        return ()
    return (
        f"The data are {number(seconds, 3)} s long, which is short: numbers and their errors are "
        f"rough. Record {number(settings.enough, 3)} s or more, better several runs, in which all "
        "joints move.",
    )
