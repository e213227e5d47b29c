"""Drives whose commands flip from row to row and shake their joints: no row shows what acts then.

Such is the log of a controller that is too strong for its own rate. What the friction of a joint
does that turns around within every row, and all that goes on between rows, is lost with smoothing.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class ChatteringSettings:
    """When a drive chatters.

    Attributes
    ----------
    flips : float
        Correlation of a command's changes with those before, below which it flips; that of white
        noise is -0.5.
    shaken : float
        Change of a joint's speed from row to row that commands explain, as a fraction of its
        speeds, from which it shakes.
    """

    flips: float = -0.75
    shaken: float = 0.1


SETTINGS = ChatteringSettings()


def chattering_drives(problem: Problem, settings: ChatteringSettings = SETTINGS) -> tuple[str, ...]:
    """Name the drives that chatter in a problem's data.

    Parameters
    ----------
    problem : Problem
        A robot and its data.
    settings : ChatteringSettings
        When a drive chatters.

    Returns
    -------
    tuple of str
        Of drives of joints whose positions are observed; none where fewer than four rows follow
        each other.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return ()
    data = problem.trajectories
    columns = simulator.layout.column_places
    controls = simulator.controls.tolist()
    runs = [slice(start, stop) for start, stop in data.spans if stop - start >= 4]
    found = []
    for drive in actuators(simulator.model):
        place = None if drive.joint is None else columns.get(("qpos", drive.joint.qpos))
        if place is None or drive.id not in controls or not runs:
            continue
        commands = [data.actions[run, controls.index(drive.id)] for run in runs]
        positions = [data.observations[run, place] for run in runs]
        if _flips(commands) < settings.flips and _shaken(commands, positions) > settings.shaken:
            found.append(drive.name)
    return tuple(found)


def chattering_sentences(
    problem: Problem, settings: ChatteringSettings = SETTINGS
) -> tuple[str, ...]:
    """Say which drives chatter in a problem's data, if any.

    Parameters
    ----------
    problem : Problem
        A robot and its data.
    settings : ChatteringSettings
        When a drive chatters.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    drives = chattering_drives(problem, settings)
    if not drives:
        return ()
    return (
        f"The commands of {', '.join(map(repr, drives))} flip from row to row and shake the joints:"
        " what happens between rows is as large as what they show, so regression names no cause,"
        " and one that a simulation finds may be none. Log such a machine faster, or calm its"
        " controller.",
    )


def _flips(commands: list[Array]) -> float:
    """The correlation of a command's changes with those before; 0 where it does not change."""
    changes = [np.diff(run) for run in commands]
    return _correlation(
        np.concatenate([run[:-1] for run in changes]), np.concatenate([run[1:] for run in changes])
    )


def _shaken(commands: list[Array], positions: list[Array]) -> float:
    """How far commands change the speed from row to row, as a fraction of its mean over rows."""
    speeds = [np.diff(run) for run in positions]
    slow = np.concatenate([run[1:] + run[:-1] for run in speeds])
    jumps = np.concatenate([np.diff(run) for run in speeds])
    told = np.concatenate([np.diff(run)[:-1] for run in commands])
    share = abs(_correlation(told, jumps))
    return share * float(jumps.std()) / max(float(slow.std()), 1e-300)


def _correlation(first: Array, second: Array) -> float:
    """Of two signals (n,); 0 where one of them does not change."""
    if not (first.std() > 0 and second.std() > 0):
        return 0.0
    return float(np.corrcoef(first, second)[0, 1])
