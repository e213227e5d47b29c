"""Makes robot simulators honest: fits the distribution of a simulator's parameters to measured motion."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dropo.core.data import Segments, Signal, Trajectories
    from dropo.core.fit import Fit, Status
    from dropo.core.parameters import Parameter, ParameterSpace
    from dropo.core.problem import Problem
    from dropo.core.recipe import fit
    from dropo.data.reader import read
    from dropo.estimators.droid import DROID
    from dropo.estimators.dropo import DROPO
    from dropo.estimators.least_squares import LeastSquares
    from dropo.estimators.posterior import Posterior
    from dropo.estimators.uniform_randomization import UniformRandomization
    from dropo.problems.reader import load
    from dropo.simulators.fields import FieldParameter
    from dropo.simulators.general import EnvSimulator, FunctionSimulator
    from dropo.simulators.gymnasium import GymnasiumSimulator
    from dropo.simulators.mujoco import MujocoSimulator

__version__ = "0.1.0"

_HOME = {
    "DROID": "dropo.estimators.droid",
    "DROPO": "dropo.estimators.dropo",
    "EnvSimulator": "dropo.simulators.general",
    "FieldParameter": "dropo.simulators.fields",
    "Fit": "dropo.core.fit",
    "FunctionSimulator": "dropo.simulators.general",
    "GymnasiumSimulator": "dropo.simulators.gymnasium",
    "LeastSquares": "dropo.estimators.least_squares",
    "MujocoSimulator": "dropo.simulators.mujoco",
    "Parameter": "dropo.core.parameters",
    "ParameterSpace": "dropo.core.parameters",
    "Posterior": "dropo.estimators.posterior",
    "Problem": "dropo.core.problem",
    "Segments": "dropo.core.data",
    "Signal": "dropo.core.data",
    "Status": "dropo.core.fit",
    "Trajectories": "dropo.core.data",
    "UniformRandomization": "dropo.estimators.uniform_randomization",
    "fit": "dropo.core.recipe",
    "load": "dropo.problems.reader",
    "read": "dropo.data.reader",
}

__all__ = [
    "DROID", "DROPO", "EnvSimulator", "FieldParameter", "Fit", "FunctionSimulator", "GymnasiumSimulator", "LeastSquares",
    "MujocoSimulator", "Parameter", "ParameterSpace", "Posterior", "Problem", "Segments", "Signal", "Status", "Trajectories",
    "UniformRandomization", "fit", "load", "read",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for, so that `dropo --help` imports none."""
    if name not in _HOME:
        raise AttributeError(f"module 'dropo' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
