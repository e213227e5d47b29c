"""Makes robot simulators honest: fits the distribution of their parameters to measured motion, and names what they get wrong."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dropo.analysis.bootstrap import bootstrap
    from dropo.analysis.identifiability import identify
    from dropo.analysis.next_data import rank_next
    from dropo.analysis.profile import profile
    from dropo.core.data import Segments, Signal, Trajectories
    from dropo.core.errors import DropoError, Refused
    from dropo.core.fit import Fit, Status
    from dropo.core.parameters import Parameter, ParameterSpace
    from dropo.core.problem import Problem
    from dropo.core.recipe import fit
    from dropo.data.reader import read
    from dropo.diagnosis.diagnose import Diagnose, diagnose
    from dropo.diagnosis.result import Diagnosis
    from dropo.estimators.droid import DROID
    from dropo.estimators.dropo import DROPO
    from dropo.estimators.least_squares import LeastSquares
    from dropo.estimators.posterior import Posterior
    from dropo.estimators.random_effects import RandomEffects
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
    "Diagnose": "dropo.diagnosis.diagnose",
    "Diagnosis": "dropo.diagnosis.result",
    "DropoError": "dropo.core.errors",
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
    "RandomEffects": "dropo.estimators.random_effects",
    "Refused": "dropo.core.errors",
    "Segments": "dropo.core.data",
    "Signal": "dropo.core.data",
    "Status": "dropo.core.fit",
    "Trajectories": "dropo.core.data",
    "UniformRandomization": "dropo.estimators.uniform_randomization",
    "bootstrap": "dropo.analysis.bootstrap",
    "diagnose": "dropo.diagnosis.diagnose",
    "fit": "dropo.core.recipe",
    "identify": "dropo.analysis.identifiability",
    "load": "dropo.problems.reader",
    "profile": "dropo.analysis.profile",
    "rank_next": "dropo.analysis.next_data",
    "read": "dropo.data.reader",
}

__all__ = [
    "DROID", "DROPO", "Diagnose", "Diagnosis", "DropoError", "EnvSimulator", "FieldParameter", "Fit", "FunctionSimulator",
    "GymnasiumSimulator", "LeastSquares", "MujocoSimulator", "Parameter", "ParameterSpace", "Posterior", "Problem", "RandomEffects",
    "Refused", "Segments", "Signal", "Status", "Trajectories", "UniformRandomization", "bootstrap", "diagnose", "fit", "identify",
    "load", "profile", "rank_next", "read",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for, so that `dropo --help` imports none."""
    if name == "plots":
        return import_module("dropo.plots")
    if name not in _HOME:
        raise AttributeError(f"module 'dropo' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
