"""A simulator along axes through a point, of the parameters or the start states: values, slopes and
curvatures from two steps on each.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.noise import NoiseModel
from dropo.core.contracts.simulator import Simulator, describe_failures, predict_from_starts
from dropo.core.numerics.finite_differences import axial_design
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array
from dropo.likelihoods.support.blocks import segment_blocks

LEAST = 1e-6  # of a parameter's interval: the least step
REACH = (
    3**0.5
    # standard deviations of a normal source at which two points have its fourth moment (Julier, Uhlmann
    # 2000)
)
# of a signal's spread over the starts: the least and the largest step there
SMALL = 1e-5
LARGE = 0.1


@dataclass(frozen=True, eq=False)
class Axial:
    """f(x + t e_i) ~ value + slope_i t + curvature_i t^2 / 2: value (R, p), slope and curvature (R,
    p, k).
    """

    value: Array
    slope: Array
    curvature: Array


def along_parameters(
    simulator: Simulator,
    segments: Segments,
    centre: Array,
    step: Array,
    *,
    logarithmic: bool = False,
) -> Axial:
    """Along the d parameters, or their logarithms, with steps (d,): 2 d + 1 simulations of each
    segment.

    Where a step would leave what is physically possible, it is doubled to the other side.
    """
    steps = _possible_steps(simulator.space, centre, step, logarithmic)
    points = centre + axial_design(*steps)
    design = simulator.space.feasible(np.exp(points) if logarithmic else points)
    out = _empty(segments, simulator, len(centre))
    for part, rows, _ in segment_blocks(segments, 8 * len(design) * len(simulator.signals)):
        predictions = simulator.predict(design, part)
        _require_finite(simulator, predictions, design, rows.start)
        _fill(out, rows, predictions, steps)
    return out


def along_starts(
    simulator: Simulator, segments: Segments, value: Array, noise: NoiseModel
) -> Axial:
    """Along the p coordinates of each segment's own start, at parameters (d,): 2 p + 1 simulations
    of each segment.

    A step is sqrt(3) of the noise's standard deviations, within 1e-5 and 0.1 of the signal's spread
    over the data: shorter ones miss contacts that the noise can make or break. Where segments go on
    from each other (`partial` resets), those of one place in their chains are moved at a time.
    """
    p = len(simulator.signals)
    if simulator.start_size != p:
        raise Incompatible(
            f"Noise on the start states needs a simulator whose start has the coordinates of its"
            f" {p} signals. {type(simulator).__name__} has {simulator.start_size} there."
            " Leave Noise(start=True) out."
        )
    spread = np.std(simulator.targets(segments), axis=0)
    step = REACH * np.sqrt(noise.shape)
    step = np.where(spread > 0, np.clip(step, SMALL * spread, LARGE * spread), step)
    steps = np.stack([step, -step])
    moves = axial_design(*steps)
    design = np.repeat(value[None], len(moves), axis=0)
    out = _empty(segments, simulator, p)
    for part, rows, _ in segment_blocks(segments, 8 * len(moves) * p):
        predictions = predict_from_starts(simulator, value, part, moves)
        _require_finite(simulator, predictions, design, rows.start)
        _fill(out, rows, predictions, steps)
    return out


def _possible_steps(space: ParameterSpace, centre: Array, step: Array, logarithmic: bool) -> Array:
    """(2, d) two different steps on each axis, none of them 0."""
    coordinates = np.log if logarithmic else np.asarray
    with np.errstate(divide="ignore"):  # log 0 = -inf: no limit
        lower = coordinates(space.lower)
        upper = coordinates(space.upper)
        box = coordinates(space.high) - coordinates(space.low)
    step = np.minimum(np.maximum(step, LEAST * box), (upper - lower) / 4)
    up, down = (np.clip(centre + s, lower, upper) - centre for s in (step, -step))
    return np.stack(
        [np.where(up < step / 10, -2 * step, up), np.where(down > -step / 10, 2 * step, down)]
    )


def _empty(segments: Segments, simulator: Simulator, axes: int) -> Axial:
    shape = (len(segments.rows[0]), len(simulator.signals))
    return Axial(np.empty(shape), np.empty((*shape, axes)), np.empty((*shape, axes)))


def _require_finite(simulator: Simulator, predictions: Array, design: Array, first: int) -> None:
    """Raise SimulationFailed where a simulation diverged; rows count from `first`."""
    if not np.isfinite(predictions).all():
        failures = describe_failures(predictions, design, simulator.space, first=first)
        raise SimulationFailed(f"{failures} No slopes can be taken around the estimate.")


def _fill(out: Axial, rows: slice, predictions: Array, steps: Array) -> None:
    """Three-point differences of predictions (2 k + 1, r, p) at 0 and steps (2, k), which need not
    be symmetric.
    """
    k = steps.shape[1]
    one, two = steps[:, :, None, None]
    first = predictions[1 : k + 1] - predictions[0]
    second = predictions[k + 1 :] - predictions[0]
    out.value[rows] = predictions[0]
    out.slope[rows] = np.moveaxis(
        (two**2 * first - one**2 * second) / (one * two * (two - one)), 0, -1
    )
    out.curvature[rows] = np.moveaxis(2 * (first / one - second / two) / (one - two), 0, -1)
