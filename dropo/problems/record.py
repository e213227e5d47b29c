"""What a problem is, as JSON: its settings, and sums of all that is behind it."""

import hashlib
import math
from dataclasses import asdict, fields
from typing import Any

import mujoco
import numpy as np

from dropo.core.contracts.prior import describe
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.plugin_files import plugin_sums
from dropo.mjmodel.files.loading import model_sum


def problem_record(problem: Problem) -> dict[str, Any]:
    """Collect the settings of a problem, with SHA-256 sums of all that is behind it.

    Parameters
    ----------
    problem : Problem
        The problem.

    Returns
    -------
    dict
        Plain values, by which another run of the same problem is recognized.
    """
    plugins = plugin_sums()
    simulator = problem.simulator
    model = simulator.model
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
        "whole_runs": problem.whole_runs,
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
    """Compute the SHA-256 of all arrays of trajectories, with their names and shapes.

    Parameters
    ----------
    trajectories : Trajectories
        The data.

    Returns
    -------
    str
        Hexadecimal digits.
    """
    digest = hashlib.sha256()
    for field in fields(trajectories):
        array = getattr(trajectories, field.name)
        if array is not None:
            digest.update(f"{field.name} {array.shape} {array.dtype}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def plain(value: Any) -> Any:
    """Make a value strict JSON.

    Parameters
    ----------
    value : object
        Anything.

    Returns
    -------
    object
        Containers, numbers and texts; None for numbers that are not finite, its repr for any other
        object.
    """
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else repr(value)
