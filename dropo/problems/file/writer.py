"""A problem as files that `load` reads: problem.yaml, the model as MJCF, the data."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.files.atomic_write import write_npz, write_text
from dropo.core.services.files.strict_yaml import format_yaml
from dropo.core.services.plugin_files import file_of
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.effects import make_effect_entry
from dropo.problems.file.plugins import places_from
from dropo.problems.file.schema import EffectEntry, ParameterEntry, ProblemFile
from dropo.problems.file.task import locate_from
from dropo.simulators.mujoco.model_assets import with_assets_beside
from dropo.simulators.mujoco.model_xml import format_model, is_in_model
from dropo.simulators.mujoco.simulator import MujocoSimulator


def write_problem(
    problem: Problem,
    folder: str | Path,
    values: Array | None = None,
    *,
    name: str = "problem.yaml",
    model: str = "model.xml",
) -> Path:
    """Write problem.yaml, model.xml and data.npz (held_out.npz) into a folder.

    Effects that change the model's numbers stand in model.xml, which keeps about six digits; the
    others under `effects`, and the plug-in files that they need under `plugins`.

    Parameters
    ----------
    problem : Problem
        A problem whose simulator is a `MujocoSimulator`.
    folder : str or Path
        Made where it is missing.
    values : (d,) array, optional
        What its declared parameters are in model.xml; by default the model's own numbers. Bounds of
        a factor on the model's number are those of a factor on the new one, which is left out
        where the number is 0.
    name, model : str
        What the problem file and its model are called.

    Returns
    -------
    Path
        The problem file.

    Raises
    ------
    Incompatible
        If the problem's simulator is another one.
    """
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        raise Incompatible(
            f"{type(simulator).__name__} cannot be written as a problem file, which describes "
            "a MuJoCo model."
        )
    folder = Path(folder)
    if values is None:
        values = np.asarray(simulator.nominal, dtype=float)
    content = {"model": model} | _make_content(problem, simulator, folder, values)
    write_text(folder / model, with_assets_beside(format_model(simulator, values), folder))
    write_data(problem.trajectories, folder / "data.npz")
    if problem.held_out is not None:
        write_data(problem.held_out, folder / "held_out.npz")
    path = folder / name
    entries = ProblemFile.model_validate(content)
    write_text(path, format_yaml(entries.model_dump(by_alias=True, exclude_unset=True)))
    return path


def _make_content(
    problem: Problem, simulator: MujocoSimulator, folder: Path, values: Array
) -> dict[str, Any]:
    """The content of a problem file but its model, of keys that say more than their defaults."""
    content: dict[str, Any] = {
        "frame_skip": simulator.frame_skip,
        "data": "data.npz",
        "observation": list(simulator.observation),
        "action": list(simulator.action),
        "parameters": {
            binding.parameter.name: _make_parameter(binding.parameter, value)
            for binding, value in zip(simulator.bindings, values.tolist(), strict=False)
            if value != 0 or not binding.parameter.relative
        },
        "lambda": problem.horizon,
    }
    if problem.whole_runs:
        content["whole_runs"] = True
    if problem.epsilon is not None:
        content["epsilon"] = np.asarray(problem.epsilon, dtype=float).tolist()
    if problem.start_noise:
        content["start_noise"] = True
    if problem.estimated:
        content["estimated"] = dict(problem.estimated)
    effects = _make_effects(simulator)
    if effects:
        content["effects"] = effects
    if problem.task is not None and problem.task.source is not None:
        content["task"] = locate_from(problem.task.source, folder)
    plugins = _plugins_of(problem, [entry.effect for entry in effects])
    if plugins:
        content["plugins"] = places_from(plugins, folder)
    if problem.held_out is not None:
        content["held_out"] = "held_out.npz"
    return content


def _make_parameter(parameter: FieldParameter, value: float) -> ParameterEntry:
    """The entry of a parameter that has this value in model.xml."""
    low, high = float(parameter.low), float(parameter.high)
    if parameter.relative:
        low, high = sorted((low / value, high / value))
    content: dict[str, Any] = {"field": parameter.field, "low": low, "high": high}
    if parameter.element is not None:
        several = isinstance(parameter.element, tuple)
        content["name"] = list(parameter.element) if several else parameter.element
        if several:
            content["shared"] = True
    if parameter.index is not None:
        content["index"] = int(parameter.index)
    if parameter.unit:
        content["unit"] = parameter.unit
    if parameter.relative:
        content["target"] = "relative"
    if not parameter.derived:
        content["derived"] = "keep"
    return ParameterEntry.model_validate(content)


def _make_effects(simulator: MujocoSimulator) -> list[EffectEntry]:
    """The entries of the effects that model.xml does not hold."""
    fitted = [make_effect_entry(instance) for instance in simulator.effects]
    present = [
        make_effect_entry(instance, sizes)
        for instance, sizes in simulator.fixed
        if not is_in_model(instance)
    ]
    return [*fitted, *present]


def _plugins_of(problem: Problem, effects: Sequence[str]) -> tuple[str, ...]:
    """The files of the problem's own parts, and of effects that it has been given since."""
    files = [file_of("effects", name) for name in effects]
    return tuple(dict.fromkeys([*problem.plugins, *(str(file) for file in files if file)]))


def write_data(data: Trajectories, path: Path) -> None:
    """Write trajectories as the data of a problem.

    Parameters
    ----------
    data : Trajectories
        The transitions; their groups and times are written where they have such.
    path : Path
        The .npz file.
    """
    arrays: dict[str, Any] = {
        "observations": data.observations,
        "actions": data.actions,
        "next_observations": data.next_observations,
        "terminals": data.terminals,
    }
    if data.group is not None:
        arrays["group"] = data.group
    if data.time is not None:
        arrays["time"] = data.time
    write_npz(path, arrays)
