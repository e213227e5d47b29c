"""Makes robot simulators honest: fits the distribution of their parameters to measured motion, and names what they get wrong."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dropo.analysis.bootstrap import bootstrap
    from dropo.analysis.identifiability import identify
    from dropo.analysis.next_data import rank_next
    from dropo.analysis.predictions import predict
    from dropo.analysis.profile import profile
    from dropo.core.data import Segments, Signal, Trajectories
    from dropo.core.errors import DropoError, Refused
    from dropo.core.fit import Fit, Status
    from dropo.core.parameters import Parameter, ParameterSpace
    from dropo.core.problem import Problem
    from dropo.core.recipe import fit
    from dropo.core.task import Task
    from dropo.data.check import check
    from dropo.data.delays import estimate_clock, estimate_delay
    from dropo.data.describe import describe
    from dropo.data.importing import import_logs
    from dropo.data.reader import read
    from dropo.data.resampling import resample, resample_rotations
    from dropo.data.smoother import estimate_states
    from dropo.data.velocities import estimate_velocities
    from dropo.diagnosis.diagnose import Diagnose, diagnose
    from dropo.diagnosis.result import Diagnosis
    from dropo.estimators.adr import ADR
    from dropo.estimators.bayrn import BayRn
    from dropo.estimators.droid import DROID
    from dropo.estimators.dropo import DROPO
    from dropo.estimators.epopt import EPOpt
    from dropo.estimators.least_squares import LeastSquares
    from dropo.estimators.npe import NPE
    from dropo.estimators.posterior import Posterior
    from dropo.estimators.random_effects import RandomEffects
    from dropo.estimators.simopt import SimOpt
    from dropo.estimators.uniform_randomization import UniformRandomization
    from dropo.problems.hidden import hide
    from dropo.problems.reader import load
    from dropo.problems.writer import write_problem
    from dropo.report.build import write_report
    from dropo.simulators.fields import FieldParameter
    from dropo.simulators.general import EnvSimulator, FunctionSimulator
    from dropo.simulators.gymnasium import GymnasiumSimulator
    from dropo.simulators.mujoco import MujocoSimulator
    from dropo.training.ars import ARS
    from dropo.training.environments import randomize
    from dropo.training.evaluate import evaluate
    from dropo.training.networks import PPO, SAC
    from dropo.training.policy import load_policy
    from dropo.training.train import train

__version__ = "0.1.0"

_HOME = {
    "ADR": "dropo.estimators.adr",
    "ARS": "dropo.training.ars",
    "BayRn": "dropo.estimators.bayrn",
    "DROID": "dropo.estimators.droid",
    "DROPO": "dropo.estimators.dropo",
    "Diagnose": "dropo.diagnosis.diagnose",
    "Diagnosis": "dropo.diagnosis.result",
    "DropoError": "dropo.core.errors",
    "EPOpt": "dropo.estimators.epopt",
    "EnvSimulator": "dropo.simulators.general",
    "FieldParameter": "dropo.simulators.fields",
    "Fit": "dropo.core.fit",
    "FunctionSimulator": "dropo.simulators.general",
    "GymnasiumSimulator": "dropo.simulators.gymnasium",
    "LeastSquares": "dropo.estimators.least_squares",
    "MujocoSimulator": "dropo.simulators.mujoco",
    "NPE": "dropo.estimators.npe",
    "PPO": "dropo.training.networks",
    "Parameter": "dropo.core.parameters",
    "ParameterSpace": "dropo.core.parameters",
    "Posterior": "dropo.estimators.posterior",
    "Problem": "dropo.core.problem",
    "RandomEffects": "dropo.estimators.random_effects",
    "Refused": "dropo.core.errors",
    "SAC": "dropo.training.networks",
    "Segments": "dropo.core.data",
    "Signal": "dropo.core.data",
    "SimOpt": "dropo.estimators.simopt",
    "Status": "dropo.core.fit",
    "Task": "dropo.core.task",
    "Trajectories": "dropo.core.data",
    "UniformRandomization": "dropo.estimators.uniform_randomization",
    "bootstrap": "dropo.analysis.bootstrap",
    "check": "dropo.data.check",
    "describe": "dropo.data.describe",
    "diagnose": "dropo.diagnosis.diagnose",
    "estimate_clock": "dropo.data.delays",
    "estimate_delay": "dropo.data.delays",
    "estimate_states": "dropo.data.smoother",
    "estimate_velocities": "dropo.data.velocities",
    "evaluate": "dropo.training.evaluate",
    "fit": "dropo.core.recipe",
    "hide": "dropo.problems.hidden",
    "identify": "dropo.analysis.identifiability",
    "import_logs": "dropo.data.importing",
    "load": "dropo.problems.reader",
    "load_policy": "dropo.training.policy",
    "predict": "dropo.analysis.predictions",
    "profile": "dropo.analysis.profile",
    "randomize": "dropo.training.environments",
    "rank_next": "dropo.analysis.next_data",
    "read": "dropo.data.reader",
    "resample": "dropo.data.resampling",
    "resample_rotations": "dropo.data.resampling",
    "train": "dropo.training.train",
    "write_problem": "dropo.problems.writer",
    "write_report": "dropo.report.build",
}

__all__ = [
    "ADR", "ARS", "DROID", "DROPO", "NPE", "PPO", "SAC", "BayRn", "Diagnose", "Diagnosis", "DropoError", "EPOpt", "EnvSimulator",
    "FieldParameter", "Fit", "FunctionSimulator", "GymnasiumSimulator", "LeastSquares", "MujocoSimulator", "Parameter",
    "ParameterSpace", "Posterior", "Problem", "RandomEffects", "Refused", "Segments", "Signal", "SimOpt", "Status", "Task",
    "Trajectories", "UniformRandomization", "bootstrap", "check", "describe", "diagnose", "estimate_clock", "estimate_delay",
    "estimate_states", "estimate_velocities", "evaluate", "fit", "hide", "identify", "import_logs", "load", "load_policy", "predict",
    "profile", "randomize", "rank_next", "read", "resample", "resample_rotations", "train", "write_problem", "write_report",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for, so that `dropo --help` imports none."""
    if name == "plots":
        return import_module("dropo.plots")
    if name not in _HOME:
        raise AttributeError(f"module 'dropo' has no attribute {name!r}", name=name, obj=import_module("dropo"))  # Python names the nearest
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "plots", "__version__"]
