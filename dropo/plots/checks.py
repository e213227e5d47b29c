"""How tests of estimators and samplers came out."""

from typing import Any

import numpy as np

from dropo.plots.style import AFTER, BEFORE, GREY, INK, OTHER, PURPLE, Axes, axes_of, legend

COLORS = (AFTER, BEFORE, INK, OTHER, PURPLE)


def ranks(calibration: Any, ax: Axes | None = None, *, level: float = 0.95) -> Axes:
    """Draw how far the shares of ranks below each one lie from uniform.

    A posterior that is right stays in the grey band at all ranks with probability `level`. One that
    is too narrow rises first and falls below, a biased one leaves the band to one side.

    Parameters
    ----------
    calibration : dropo.testing.statistics.Calibration
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    level : float
        Of the band.

    Returns
    -------
    Axes

    References
    ----------
    Saeilynoja, Buerkner, Vehtari, Graphical test for discrete uniformity and its applications in
    goodness-of-fit evaluation and multiple sample comparison, Statistics and Computing 32, 2022.
    """
    ax = axes_of(ax)
    levels = calibration.levels
    share = np.arange(1, levels + 1) / (levels + 1)
    band = calibration.band(level)
    ax.fill_between(share, -band, band, color=GREY, alpha=0.25, lw=0, label=f"{level:.0%} of right")
    for i, own in enumerate(calibration.ranks.T):
        counts = np.bincount(own, minlength=levels + 1)[:-1]
        below = np.cumsum(counts) / len(own)
        color = COLORS[i % len(COLORS)]
        ax.step(share, below - share, where="mid", color=color, lw=1.2, label=f"number {i}")
    ax.set(xlabel="rank of the truth, of 1", ylabel="share below, less expected")
    legend(ax)
    return ax


def expected_coverage(found: Any, ax: Axes | None = None) -> Axes:
    """Draw how often regions of each credibility hold the truth; the diagonal where all is right.

    Parameters
    ----------
    found : dropo.testing.statistics.ExpectedCoverage
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax)
    credibility = np.sort(found.credibility)
    holds = np.arange(1, len(credibility) + 1) / len(credibility)
    ax.plot([0, 1], [0, 1], color=GREY, lw=1.0, label="right")
    ax.step(credibility, holds, where="post", color=AFTER, lw=1.4, label="found")
    ax.set(xlabel="credibility", ylabel="share that holds the truth", xlim=(0, 1), ylim=(0, 1))
    legend(ax)
    return ax
