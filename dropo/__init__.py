"""Makes robot simulators honest: fits the distribution of their parameters to measured motion, and
names what they get wrong.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dropo._version import __version__ as __version__

if TYPE_CHECKING:
    from dropo.core.contracts.fit_by_name import fit
    from dropo.core.contracts.problem import Problem
    from dropo.core.records.fit import Fit, Status
    from dropo.core.records.parameters import Parameter, ParameterSpace
    from dropo.core.records.task import Task
    from dropo.core.records.trajectories import Segments, Signal, Trajectories
    from dropo.core.services.errors import DropoError, InvalidInput
    from dropo.data.checks.check import check
    from dropo.data.describe import describe
    from dropo.data.reading import read
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
    from dropo.evaluation.bootstrap import bootstrap
    from dropo.evaluation.identifiability import identify
    from dropo.evaluation.next_data import rank_next
    from dropo.evaluation.predictions import predict
    from dropo.evaluation.profile import profile
    from dropo.logs.importing import import_logs
    from dropo.logs.signals.delays import estimate_clock, estimate_delay
    from dropo.logs.signals.resampling import resample, resample_rotations
    from dropo.logs.signals.states import estimate_states
    from dropo.logs.signals.velocities import estimate_velocities
    from dropo.mjmodel.fields import FieldParameter
    from dropo.problems.file.writer import write_problem
    from dropo.problems.loading import load
    from dropo.problems.simulated.hidden import hide
    from dropo.report.build import write_report
    from dropo.simulators.function import EnvSimulator, FunctionSimulator
    from dropo.simulators.gymnasium import GymnasiumSimulator
    from dropo.simulators.mujoco.simulator import MujocoSimulator
    from dropo.training.ars import ARS
    from dropo.training.environments import randomize
    from dropo.training.evaluate import evaluate
    from dropo.training.networks import PPO, SAC
    from dropo.training.policy import load_policy
    from dropo.training.train import train

_HOME = {
    "ADR": "dropo.estimators.adr",
    "ARS": "dropo.training.ars",
    "BayRn": "dropo.estimators.bayrn",
    "DROID": "dropo.estimators.droid",
    "DROPO": "dropo.estimators.dropo",
    "Diagnose": "dropo.diagnosis.diagnose",
    "Diagnosis": "dropo.diagnosis.result",
    "DropoError": "dropo.core.services.errors",
    "EPOpt": "dropo.estimators.epopt",
    "EnvSimulator": "dropo.simulators.function",
    "FieldParameter": "dropo.mjmodel.fields",
    "Fit": "dropo.core.records.fit",
    "FunctionSimulator": "dropo.simulators.function",
    "GymnasiumSimulator": "dropo.simulators.gymnasium",
    "InvalidInput": "dropo.core.services.errors",
    "LeastSquares": "dropo.estimators.least_squares",
    "MujocoSimulator": "dropo.simulators.mujoco.simulator",
    "NPE": "dropo.estimators.npe",
    "PPO": "dropo.training.networks",
    "Parameter": "dropo.core.records.parameters",
    "ParameterSpace": "dropo.core.records.parameters",
    "Posterior": "dropo.estimators.posterior",
    "Problem": "dropo.core.contracts.problem",
    "RandomEffects": "dropo.estimators.random_effects",
    "SAC": "dropo.training.networks",
    "Segments": "dropo.core.records.trajectories",
    "Signal": "dropo.core.records.trajectories",
    "SimOpt": "dropo.estimators.simopt",
    "Status": "dropo.core.records.fit",
    "Task": "dropo.core.records.task",
    "Trajectories": "dropo.core.records.trajectories",
    "UniformRandomization": "dropo.estimators.uniform_randomization",
    "bootstrap": "dropo.evaluation.bootstrap",
    "check": "dropo.data.checks.check",
    "describe": "dropo.data.describe",
    "diagnose": "dropo.diagnosis.diagnose",
    "estimate_clock": "dropo.logs.signals.delays",
    "estimate_delay": "dropo.logs.signals.delays",
    "estimate_states": "dropo.logs.signals.states",
    "estimate_velocities": "dropo.logs.signals.velocities",
    "evaluate": "dropo.training.evaluate",
    "fit": "dropo.core.contracts.fit_by_name",
    "hide": "dropo.problems.simulated.hidden",
    "identify": "dropo.evaluation.identifiability",
    "import_logs": "dropo.logs.importing",
    "load": "dropo.problems.loading",
    "load_policy": "dropo.training.policy",
    "predict": "dropo.evaluation.predictions",
    "profile": "dropo.evaluation.profile",
    "randomize": "dropo.training.environments",
    "rank_next": "dropo.evaluation.next_data",
    "read": "dropo.data.reading",
    "resample": "dropo.logs.signals.resampling",
    "resample_rotations": "dropo.logs.signals.resampling",
    "train": "dropo.training.train",
    "write_problem": "dropo.problems.file.writer",
    "write_report": "dropo.report.build",
}

__all__ = [
    "ADR",
    "ARS",
    "DROID",
    "DROPO",
    "NPE",
    "PPO",
    "SAC",
    "BayRn",
    "Diagnose",
    "Diagnosis",
    "DropoError",
    "EPOpt",
    "EnvSimulator",
    "FieldParameter",
    "Fit",
    "FunctionSimulator",
    "GymnasiumSimulator",
    "InvalidInput",
    "LeastSquares",
    "MujocoSimulator",
    "Parameter",
    "ParameterSpace",
    "Posterior",
    "Problem",
    "RandomEffects",
    "Segments",
    "Signal",
    "SimOpt",
    "Status",
    "Task",
    "Trajectories",
    "UniformRandomization",
    "bootstrap",
    "check",
    "describe",
    "diagnose",
    "estimate_clock",
    "estimate_delay",
    "estimate_states",
    "estimate_velocities",
    "evaluate",
    "fit",
    "hide",
    "identify",
    "import_logs",
    "load",
    "load_policy",
    "predict",
    "profile",
    "randomize",
    "rank_next",
    "read",
    "resample",
    "resample_rotations",
    "train",
    "write_problem",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for, so that `dropo --help` imports none."""
    if name == "plots":
        return import_module("dropo.plots")
    if name not in _HOME:
        raise AttributeError(
            f"module 'dropo' has no attribute {name!r}", name=name, obj=import_module("dropo")
        )  # Python names the nearest
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "plots", "__version__"]
