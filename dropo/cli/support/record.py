"""The record of a run: everything that decides its result, as JSON.

The number of threads is not in it, since results do not depend on it.
"""

import argparse
import platform
import shlex
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from dropo._version import __version__
from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.predictions import Predictions
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.files.places import way_to, without_root
from dropo.problems.record import plain, problem_record


def run_record(
    command: str, method: str, estimator: Estimator, problem: Problem, seed: int
) -> dict[str, Any]:
    """Make the header of an evaluation log, which is the content of run.json.

    Parameters
    ----------
    command, method : str
        Their names.
    estimator : Estimator
        The method with its settings.
    problem : Problem
        What is fitted.
    seed : int
        Of the run.

    Returns
    -------
    dict
    """
    names = [field.name for field in fields(estimator)]  # type: ignore[arg-type]
    settings = {name: plain(getattr(estimator, name)) for name in names}
    return {
        "command": command,
        "method": method,
        "settings": settings,
        "seed": seed,
        "version": __version__,
        **problem_record(problem),
    }


def diagnosis_record(arguments: argparse.Namespace, problem: Problem) -> dict[str, Any]:
    """Make the content of a diagnosis' run.json.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    problem : Problem
        What is diagnosed.

    Returns
    -------
    dict
    """
    options = ("quick", "effects", "reference", "hide", "steps", "disturbances")
    settings = {name: plain(getattr(arguments, name)) for name in options}
    if arguments.wiring != "auto":
        settings["wiring"] = arguments.wiring
    return {
        "command": "diagnose",
        "settings": settings,
        "seed": arguments.seed,
        "version": __version__,
        **problem_record(problem),
    }


def keep_for_report(arguments: argparse.Namespace, predictions: Predictions | None) -> None:
    """Write what a report shows beside the result: predictions.npz and made.json.

    Parameters
    ----------
    arguments : argparse.Namespace
        With `out`, the folder, and the command, which made.json keeps with the versions behind it;
        absolute paths by their way from the working folder.
    predictions : Predictions or None
        What the model predicts; None where the result keeps it.
    """
    if predictions is not None:
        predictions.save(arguments.out)
    path = Path(arguments.problem)
    versions = {
        "Python": platform.python_version(),
        **{name: version(name) for name in ("mujoco", "numpy", "scipy")},
        "on": platform.platform(),
    }
    made = {
        "command": shlex.join(map(without_root, shlex.split(arguments.command_line))),
        "problem": way_to(path, arguments.out) if path.is_file() else arguments.problem,
        "versions": versions,
    }
    write_json(arguments.out / "made.json", made)
