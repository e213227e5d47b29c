"""The record of a run: everything that decides its result, as JSON.

The number of threads is not in it, since results do not depend on it.
"""

import argparse
import hashlib
import math
import os
import platform
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dropo._version import __version__
from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.prior import describe
from dropo.core.contracts.problem import Problem
from dropo.core.records.predictions import Predictions
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.atomic_write import write_json
from dropo.core.services.plugin_files import plugin_sums
from dropo.mjmodel.loading import model_sum


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
        With `out`, the folder, and the command, which made.json keeps with the versions behind it.
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
        "command": arguments.command_line,
        "problem": _place(path, arguments.out) if path.is_file() else arguments.problem,
        "versions": versions,
    }
    write_json(arguments.out / "made.json", made)


def _place(path: Path, folder: Path) -> str:
    """The way to a file from a folder, which may move with it."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def problem_record(problem: Problem) -> dict[str, Any]:
    """Make a dict of the settings of a `problem`, with SHA-256 sums of all that is behind it."""
    plugins = plugin_sums()
    simulator = problem.simulator
    model = getattr(simulator, "model", None)
    return {
        "problem": problem.name,
        "simulator": type(simulator).__name__,
        "parameters": [plain(asdict(parameter)) for parameter in problem.space],
        "signals": [signal.name for signal in simulator.signals],
        "steps_per_action": simulator.steps_per_action,
        "lambda": problem.horizon,
        "reset": problem.reset,
        "set_columns": plain(problem.set_columns),
        "every_step": problem.every_step,
        "epsilon": plain(problem.epsilon),
        "priors": {name: describe(prior) for name, prior in problem.priors.items()},
        "start_noise": problem.start_noise,
        "degrees": problem.noise_degrees,
        "transitions": len(problem.trajectories),
        "data_sha256": data_sum(problem.trajectories),
        "model_sha256": model_sum(model) if isinstance(model, mujoco.MjModel) else None,
        **({"plugins": plugins} if plugins else {}),
    }


def data_sum(trajectories: Trajectories) -> str:
    """Compute the SHA-256 of all arrays of `trajectories`, with their names and shapes."""
    digest = hashlib.sha256()
    for field in fields(trajectories):
        array = getattr(trajectories, field.name)
        if array is not None:
            digest.update(f"{field.name} {array.shape} {array.dtype}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def plain(value: Any) -> Any:
    """Make a `value` strict JSON: numbers that are not finite are null, objects their repr."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else repr(value)
