"""Parameters that explain most windows, however large the errors of the others are."""

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.gauss_newton import ReweightedFit, ReweightingSettings, fit_reweighted
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array, float_array

DEFAULTS = ReweightingSettings()


def robust_fit(
    simulator: Simulator,
    windows: Segments,
    start: Array,
    *,
    beyond: bool = False,
    step: float = 1e-3,
    settings: ReweightingSettings = DEFAULTS,
) -> ReweightedFit:
    """Fit the parameters to windows by Gauss-Newton with the weights of a Student t.

    Windows in which something pushes count for little, so that they need not be found before the
    model is fitted.

    Parameters
    ----------
    simulator : Simulator
        Of d parameters.
    windows : Segments
        Measured windows.
    start : (d,) array
        Parameters to begin with.
    beyond : bool
        Whether the parameters may leave the search intervals, as far as is physically possible.
    step : float
        Half width of differences, as a fraction of the search intervals.
    settings : ReweightingSettings
        How it steps, in units of the search intervals.

    Returns
    -------
    ReweightedFit
        Its scores are those of the windows.

    Raises
    ------
    BadArgument
        If there are not d numbers to start from.
    SimulationFailed
        If there is nothing to start from.
    """
    space = simulator.space
    measured = simulator.targets(windows)
    width = space.high - space.low
    bounds = (space.lower, space.upper) if beyond else (space.low, space.high)
    value = np.clip(float_array("start", start, (len(space),), "robust_fit"), *bounds)

    def linearize(at: Array) -> tuple[Array, Array]:
        predicted, jacobian = simulator.linearize(at, windows, step=step * width)
        return measured - predicted, jacobian

    return fit_reweighted(linearize, value, bounds, width, settings)
