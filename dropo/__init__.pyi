from . import plots as plots
from ._version import __version__ as __version__
from .core.contracts.problem import Problem as Problem
from .core.contracts.support.fit_by_name import fit as fit
from .core.numerics.kept_rows import MemorySettings as MemorySettings
from .core.records.fits.fit import Fit as Fit
from .core.records.fits.fit import Status as Status
from .core.records.parameters import Parameter as Parameter
from .core.records.parameters import ParameterSpace as ParameterSpace
from .core.records.task import Task as Task
from .core.records.trajectories import (
    Segments as Segments,
)
from .core.records.trajectories import (
    Signal as Signal,
)
from .core.records.trajectories import (
    Trajectories as Trajectories,
)
from .core.services.errors import DropoError as DropoError
from .core.services.errors import InvalidInput as InvalidInput
from .core.services.registry import register as register
from .data.checks.check import check as check
from .data.describe import describe as describe
from .data.reading import read as read
from .diagnosis.diagnose import Diagnose as Diagnose
from .diagnosis.diagnose import diagnose as diagnose
from .diagnosis.result import Diagnosis as Diagnosis
from .estimators.adr import ADR as ADR
from .estimators.bayrn import BayRn as BayRn
from .estimators.droid import DROID as DROID
from .estimators.dropo import DROPO as DROPO
from .estimators.epopt import EPOpt as EPOpt
from .estimators.least_squares import LeastSquares as LeastSquares
from .estimators.npe import NPE as NPE
from .estimators.posterior import Posterior as Posterior
from .estimators.random_effects import RandomEffects as RandomEffects
from .estimators.simopt import SimOpt as SimOpt
from .estimators.uniform_randomization import UniformRandomization as UniformRandomization
from .evaluation.bootstrap import bootstrap as bootstrap
from .evaluation.identifiability import identify as identify
from .evaluation.next_data import rank_next as rank_next
from .evaluation.predictions import predict as predict
from .evaluation.profile import profile as profile
from .exports.export import export as export
from .logs.importing import import_logs as import_logs
from .logs.signals.delays import estimate_clock as estimate_clock
from .logs.signals.delays import estimate_delay as estimate_delay
from .logs.signals.resampling import resample as resample
from .logs.signals.resampling import resample_rotations as resample_rotations
from .logs.signals.states import estimate_states as estimate_states
from .logs.signals.velocities import estimate_velocities as estimate_velocities
from .logs.starting import init as init
from .mjmodel.fields import FieldParameter as FieldParameter
from .problems.file.writer import write_problem as write_problem
from .problems.loading import load as load
from .problems.simulated.hidden import hide as hide
from .report.build import write_report as write_report
from .simulators.function import (
    EnvSimulator as EnvSimulator,
)
from .simulators.function import (
    FunctionSimulator as FunctionSimulator,
)
from .simulators.gymnasium import GymnasiumSimulator as GymnasiumSimulator
from .simulators.mujoco.simulator import MujocoSimulator as MujocoSimulator
from .simulators.warp.simulator import WarpSimulator as WarpSimulator
from .studies.comparison.compare import compare as compare
from .training.ars import ARS as ARS
from .training.environments import randomize as randomize
from .training.evaluate import evaluate as evaluate
from .training.networks import PPO as PPO
from .training.networks import SAC as SAC
from .training.policy import load_policy as load_policy
from .training.train import train as train

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
    "MemorySettings",
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
    "WarpSimulator",
    "bootstrap",
    "check",
    "compare",
    "describe",
    "diagnose",
    "estimate_clock",
    "estimate_delay",
    "estimate_states",
    "estimate_velocities",
    "evaluate",
    "export",
    "fit",
    "hide",
    "identify",
    "import_logs",
    "init",
    "load",
    "load_policy",
    "predict",
    "profile",
    "randomize",
    "rank_next",
    "read",
    "register",
    "resample",
    "resample_rotations",
    "train",
    "write_problem",
    "write_report",
]
