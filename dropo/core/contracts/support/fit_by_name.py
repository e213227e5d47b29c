"""A method by its name, with the settings of the caller, then the problem's, then its own."""

from dataclasses import fields
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.likelihood import AUTOMATIC
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import require

NAMED = {"likelihood": "likelihoods", "optimizer": "optimizers", "family": "families"}
"""Settings that name a plug-in, and its kind."""


def fit(
    problem: Problem,
    method: str = "dropo",
    *,
    rng: np.random.Generator | int | None = 0,
    **settings: Any,
) -> Fit:
    """Fit a problem as the command `dropo fit` does.

    `fit(problem, "droid", budget=500)` is `dropo fit PROBLEM --method droid --budget 500`.

    Parameters
    ----------
    problem : Problem
        What was measured, and the simulator.
    method : str
        A name that `dropo list methods` prints.
    rng : numpy.random.Generator, int or None
        Whatever `numpy.random.default_rng` takes.
    **settings
        Settings of the method's class by name. What is left out is as the problem says, else the
        method's own default.

    Returns
    -------
    Fit
        The distribution of the parameters, and what it cost to find.

    Raises
    ------
    UnknownName
        If a name does not exist; the message gives the nearest valid one.
    Incompatible
        If the method has no such setting.
    BadArgument
        If the problem is no `Problem`, or a setting breaks a rule.
    """
    return estimator_for(problem, method, settings).fit(problem, rng=rng)


def estimator_for(problem: Problem, method: str, given: dict[str, Any]) -> Estimator:
    """Make a method with the settings that its caller, then the problem, suggest.

    Parameters
    ----------
    problem : Problem
        Its `settings` hold where the caller gives none.
    method : str
        The method's name.
    given : dict
        The caller's settings by name.

    Returns
    -------
    Estimator

    Raises
    ------
    UnknownName, Incompatible, BadArgument
        As `fit`.
    """
    rule = "a Problem, which dropo.load makes of a name or a file"
    require(isinstance(problem, Problem), "problem", rule, problem, "fit")
    kind = find("methods", method)
    takes = [field.name for field in fields(kind)]
    for name, value in given.items():
        if name not in takes:
            raise Incompatible(
                f"method {method!r} takes no {name}. It takes {', '.join(takes) or 'no settings'}."
            )
        if name in NAMED and isinstance(value, str):
            find(NAMED[name], value)
    settings = {name: value for name, value in problem.settings.items() if name in takes} | given
    # The problem's number of draws is for likelihoods that take one.
    if "draws" in settings and "draws" not in given:
        likelihood = settings.get("likelihood", getattr(kind, "likelihood", None))
        if not _takes_draws(likelihood):
            del settings["draws"]
    estimator: Estimator = kind(**settings)
    return estimator


def _takes_draws(likelihood: Any) -> bool:
    """Whether a likelihood, by its name, takes a number of draws; True for a method without one."""
    if not isinstance(likelihood, str):
        return True
    if likelihood == AUTOMATIC:
        return False
    return "draws" in [field.name for field in fields(find("likelihoods", likelihood))]
