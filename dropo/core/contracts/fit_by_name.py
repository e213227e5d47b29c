"""A method by its name, with the settings that its caller, then the problem, then the method itself
suggest.
"""

from dataclasses import fields
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
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
    """Fits the problem as `dropo fit` does: `fit(problem, "droid", budget=500)` is `dropo fit
    PROBLEM --method droid --budget 500`.

    method: a name of `dropo list methods`; settings: those of the method's class, by name; what is
    left out is as the problem says, else the method's own default. UnknownName for a name that does
    not exist, Incompatible for a setting that the method does not take.
    """
    return estimator_for(problem, method, settings).fit(problem, rng=rng)


def estimator_for(problem: Problem, method: str, given: dict[str, Any]) -> Estimator:
    """The method with the given settings, and the problem's own where it has such; names are
    checked.
    """
    require(
        isinstance(problem, Problem),
        "problem",
        "a Problem, which dropo.load makes of a name or a file",
        problem,
        "fit",
    )
    made = find("methods", method)
    takes = [field.name for field in fields(made)]
    for name, value in given.items():
        if name not in takes:
            raise Incompatible(
                f"method {method!r} takes no {name}. It takes {', '.join(takes) or 'no settings'}."
            )
        if name in NAMED and isinstance(value, str):
            find(NAMED[name], value)
    settings = {name: value for name, value in problem.settings.items() if name in takes} | given
    if (
        "draws" in settings
        and "draws" not in given
        and not _draws(settings.get("likelihood", getattr(made, "likelihood", None)))
    ):
        del settings["draws"]
    estimator: Estimator = made(**settings)
    return estimator


def _draws(likelihood: Any) -> bool:
    """Whether a likelihood, by its name, takes a number of draws; a method without one decides
    itself.
    """
    return not isinstance(likelihood, str) or "draws" in [
        field.name for field in fields(find("likelihoods", likelihood))
    ]
