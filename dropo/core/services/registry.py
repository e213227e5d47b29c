"""The names of plug-ins; each is imported when it is asked for, so `dropo list` imports none.

Other packages announce theirs as entry points of the group `dropo.<kind>`, for example
`dropo.optimizers`; a script, a notebook or a file that `--plugin` names calls `register`.
"""

import importlib
import re
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import known, require

_EFFECTS = (
    "bodies.body_mass",
    "bodies.body_com",
    "bodies.body_inertia",
    "bodies.payload",
    "joints.joint_damping",
    "joints.joint_friction",
    "joints.joint_stribeck",
    "joints.joint_stiffness",
    "joints.joint_armature",
    "joints.joint_load_friction",
    "joints.joint_cogging",
    "joints.joint_limit",
    "joints.tendon_damping",
    "joints.tendon_friction",
    "joints.tendon_armature",
    "actuators.actuator_gain",
    "actuators.actuator_bias",
    "actuators.actuator_delay",
    "actuators.actuator_lag",
    "actuators.actuator_coupling",
    "actuators.actuator_torque_speed",
    "actuators.actuator_saturation",
    "actuators.actuator_deadband",
    "bodies.gravity_tilt",
    "bodies.external_force",
    "bodies.air_drag",
    "bodies.wind",
    "bodies.contact_friction",
    "bodies.contact_stiffness",
    "sensors.sensor_bias",
    "sensors.sensor_gain",
    "sensors.sensor_delay",
    "sensors.sensor_polling",
    "joints.gear_lash",
    "parameter_drift",
    "law",
)
_MEASURED = "dropo.problems.measured"
BUILT_IN: dict[str, dict[str, str]] = {
    "methods": {
        "dropo": "dropo.estimators.dropo:DROPO",
        "random-effects": "dropo.estimators.random_effects:RandomEffects",
        "droid": "dropo.estimators.droid:DROID",
        "least-squares": "dropo.estimators.least_squares:LeastSquares",
        "uniform-randomization": "dropo.estimators.uniform_randomization:UniformRandomization",
        "posterior": "dropo.estimators.posterior:Posterior",
        "epopt": "dropo.estimators.epopt:EPOpt",
        "npe": "dropo.estimators.npe:NPE",
        "simopt": "dropo.estimators.simopt:SimOpt",
        "bayrn": "dropo.estimators.bayrn:BayRn",
        "adr": "dropo.estimators.adr:ADR",
    },
    "likelihoods": {
        "monte-carlo": "dropo.likelihoods.monte_carlo:MonteCarlo",
        "emulated": "dropo.likelihoods.emulated:Emulated",
        "linear": "dropo.likelihoods.linear:Linear",
        "unscented": "dropo.likelihoods.unscented:Unscented",
        "random-effects": "dropo.likelihoods.random_effects:RandomEffects",
        "trajectory": "dropo.likelihoods.trajectory:Trajectory",
        "ghurye-olkin": "dropo.likelihoods.ghurye_olkin:GhuryeOlkin",
    },
    "families": {
        "truncated_gaussian": "dropo.families.truncated_gaussian:TruncatedGaussian",
        "full": "dropo.families.full_gaussian:FullGaussian",
        "uniform": "dropo.families.uniform:Uniform",
        "point": "dropo.families.point:Point",
        "log_normal": "dropo.families.log_normal:LogNormal",
        "mixture": "dropo.families.mixture:Mixture",
    },
    "optimizers": {
        "cma-es": "dropo.optimizers.cma_es:CMAES",
        "cma-es-once": "dropo.optimizers.cma_es:CMAESOnce",
        "nlopt-bobyqa": "dropo.optimizers.nlopt:Bobyqa",
        "nlopt-sbplx": "dropo.optimizers.nlopt:Sbplx",
        "nlopt-crs2": "dropo.optimizers.nlopt:Crs2",
        "nlopt-direct-l": "dropo.optimizers.nlopt:DirectL",
        "nlopt-lbfgs": "dropo.optimizers.nlopt:Lbfgs",
        "nlopt-slsqp": "dropo.optimizers.nlopt:Slsqp",
        "scipy-nelder-mead": "dropo.optimizers.scipy:NelderMead",
        "scipy-l-bfgs-b": "dropo.optimizers.scipy:LbfgsB",
        "scipy-differential-evolution": "dropo.optimizers.scipy:DifferentialEvolution",
    },
    "samplers": {
        "emcee": "dropo.optimizers.samplers.emcee:Emcee",
        "pyro-nuts": "dropo.optimizers.samplers.pyro_nuts:PyroNuts",
        "pyro-svi": "dropo.optimizers.samplers.pyro_svi:PyroSvi",
    },
    "simulators": {
        "mujoco": "dropo.simulators.mujoco.simulator:MujocoSimulator",
        "warp": "dropo.simulators.warp.simulator:WarpSimulator",
        "gymnasium": "dropo.simulators.gymnasium:GymnasiumSimulator",
        "function": "dropo.simulators.function:FunctionSimulator",
        "env": "dropo.simulators.function:EnvSimulator",
        "linear": "dropo.simulators.toy:LinearSimulator",
        "sliding-block": "dropo.simulators.toy:SlidingBlock",
        "pendulum": "dropo.simulators.differentiable:Pendulum",
        "cart-pole": "dropo.simulators.differentiable:CartPole",
        "sliding-puck": "dropo.simulators.differentiable:SlidingPuck",
    },
    "effects": {
        name: f"dropo.effects.{module}:{name}"
        for module in _EFFECTS
        for name in [module.rpartition(".")[2]]
    },
    "readers": {  # of logs, by the ending of the file or the layout of the folder
        "csv": "dropo.logs.readers.tables:CsvLog",
        "tsv": "dropo.logs.readers.tables:CsvLog",
        "txt": "dropo.logs.readers.tables:CsvLog",
        "parquet": "dropo.logs.readers.tables:ParquetLog",
        "pq": "dropo.logs.readers.tables:ParquetLog",
        "npz": "dropo.logs.readers.archives:npz_log",
        "mcap": "dropo.logs.readers.bags:McapLog",
        "bag": "dropo.logs.readers.bags:RosLog",
        "db3": "dropo.logs.readers.bags:RosLog",
        "ros2": "dropo.logs.readers.bags:RosLog",
        "pt": "dropo.logs.readers.pace:PaceLog",
        "crazyflie": "dropo.logs.readers.crazyflie:CrazyflieLog",
        "sage": "dropo.logs.readers.sage:SageLog",
        "lerobot": "dropo.logs.readers.episodes:LeRobotLog",
        "minari": "dropo.logs.readers.episodes:MinariLog",
    },
    "problems": {
        "hopper": "dropo.problems.hopper.problem:hopper",
        "hopper-noisy": "dropo.problems.hopper.problem:hopper_noisy",
        "hopper-published": "dropo.problems.hopper.published:hopper_published",
        "hopper-published-noisy": "dropo.problems.hopper.published:hopper_published_noisy",
        "hopper-v5": "dropo.problems.hopper.v5:hopper_v5",
        "half-cheetah": "dropo.problems.simulated.recorded:half_cheetah",
        "walker2d": "dropo.problems.simulated.recorded:walker2d",
        "torque-arm": "dropo.problems.simulated.recorded:torque_arm",
        "position-arm": "dropo.problems.simulated.recorded:position_arm",
        "crazypad": "dropo.problems.measured.crazypad:crazypad",
        "cube-toss": "dropo.problems.measured.cube_toss:cube_toss",
        "double-pendulum": "dropo.problems.measured.double_pendulum:double_pendulum",
        "double-pendulum-c0": "dropo.problems.measured.double_pendulum:double_pendulum_c0",
        "simple-pendulum": "dropo.problems.measured.simple_pendulum:simple_pendulum",
        "swinging-pendulum": "dropo.problems.measured.swinging_pendulum:swinging_pendulum",
        "swinging-pendulum-double": f"{_MEASURED}.swinging_pendulum:swinging_pendulum_double",
        "so101": f"{_MEASURED}.servo_machines:so101",
        "go2": f"{_MEASURED}.servo_machines:go2",
        "slide": "dropo.problems.simulated.slide:slide",
        "sliding": "dropo.problems.panda.sliding:sliding",
        "pushing": "dropo.problems.panda.pushing:pushing",
    },
    "studies": {
        "table-6.1": "dropo.studies.tiboni_2021.table_6_1:table_6_1",
        "table-6.2": "dropo.studies.tiboni_2021.table_6_2:table_6_2",
        "table-6.3": "dropo.studies.tiboni_2021.table_6_3:table_6_3",
        "table-6.4": "dropo.studies.tiboni_2021.table_6_4:table_6_4",
        "figure-6.2": "dropo.studies.tiboni_2021.figure_6_2:figure_6_2",
        "figure-6.3": "dropo.studies.tiboni_2021.figure_6_3:figure_6_3",
        "figure-6.4": "dropo.studies.tiboni_2021.figure_6_4:figure_6_4",
        "calibration": "dropo.studies.intervals.calibration:calibration",
        "controls": "dropo.studies.intervals.controls:controls",
        "crazypad": "dropo.studies.crazypad.study:crazypad_study",
        "coverage": "dropo.studies.intervals.coverage:coverage",
        "first-models": "dropo.studies.first_models.study:first_models",
        "benchmark": "dropo.studies.benchmark.study:benchmark",
        "hidden-effects": "dropo.studies.hidden_effects.study:hidden_effects",
        "laws": "dropo.studies.laws.study:laws",
        "measured": "dropo.studies.measured.study:measured",
        "servos": "dropo.studies.measured.servos:servos",
        "hopper-v5": "dropo.studies.hidden_effects.hopper_v5:hopper_v5_study",
        "sliding": "dropo.studies.tiboni_2021.sliding:sliding_study",
        "pushing": "dropo.studies.tiboni_2021.pushing:pushing_study",
        "unlogged-base": "dropo.studies.unlogged_base.study:unlogged_base",
        "unlogged-states": "dropo.studies.unlogged_states.study:unlogged_states",
        "related-methods": "dropo.studies.related_methods.study:related_methods",
    },
    "exports": {
        "mujoco": "dropo.exports.plain:mujoco_python",
        "mjx": "dropo.exports.mjx:mjx",
        "playground": "dropo.exports.mjx:mjx",
        "mjlab": "dropo.exports.mjlab:mjlab",
        "isaac-lab": "dropo.exports.isaac_lab:isaac_lab",
        "bam": "dropo.exports.bam:bam",
        "effect": "dropo.exports.effect:effect",
    },
    "executors": {
        "threads": "dropo.executors.machine:threads",
        "processes": "dropo.executors.machine:processes",
        "joblib": "dropo.executors.machine:joblib",
        "dask": "dropo.executors.clusters:dask",
        "ray": "dropo.executors.clusters:ray",
        "slurm": "dropo.executors.slurm:slurm",
    },
}
SERVICES = {
    "randomize": "dropo.training.environments:randomize",
    "export": "dropo.exports.export:export",
}
"""Functions of rooms above that a lower room calls; such strings are here alone."""
_registered: dict[str, dict[str, Any]] = {kind: {} for kind in BUILT_IN}
_registered_by: dict[tuple[str, str], str] = {}
"""By kind and name, the module that called `register`."""
HINT = "One of your own needs its file: --plugin FILE, or `plugins` in a problem file."
"""What a message about an unknown name ends with."""
_NAME = re.compile(r"[a-z0-9]+(?:[-_][a-z0-9]+)*")


def register(kind: str, name: str, plugin: Callable[..., Any]) -> None:
    """Make a plug-in available by its name, in this process.

    Parameters
    ----------
    kind : str
        One of `kinds()`.
    name : str
        Its name: lower-case words or numbers joined by - or _, such as "random-search".
    plugin : callable
        A class or a function.

    Raises
    ------
    UnknownName
        If there is no such kind.
    BadArgument
        If the name is none, or is that of a built-in part or of one that another module
        registered.
    """
    known("kind of plug-in", kind, BUILT_IN)
    rule = "lower-case words or numbers joined by - or _, such as 'my-part'"
    require(is_name(kind, name), "name", rule, name, f"register({kind!r}, ...)")
    what = f"The {_singular(kind)} {name!r}"
    if name in BUILT_IN[kind]:
        raise BadArgument(f"{what} is built in. Give your own another name.")
    module = str(sys._getframe(1).f_globals.get("__name__"))
    owner = _registered_by.get((kind, name), module)
    if name in _registered[kind] and owner != module:
        raise BadArgument(
            f"{what} is registered already, by {owner}. Give one of the two another name."
        )
    _registered[kind][name] = plugin
    _registered_by[kind, name] = module


def is_name(kind: str, name: object) -> bool:
    """Tell whether a plug-in may have a name.

    Parameters
    ----------
    kind : str
        One of `kinds()`.
    name : object
        Lower-case words or numbers joined by - or _; numbers in the names of studies may have
        points.

    Returns
    -------
    bool
    """
    if not isinstance(name, str):
        return False
    words = re.sub(r"(?<=\d)\.(?=\d)", "-", name) if kind == "studies" else name
    return _NAME.fullmatch(words) is not None


def registered() -> dict[tuple[str, str], Any]:
    """Give what `register` made available, by kind and name.

    Returns
    -------
    dict
        The plug-ins, by kind and name.
    """
    parts = {}
    for kind, plugins in _registered.items():
        for name, plugin in plugins.items():
            parts[kind, name] = plugin
    return parts


def kinds() -> list[str]:
    """List what can be named: methods, likelihoods, families, ...

    Returns
    -------
    list of str
    """
    return sorted(BUILT_IN)


def names(kind: str) -> list[str]:
    """List the names of one kind, sorted.

    Parameters
    ----------
    kind : str
        One of `kinds()`.

    Returns
    -------
    list of str

    Raises
    ------
    UnknownName
        If there is no such kind.
    """
    known("kind of plug-in", kind, BUILT_IN)
    return sorted({*BUILT_IN[kind], *_outside(kind), *_registered[kind]})


def plugin_names(kind: str) -> list[str]:
    """List the names of one kind that are not built in, sorted.

    Parameters
    ----------
    kind : str
        One of `kinds()`.

    Returns
    -------
    list of str

    Raises
    ------
    UnknownName
        If there is no such kind.
    """
    return [name for name in names(kind) if name not in BUILT_IN[kind]]


def find(kind: str, name: str) -> Any:
    """Import a plug-in by its name.

    Parameters
    ----------
    kind : str
        One of `kinds()`.
    name : str
        Its name.

    Returns
    -------
    Any
        A class or a function.

    Raises
    ------
    UnknownName
        If there is none of that name; the message gives the nearest valid one.
    """
    known(_singular(kind), name, names(kind), HINT)
    if name in _registered[kind]:
        return _registered[kind][name]
    if name in BUILT_IN[kind]:
        return _imported(BUILT_IN[kind][name])
    return _outside(kind)[name].load()


def service(name: str) -> Any:
    """Import a function of a higher room that lower ones call by name.

    Parameters
    ----------
    name : str
        A name in `SERVICES`.

    Returns
    -------
    Any
        The function.
    """
    return _imported(SERVICES[name])


def _imported(place: str) -> Any:
    """What "module:attribute" names."""
    module, attribute = place.split(":")
    return getattr(importlib.import_module(module), attribute)


@cache
def _outside(kind: str) -> dict[str, Any]:
    """The entry points of other packages, by name."""
    return {point.name: point for point in entry_points(group=f"dropo.{kind}")}


def _singular(kind: str) -> str:
    """A kind in a message, such as "family"."""
    return {"families": "family", "studies": "study"}.get(kind, kind.removesuffix("s"))
