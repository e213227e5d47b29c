"""A robot for those who do not have this package: model.xml, model.npz and model.py.

MJCF keeps about six digits, and has no element for a delay or a play. So model.npz holds the
numbers that model.xml rounds, and model.py the effects as functions, around plain mujoco.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zipfile import BadZipFile

import mujoco
import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, magnitudes_of
from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadFile
from dropo.core.services.files.atomic_write import write_npz, write_text
from dropo.core.services.source_text import SourceText
from dropo.core.services.validation import Array
from dropo.mjmodel.numbers import changed_numbers
from dropo.problems.file.writer import write_problem
from dropo.simulators.mujoco.plain_robot import Robot, write_numbers
from dropo.simulators.mujoco.simulator import MujocoSimulator

HOOKS = (
    "command",
    "actuation",
    "command_feedback",
    "force",
    "friction",
    "wrench",
)
"""The hooks of effects that act on a plain model in each step."""
BROKEN = (
    AttributeError,
    EOFError,
    KeyError,
    OSError,
    TypeError,
    ValueError,
    BadZipFile,
    NotImplementedError,
)
"""What numbers of another kind or shape, and files that were cut off, end in."""
SENSOR = ("start", "measurement", "sensor_delay")
"""Those that act on what is measured alone."""
HEADER = '''"""A robot in plain MuJoCo.

    import model                   # this file
    robot = model.load()
    robot.reset(qpos, qvel)
    robot.step(command)            # held for {frame_skip} physics steps
    robot.data.qpos, robot.data.qvel

It reads model.xml and model.npz beside it. Written by dropo {version}.
{remarks}"""

'''
LOAD = '''def effect(sizes, **hooks):
    """An effect whose other hooks are none, with its sizes."""
    return SimpleNamespace(**{**dict.fromkeys(HOOKS), **hooks}), sizes


EFFECTS = [
%s]


def load():
    """The robot as it was found."""
    folder = Path(__file__).parent
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    with np.load(folder / "model.npz") as numbers:
        write_numbers(model, numbers)
    return Robot(model, FRAME_SKIP, EFFECTS)
'''


def write_extended(
    problem: Problem,
    parameters: Mapping[str, float],
    folder: Path,
    to_fit: Problem | None = None,
) -> Path:
    """Write an extended problem, and its robot in plain MuJoCo beside it.

    Parameters
    ----------
    problem : Problem
        Whose simulator has what was found.
    parameters : mapping of str to float
        The declared ones as fitted; the others keep the model's own numbers.
    folder : Path
        Made where it is missing.
    to_fit : Problem, optional
        The same with what was found as parameters: fit.yaml, of the model before.xml.

    Returns
    -------
    Path
        The problem file.

    Raises
    ------
    Incompatible
        If the simulator is no `MujocoSimulator`, or an effect cannot be written as source text.
    """
    simulator = problem.simulator
    values = np.array(simulator.nominal, dtype=float)
    for i, name in enumerate(problem.space.names):
        values[i] = parameters.get(name, values[i])
    path = write_problem(problem, folder, values)
    if to_fit is not None:
        before = np.zeros(len(to_fit.space))
        before[: len(values)] = values
        write_problem(to_fit, folder, before, name="fit.yaml", model="before.xml")
    if isinstance(simulator, MujocoSimulator):
        write_plain_model(simulator, values, folder)
    return path


def write_plain_model(simulator: MujocoSimulator, values: Array, folder: Path) -> None:
    """Write model.npz and model.py beside the model.xml of `write_problem`.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model, its parameters and effects.
    values : (d,) array
        The parameters, in the order of the simulator's space.
    folder : Path
        Where model.xml is.
    """
    active = active_effects(simulator, values)
    plain = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    whole = simulator.model_of(values, active)
    write_npz(folder / "model.npz", changed_numbers(plain, whole))
    write_text(folder / "model.py", format_plain_model(simulator, active))


def active_effects(simulator: MujocoSimulator, values: Array) -> ActiveEffects:
    """List the effects that are present under some parameters.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model, its d parameters and effects.
    values : (d,) array
        The declared parameters, then the magnitudes of the effects that are fitted.

    Returns
    -------
    list of (EffectInstance, (q,) array)
        Fixed effects first, each with its magnitudes.
    """
    free = magnitudes_of(simulator.effects, values[len(simulator.bindings) :])
    return [*simulator.fixed, *free]


def format_plain_model(simulator: MujocoSimulator, active: ActiveEffects) -> str:
    """Write the robot's effects as a module that does not import this package.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model.
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    str
        Python source.

    Raises
    ------
    Incompatible
        If a hook of an effect is no module function, or a partial of one.
    """
    from dropo._version import __version__

    source = SourceText(_modules_of(active))
    source.imports |= {"from pathlib import Path", "from types import SimpleNamespace"}
    for needed in (Robot, write_numbers):
        source.expression(needed)
    effects = ""
    for instance, magnitudes in active:
        hooks = {name: getattr(instance, name) for name in HOOKS}
        given = {name: hook for name, hook in hooks.items() if hook is not None}
        if given:
            sizes = source.expression(np.asarray(magnitudes))
            named = [f"{name}={source.expression(hook)}" for name, hook in given.items()]
            effects += f"    # {instance.label}: {_sizes(instance, magnitudes)}\n"
            effects += f"    effect({', '.join([sizes, *named])}),\n"
    constants = f"FRAME_SKIP = {simulator.frame_skip}\nHOOKS = {HOOKS!r}"
    remarks = _remarks([instance for instance, _ in active])
    header = HEADER.format(frame_skip=simulator.frame_skip, version=__version__, remarks=remarks)
    return header + "\n\n\n".join([source.text(), constants, LOAD % effects])


def read_plain_model(path: Path, expected: str, trusted: bool) -> str:
    """Read a model.py, to be run.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        What `format_plain_model` writes.
    trusted : bool
        Whether it may be something else.

    Returns
    -------
    str

    Raises
    ------
    BadFile
        If there is no such file, or it is something else and not trusted.
    """
    # What is no UTF-8 is no text that was written here.
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else None
    if text is None:
        raise BadFile(path, "", "a model in plain MuJoCo, written by `dropo diagnose --out`", None)
    if text != expected and not trusted:
        rule = "what this version of dropo writes for problem.yaml, or code that --trust allows"
        raise BadFile(path, "", rule, "something else")
    return text


def run_plain_model(text: str, path: Path) -> SimpleNamespace:
    """Run the text of a model.py as if it stood in a file.

    Parameters
    ----------
    text : str
        Python source.
    path : Path
        The file; model.xml and model.npz are beside it.

    Returns
    -------
    SimpleNamespace
        What it defines: `load`, `Robot`, `EFFECTS`, ...

    Raises
    ------
    BadFile
        If it ends in an error, as text that was changed may.
    """
    scope: dict[str, Any] = {"__name__": "model", "__file__": str(path)}
    try:
        exec(compile(text, str(path), "exec"), scope)
    except Exception as error:
        raise BadFile(path, "", "Python that runs", repr(error)) from error
    return SimpleNamespace(**scope)


def load_robot(plain: SimpleNamespace, path: Path) -> Robot:
    """Load the robot of a model.py.

    Parameters
    ----------
    plain : SimpleNamespace
        Of `run_plain_model`.
    path : Path
        The file.

    Returns
    -------
    Robot
        By the class that the file defines.

    Raises
    ------
    BadFile
        If model.xml or model.npz beside it is missing, broken, or of another model.
    """
    try:
        robot: Robot = plain.load()
    except BROKEN as error:
        rule = "model.xml and model.npz as `dropo diagnose --out` writes them"
        raise BadFile(path.parent, "", rule, error) from None
    return robot


def _modules_of(active: ActiveEffects) -> set[str]:
    """The modules in which the effects' hooks are defined."""
    hooks = [getattr(instance, name) for instance, _ in active for name in HOOKS]
    functions = [getattr(hook, "func", hook) for hook in hooks]
    return {getattr(function, "__module__", "") for function in functions if function is not None}


def _sizes(instance: EffectInstance, magnitudes: Array) -> str:
    """The magnitudes of an effect, with names and units."""
    pairs = zip(instance.quantities, np.asarray(magnitudes).tolist(), strict=True)
    shares = [f"{q.name} {size:.6g} {q.unit}".removesuffix(" 1") for q, size in pairs]
    return ", ".join(shares)


def _remarks(instances: Sequence[EffectInstance]) -> str:
    """What is not in the file, and what is there as at the end of the data."""
    sensors = [
        one.label for one in instances if any(getattr(one, name) is not None for name in SENSOR)
    ]
    changing = [one.label for one in instances if one.time_profile is not None]
    remarks = ""
    if sensors:
        remarks += f"\nWithout what the sensors add: {', '.join(sensors)}.\n"
    if changing:
        remarks += f"\nAs at the end of the data: {', '.join(changing)}.\n"
    return remarks
