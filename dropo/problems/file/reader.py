"""Problem files: what their schema leaves to be checked against model and data, and the problem."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.prior import read_prior
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.start_mean import given_start
from dropo.core.records.trajectories import Reset, Trajectories
from dropo.core.services.errors import BadEntry
from dropo.core.services.files.file_content import FileContent
from dropo.core.services.files.file_schema import read_file
from dropo.core.services.validation import Array
from dropo.data.checks.check import outside_control_range
from dropo.data.reading import inputs_of
from dropo.mjmodel.observation import Layout
from dropo.problems.file.data import locate_data, read_data, read_run_names, read_states
from dropo.problems.file.data_errors import find_data_error
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.problems.file.plugins import run_plugins
from dropo.problems.file.schema import ProblemFile, ResetEntry
from dropo.problems.file.simulator import make_simulator, parameter_names
from dropo.problems.file.task import make_task
from dropo.simulators.mujoco.simulator import MujocoSimulator

KIND = "a problem file"
"""What messages call such a file."""


def read_problem(
    path: Path,
    *,
    threads: int = 0,
    checked: bool = True,
    input: str | None = None,
    trusted: bool = True,
) -> Problem:
    """Read the problem that a file describes.

    Parameters
    ----------
    path : Path
        The problem file.
    threads, checked, input, trusted : int, bool, str or None, bool
        As in `dropo.load`.

    Returns
    -------
    Problem
        Simulator, data, and how they are compared.

    Raises
    ------
    BadFile
        If something is wrong in the file or its data.
    """
    file = read_file(path, ProblemFile, KIND)
    content = file.content
    plugins = run_plugins(file, trusted=trusted)
    simulator = make_simulator(file, threads)
    fitted, held_out = read_data(file, simulator, input or content.input)
    if checked:
        _require_sound_data(file, simulator, fitted, held_out)
    reset, set_columns = _read_reset(file, simulator)
    epsilon = _read_epsilon(file, simulator)
    priors = _read_priors(file, simulator)
    task = make_task(file, simulator, fitted, trusted=trusted)
    names = read_run_names(file, fitted, held_out) if content.reference else ()
    with file.at("lambda"):
        problem = Problem(
            content.robot or path.stem,
            simulator,
            fitted,
            horizon=content.horizon,
            reset=reset,
            set_columns=set_columns,
            whole_runs=content.whole_runs,
            epsilon=epsilon,
            start_noise=content.start_noise,
            noise_degrees=content.student_t,
            held_out=held_out,
            warnings=_describe_warnings(fitted, simulator),
            priors=priors,
            task=task,
            estimated=_read_estimated(file, simulator),
            settings=_read_settings(file, simulator.space),
            run_names=names,
            reference=tuple(content.reference),
            plugins=plugins,
        )
    return with_velocities(problem)


def read_inputs(path: Path) -> tuple[str, ...]:
    """Name the logged commands in the data of a problem file, where there are several.

    Parameters
    ----------
    path : Path
        The problem file.

    Returns
    -------
    tuple of str
        NAME of every `actions.NAME` in the first of its data.

    Raises
    ------
    BadFile
        If something is wrong in the file or its data.
    """
    file = read_file(path, ProblemFile, KIND)
    places = locate_data(file, file.content.data)
    return inputs_of(next(iter(places.values())))


def read_motion(path: Path, *, threads: int = 0, trusted: bool = True) -> Problem:
    """Read what a problem file says of the motion alone.

    Parameters
    ----------
    path : Path
        The problem file; its data need not hold actions.
    threads : int
        Of the simulator, 0 for all cores.
    trusted : bool
        As in `dropo.load`.

    Returns
    -------
    Problem
        The model, and all data of the entry `data` with actions of 0. Velocities are not estimated.

    Raises
    ------
    BadFile
        If something is wrong in the file or its data.
    """
    file = read_file(path, ProblemFile, KIND)
    plugins = run_plugins(file, trusted=trusted)
    simulator = make_simulator(file, threads)
    trajectories = read_states(file, simulator)
    _require_sound_data(file, simulator, trajectories, None)
    name = file.content.robot or path.stem
    return Problem(name, simulator, trajectories, plugins=plugins)


def _require_sound_data(
    file: FileContent[ProblemFile],
    simulator: Simulator,
    fitted: Trajectories,
    held_out: Trajectories | None,
) -> None:
    """Refuse data that hold an error."""
    for key, trajectories in (("data", fitted), ("held_out", held_out)):
        error = find_data_error(trajectories, simulator)
        if error is not None:
            raise BadEntry(file.path, key, error)


def _describe_warnings(trajectories: Trajectories, simulator: Simulator) -> tuple[str, ...]:
    """What looks odd in the actions."""
    findings = outside_control_range(trajectories, simulator)
    return tuple(f"{finding.signal}: {finding.sentence}" for finding in findings)


def _read_reset(
    file: FileContent[ProblemFile], simulator: MujocoSimulator
) -> tuple[Reset, NDArray[np.bool_] | None]:
    """The reset mode, and for a partial one which columns (p,) are set."""
    entry = file.content.reset
    if not isinstance(entry, ResetEntry):
        return entry, None
    with file.at("reset.set"):
        chosen = simulator.layout.places_of(entry.set, simulator.model)
        items = Layout(simulator.model, entry.set)
    missing = sorted(set(items.names) - set(simulator.layout.names))
    if missing:
        expected = "columns that the observation holds"
        raise file.refusal("reset.set", expected, ", ".join(missing))
    return "partial", chosen


def _read_epsilon(
    file: FileContent[ProblemFile], simulator: MujocoSimulator
) -> float | Array | None:
    """The variance of the noise: one, or (p,) in the order of the signals."""
    epsilon = file.content.epsilon
    signals = [signal.name for signal in simulator.signals]
    if epsilon is None or isinstance(epsilon, float):
        return epsilon
    if isinstance(epsilon, dict):
        return _order_by_signal(file, epsilon, signals)
    if len(epsilon) != len(signals):
        expected = f"one number, or one for each of the {len(signals)} signals"
        raise file.refusal("epsilon", expected, f"{len(epsilon)} numbers")
    return np.array(epsilon)


def _read_estimated(file: FileContent[ProblemFile], simulator: MujocoSimulator) -> dict[str, float]:
    """The signals that were estimated, with their errors."""
    names = [signal.name for signal in simulator.signals]
    for name in file.content.estimated:
        file.require_known(f"estimated.{name}", name, names, "a signal")
    return dict(file.content.estimated)


def _order_by_signal(
    file: FileContent[ProblemFile], variances: dict[str, float], signals: list[str]
) -> Array:
    """Variances by name, in the order of the signals."""
    for name in variances:
        file.require_known(f"epsilon.{name}", name, signals, "a signal")
    missing = [name for name in signals if name not in variances]
    if missing:
        expected = f"a variance for each of the {len(signals)} signals"
        raise file.refusal("epsilon", expected, f"none for {', '.join(missing)}")
    return np.array([variances[name] for name in signals])


def _read_settings(file: FileContent[ProblemFile], space: ParameterSpace) -> dict[str, Any]:
    """Where searches begin, and what noise may be, as settings of methods."""
    settings: dict[str, Any] = {}
    if file.content.noise is not None:
        settings["noise"] = file.content.noise
    start = file.content.start
    if start:
        with file.at("start"):
            given_start(start, space)
        settings["start"] = start
    return settings


def _read_priors(file: FileContent[ProblemFile], simulator: MujocoSimulator) -> dict[str, Any]:
    """The priors of the parameters that have one."""
    priors: dict[str, Any] = {}
    for key, own in parameter_names(file, simulator.model).items():
        prior = file.content.parameters[key].prior
        if prior is not None:
            with file.at(f"parameters.{key}.prior"):
                for name in own:
                    read_prior(prior, simulator.space[name])
            priors |= dict.fromkeys(own, prior)
    return priors
