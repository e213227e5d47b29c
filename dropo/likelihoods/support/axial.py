"""Values, slopes and curvatures of a simulator along axes through a point, from two steps on each.

The axes are those of the parameters or of the start states.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.noise import NoiseModel
from dropo.core.contracts.simulator import Simulator, describe_failures, predict_from_starts
from dropo.core.numerics.finite_differences import axial_design
from dropo.core.numerics.kept_rows import KeptRows, MemorySettings, keep_rows
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.segment_blocks import segment_blocks
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class StepSettings:
    """Limits of the steps.

    Attributes
    ----------
    least : float
        Least step of a parameter, as a fraction of its interval.
    deviations : float
        Step of a start state in standard deviations of its noise: there, two points have the fourth
        moment of a normal source.
    minimum_start : float
        Shortest step of a start state, as a fraction of the signal's standard deviation over the
        data: a shorter one misses contacts that the noise can make or break.
    largest_start : float
        Longest step of a start state, as a fraction of the same standard deviation.

    References
    ----------
    Julier, Uhlmann, "A new method for the nonlinear transformation of means and covariances", IEEE
    Transactions on Automatic Control 45 (2000).
    """

    least: float = 1e-6
    deviations: float = 3**0.5
    minimum_start: float = 1e-5
    largest_start: float = 0.1


STEPS = StepSettings()


@dataclass(frozen=True, eq=False)
class Axial:
    """f(x + t e_i) ~ value + slope_i t + curvature_i t^2 / 2 along k axes.

    Attributes
    ----------
    value : (R, p) array
    slope : (R, p, k) array
        In memory or in a file.
    curvature : (R, p, k) array
        Likewise; (R, p, 0) where it was not asked for.
    """

    value: Array
    slope: KeptRows
    curvature: KeptRows


def along_parameters(
    simulator: Simulator,
    segments: Segments,
    centre: Array,
    step: Array,
    *,
    logarithmic: bool = False,
    curved: bool = True,
    settings: StepSettings = STEPS,
    memory: MemorySettings | None = None,
) -> Axial:
    """Differentiate along the d parameters, with 2 d + 1 simulations of each segment.

    Parameters
    ----------
    simulator : Simulator
    segments : Segments
    centre, step : (d,) array
        If a step would leave what is physically possible, it is doubled to the other side.
    logarithmic : bool
        Whether centre and step are those of the parameters' logarithms.
    curved : bool
        Whether curvatures are kept.
    settings : StepSettings
    memory : MemorySettings, optional
        What of it slopes and curvatures may take, beyond which they are kept in files; by default
        they are kept in memory.

    Returns
    -------
    Axial

    Raises
    ------
    SimulationFailed
        If a simulation diverges.
    """
    steps = _possible_steps(simulator.space, centre, step, logarithmic, settings)
    points = centre + axial_design(*steps)
    design = simulator.space.feasible(np.exp(points) if logarithmic else points)
    out = _empty(segments, simulator, len(centre), memory, curved=curved)
    for part, rows, _ in segment_blocks(segments, 8 * len(design) * len(simulator.signals)):
        predictions = simulator.predict(design, part)
        _require_finite(simulator, predictions, design, rows.start)
        _fill(out, rows, predictions, steps)
    return out


def along_starts(
    simulator: Simulator,
    segments: Segments,
    value: Array,
    noise: NoiseModel,
    settings: StepSettings = STEPS,
    memory: MemorySettings | None = None,
) -> Axial:
    """Differentiate along the p coordinates of each segment's own start.

    It takes 2 p + 1 simulations of each segment. Where segments go on from each other (`partial`
    resets), those of one place in their chains are moved at a time.

    Parameters
    ----------
    simulator : Simulator
    segments : Segments
    value : (d,) array
        Parameters.
    noise : NoiseModel
        By its standard deviations go the steps.
    settings : StepSettings
    memory : MemorySettings, optional
        As of `along_parameters`.

    Returns
    -------
    Axial

    Raises
    ------
    Incompatible
        If a start has other coordinates than the signals.
    SimulationFailed
        If a simulation diverges.
    """
    p = len(simulator.signals)
    if simulator.start_size != p:
        raise Incompatible(
            f"Noise on the start states needs a simulator whose start has the coordinates of its"
            f" {p} signals. {type(simulator).__name__} has {simulator.start_size} there."
            " Leave Noise(start=True) out."
        )
    spread = np.std(simulator.targets(segments), axis=0)
    step = settings.deviations * np.sqrt(noise.shape)
    bounded = np.clip(step, settings.minimum_start * spread, settings.largest_start * spread)
    step = np.where(spread > 0, bounded, step)
    steps = np.stack([step, -step])
    moves = axial_design(*steps)
    design = np.repeat(value[None], len(moves), axis=0)
    out = _empty(segments, simulator, p, memory)
    for part, rows, _ in segment_blocks(segments, 8 * len(moves) * p):
        predictions = predict_from_starts(simulator, value, part, moves)
        _require_finite(simulator, predictions, design, rows.start)
        _fill(out, rows, predictions, steps)
    return out


def _possible_steps(
    space: ParameterSpace, centre: Array, step: Array, logarithmic: bool, settings: StepSettings
) -> Array:
    """(2, d) two different steps on each axis, none of them 0."""
    coordinates = np.log if logarithmic else np.asarray
    with np.errstate(divide="ignore"):  # log 0 = -inf: no limit
        lower = coordinates(space.lower)
        upper = coordinates(space.upper)
        box = coordinates(space.high) - coordinates(space.low)
    step = np.minimum(np.maximum(step, settings.least * box), (upper - lower) / 4)
    up = np.clip(centre + step, lower, upper) - centre
    down = np.clip(centre - step, lower, upper) - centre
    first = np.where(up < step / 10, -2 * step, up)
    second = np.where(down > -step / 10, 2 * step, down)
    return np.stack([first, second])


def _empty(
    segments: Segments,
    simulator: Simulator,
    axes: int,
    memory: MemorySettings | None,
    curved: bool = True,
) -> Axial:
    """Room for the rows of all segments along so many axes."""
    shape = (len(segments.rows[0]), len(simulator.signals))
    shapes: list[tuple[int, ...]] = [(*shape, axes), (*shape, axes if curved else 0)]
    slope, curvature = keep_rows(shapes, 0.0 if memory is None else memory.kept, memory)
    return Axial(np.empty(shape), slope, curvature)


def _require_finite(simulator: Simulator, predictions: Array, design: Array, first: int) -> None:
    """Raise SimulationFailed where a simulation diverged; rows count from `first`."""
    if not np.isfinite(predictions).all():
        failures = describe_failures(predictions, design, simulator.space, first=first)
        raise SimulationFailed(f"{failures} No slopes can be taken around the estimate.")


def _fill(out: Axial, rows: slice, predictions: Array, steps: Array) -> None:
    """Three-point differences of predictions (2 k + 1, r, p) at 0 and at steps (2, k).

    Both steps of an axis need not be symmetric.
    """
    k = steps.shape[1]
    one, two = steps[:, :, None, None]
    first = predictions[1 : k + 1] - predictions[0]
    second = predictions[k + 1 :] - predictions[0]
    slope = (two**2 * first - one**2 * second) / (one * two * (two - one))
    out.value[rows] = predictions[0]
    out.slope[rows] = np.moveaxis(slope, 0, -1)
    if out.curvature.shape[2]:
        curvature = 2 * (first / one - second / two) / (one - two)
        out.curvature[rows] = np.moveaxis(curvature, 0, -1)
