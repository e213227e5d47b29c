"""Figures of fits and diagnoses with matplotlib: one function a figure, axes in and out.

Each function draws into `ax` where one is given, else into a figure of its own, and returns the
Axes. Nothing but the figure is changed: no global style. Colours are Okabe and Ito's, which all
kinds of sight distinguish: orange is the model before, blue after, dark what was measured.

The room imports core alone. Add a figure as a function with `ax=None` that takes its axes from
`axes_of`, and list it here.
"""

from dropo.plots.causes import candidates, changes, forces, law, residuals, similarity, sizes
from dropo.plots.checks import expected_coverage, ranks
from dropo.plots.distribution import corner, correlation, pair, parameters
from dropo.plots.motion import calibration, errors, horizon, trajectory
from dropo.plots.search import convergence, moves, noise, trace, tuning

__all__ = [
    "calibration",
    "candidates",
    "changes",
    "convergence",
    "corner",
    "correlation",
    "errors",
    "expected_coverage",
    "forces",
    "horizon",
    "law",
    "moves",
    "noise",
    "pair",
    "parameters",
    "ranks",
    "residuals",
    "similarity",
    "sizes",
    "trace",
    "trajectory",
    "tuning",
]
