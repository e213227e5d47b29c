"""The poses of a robot that a video or a picture shows: measured, and as two models predict."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dropo.core.records.predictions import Predictions
from dropo.core.services.validation import Array
from dropo.mjmodel.appearance import floats, part_places, part_sizes

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator

MOST = 240
"""Poses in a video at most."""
LONGEST = 12.0
"""Of a run that is longer than this [s], its first part is shown."""
SEEN = 0.05
"""An error is seen where parts are off by this fraction of the robot's size ..."""
WANTED = 0.15
"""... and enlarged to this fraction at most where they are off by less."""
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""By how much errors may be enlarged."""


@dataclass(frozen=True, eq=False)
class Poses:
    """What a video shows.

    Attributes
    ----------
    measured, before, after : (N, nq) array
        Joint positions; those of the models with their errors enlarged.
    times : (N,) array
        Seconds, or control steps where their length is not known.
    factor : int
        By how much errors are enlarged.
    places : (N, g, 3) array
        Centres of the robot's parts as measured [m].
    sizes : (g,) array
        Radii around them [m].
    floating : bool
        Whether the robot may go away.
    """

    measured: Array
    before: Array
    after: Array
    times: Array
    factor: int
    places: Array
    sizes: Array
    floating: bool


def poses_of(found: Predictions, simulator: "RobotSimulator", most: int = MOST) -> Poses:
    """Choose poses of the whole run, or of the windows that were kept where there is none.

    Components of the state that the data do not hold, such as a hopper's position along the floor,
    stay where the model begins.

    Parameters
    ----------
    found : Predictions
        Measured and simulated motion.
    simulator : RobotSimulator
        One of the run's model.
    most : int
        Poses at most.

    Returns
    -------
    Poses
    """
    run = found.run
    if run is None:
        rows = found.rows.reshape(-1, found.rows.shape[2])
        sides = [side.line - found.measured for side in (found.before, found.after)]
        errors = [error.reshape(len(rows), -1) for error in sides]
    else:
        rows = run.rows
        errors = [run.before - run.measured, run.after - run.measured]
    step = 1.0 if np.isnan(found.seconds) else found.seconds
    longest = len(rows) if np.isnan(found.seconds) else round(LONGEST / step)
    shown = np.arange(min(len(rows), max(longest, 2)))
    shown = shown[:: max(1, -(-len(shown) // most))]
    rows = np.nan_to_num(rows[shown])
    errors = [np.nan_to_num(error[shown]) for error in errors]
    layout = simulator.layout
    model = simulator.model

    def poses(offsets: Array) -> Array:
        states = layout.full_states(layout.move(rows, offsets), model)
        return states[:, 1 : 1 + model.nq]

    measured = poses(np.zeros_like(errors[0]))
    places = part_places(model, measured)
    sizes = part_sizes(model)
    off = [np.linalg.norm(part_places(model, poses(e)) - places, axis=2) for e in errors]
    factor = enlargement(np.maximum(*off), places, sizes)
    before, after = (poses(factor * error) for error in errors)
    times = np.asarray(step * (1.0 + shown))
    return Poses(measured, before, after, times, factor, places, sizes, floats(model))


def enlargement(off: Array, places: Array, sizes: Array) -> int:
    """Choose by how much errors are enlarged, so that they are seen and no more.

    Parameters
    ----------
    off : (N, g) array
        By how much each part is off [m].
    places : (N, g, 3) array
        Where the parts are [m].
    sizes : (g,) array
        Radii around them [m].

    Returns
    -------
    int
        One of `FACTORS`.
    """
    span = (places + sizes[:, None]).max(axis=1) - (places - sizes[:, None]).min(axis=1)
    size = float(np.linalg.norm(span, axis=1).max())
    usual = float(np.quantile(off.max(axis=1), 0.9)) if off.size else 0.0
    if not 0 < usual < SEEN * size:
        return 1
    return max(factor for factor in FACTORS if factor == 1 or factor * usual <= WANTED * size)
