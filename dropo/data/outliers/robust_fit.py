"""Parameters that explain most windows, however large the errors of the others are."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.gauss_newton import ReweightedFit, ReweightingSettings, fit_reweighted
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array, float_array

DEFAULTS = ReweightingSettings()

CLOSE = 0.1
"""Fraction of the half widths of differences, where predictions curve within those."""


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
    bounds = (space.lower, space.upper) if beyond else (space.low, space.high)
    value = np.clip(float_array("start", start, (len(space),), "robust_fit"), *bounds)
    width = space.high - space.low
    rows = _FittedWindows(simulator, windows, simulator.targets(windows), step * width)
    return fit_reweighted(rows, value, bounds, width, settings)


@dataclass(frozen=True, eq=False)
class _FittedWindows:
    """Windows as rows, with their targets (W, p) and half widths (d,) of differences."""

    simulator: Simulator
    windows: Segments
    measured: Array
    step: Array

    def errors(self, values: Array) -> Array:
        """Measured less predicted (K, W, p) under parameters (K, d)."""
        return self.measured - self.simulator.predict(values, self.windows)

    def jacobian(self, value: Array, close: bool) -> Array:
        """Derivatives (W, p, d) of the predictions."""
        step = CLOSE * self.step if close else self.step
        return self.simulator.linearize(value, self.windows, step=step)[1]
