"""Motions simulated anew with what regression found: found there again, it shows its own bias."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class ResimulationSettings:
    """When motions are simulated anew, and how.

    Attributes
    ----------
    finer : int
        Physics steps in the place of one of the model's.
    apart : float
        Error of a run by commands alone, as a fraction of a position's spread, above which nothing
        is concluded: such motions are others than those measured.
    """

    finer: int = 2
    apart: float = 0.5


SETTINGS = ResimulationSettings()


def resimulated(
    simulator: RobotSimulator, data: Trajectories, settings: ResimulationSettings = SETTINGS
) -> Trajectories | None:
    """Simulate runs from their first rows by their commands alone.

    Parameters
    ----------
    simulator : RobotSimulator
        With all numbers that were found.
    data : Trajectories
        Measured runs.
    settings : ResimulationSettings
        When, and how.

    Returns
    -------
    Trajectories or None
        The same commands with simulated states; None where these are far from the measured ones,
        as under torques that a controller gave, or diverge.
    """
    finer = simulator.with_finer_steps(settings.finer)
    runs = data.segments(reset="start", every_step=True)
    predicted = finer.predict(np.asarray(finer.nominal)[None], runs)[0]
    simulator.steps += finer.steps
    if predicted.shape != data.observations.shape:  # orientations have fewer signals than columns
        return None
    error = np.sqrt(np.mean((predicted - data.next_observations) ** 2, axis=0))
    spread = data.next_observations.std(axis=0)
    is_position = np.array([signal.name.startswith("qpos") for signal in simulator.signals])
    near = error[is_position] <= settings.apart * spread[is_position]
    if not np.all(near):
        return None
    observations = np.roll(predicted, 1, axis=0)
    begins = np.array([start for start, _ in data.spans])
    observations[begins] = data.observations[begins]
    return replace(data, observations=observations, next_observations=predicted)
