"""Signs, units and names that are wrong: commands of servos that their joints do not follow."""

from dataclasses import dataclass

import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import Log
from dropo.diagnosis.regression.result import WiringFault
from dropo.mjmodel.dynamics.forces import position_servos
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class WiringSettings:
    """When a servo's command is not what the model takes it for.

    Attributes
    ----------
    follows : float
        Correlation of positions with commands from which a joint follows one.
    better : float
        By how much the correlation with another command must be larger.
    factor : float
        A slope of positions over commands above this, or below one over it, is another unit.
    moving : float
        A command that moves less than this fraction of the largest is not looked at.
    lag : float
        Longest time by which a joint follows its command [s].
    lags : int
        Number of such times that are tried.
    """

    follows: float = 0.6
    better: float = 0.3
    factor: float = 3.0
    moving: float = 0.02
    lag: float = 0.3
    lags: int = 16


SETTINGS = WiringSettings()


def wiring_faults(
    simulator: RobotSimulator, trajectories: Trajectories, settings: WiringSettings = SETTINGS
) -> tuple[WiringFault, ...]:
    """Compare the joints of position servos with their commands.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    trajectories : Trajectories
        What was measured.
    settings : WiringSettings
        What counts.

    Returns
    -------
    tuple of WiringFault
        None where each joint follows its own command.
    """
    servos = position_servos(simulator.model)
    if not servos:
        return ()
    log = Log(simulator, trajectories)
    positions = [rows[:, [joint.qpos for joint, _ in servos]] for rows in log.positions]
    commands = [rows[:, [servo for _, servo in servos]] for rows in log.commands]
    names = [joint.name for joint, _ in servos]
    sizes = np.concatenate(_centred(commands)).std(axis=0)
    spread = np.concatenate(_centred(positions)).std(axis=0)
    moves = (sizes > settings.moving * sizes.max()) & (spread > 1e-9 * max(spread.max(), 1e-300))
    longest = min(settings.lag / log.step, max(map(len, positions)) / 4)
    lags = np.linspace(0.0, longest, settings.lags)
    every = [_correlation(positions, commands, int(lag)) for lag in np.unique(lags.round())]
    best = np.argmax(np.abs(every), axis=0)
    correlation = np.take_along_axis(np.array(every), best[None], axis=0)[0]
    found: list[WiringFault] = []
    exchanged: set[int] = set()
    for j in np.flatnonzero(moves).tolist():
        other = int(np.argmax(np.where(moves, np.abs(correlation[j]), 0.0)))
        beyond = abs(correlation[j, other]) - abs(correlation[j, j])
        back = int(np.argmax(np.where(moves, np.abs(correlation[other]), 0.0)))
        strong = abs(correlation[j, other]) > settings.follows
        if other > j and back == j and strong and beyond > settings.better:
            exchanged |= {j, other}
            text = (
                f"The joints {names[j]!r} and {names[other]!r} are exchanged: each follows the "
                "other's command."
            )
            found.append(WiringFault("exchange", f"{names[j]}, {names[other]}", text))
    for j in np.flatnonzero(moves).tolist():
        if j in exchanged or abs(correlation[j, j]) < settings.follows:
            continue
        slope = float(correlation[j, j] * spread[j] / sizes[j])
        if slope < 0:
            text = f"The joint {names[j]!r} has the wrong sign: it moves against its command."
            found.append(WiringFault("sign", names[j], text))
        elif not 1 / settings.factor < slope < settings.factor:
            text = (
                f"The joint {names[j]!r} moves {slope:.3g} times as far as its command says: units "
                "differ by that factor, or the command is no position."
            )
            found.append(WiringFault("unit factor", names[j], text))
    return tuple(found)


def _centred(runs: list[Array]) -> list[Array]:
    """Each run less its own mean."""
    return [rows - rows.mean(axis=0) for rows in runs]


def _correlation(positions: list[Array], commands: list[Array], lag: int) -> Array:
    """(n, n) correlation of each position with each command of so many rows before."""
    long_enough = [i for i, rows in enumerate(positions) if len(rows) > lag + 1]
    later = np.concatenate(_centred([positions[i][lag:] for i in long_enough]))
    before = np.concatenate(_centred([commands[i][: len(commands[i]) - lag] for i in long_enough]))
    size = np.outer(later.std(axis=0), before.std(axis=0)) * len(later)
    return np.asarray(later.T @ before / np.maximum(size, 1e-300))
