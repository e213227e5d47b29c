"""How a fit came about: its search, and the noise that it assumes."""

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.records.fits.fit import Fit
from dropo.core.records.predictions import Predictions
from dropo.plots.style import (
    AFTER,
    BEFORE,
    FONT,
    GREY,
    INK,
    OTHER,
    PURPLE,
    Axes,
    axes_of,
    empty,
    legend,
    plain_log,
)

MOST = 6
"""Lines in a figure at most."""


def convergence(
    simulator_steps: ArrayLike, log_likelihood: ArrayLike, ax: Axes | None = None
) -> Axes:
    """Draw how far below its end the log-likelihood was, over simulator steps.

    Every evaluation, and the best so far.

    Parameters
    ----------
    simulator_steps : (n,) array_like
        Steps made up to each evaluation.
    log_likelihood : (n,) array_like
        Its log-likelihood [nats].
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    steps = np.asarray(simulator_steps, dtype=float)
    values = np.asarray(log_likelihood, dtype=float)
    ax = axes_of(ax)
    finite = np.isfinite(values)
    steps = steps[finite]
    values = values[finite]
    if not len(values):
        return empty(ax, "Nothing was searched.")
    best = np.maximum.accumulate(values)
    missing = best[-1] - values
    behind = best[-1] - best
    ax.plot(steps, missing, ".", color=GREY, ms=3.5, label="evaluations")
    ax.step(steps, behind, where="post", color=AFTER, lw=1.6, label="best so far")
    ax.set(xlabel="simulator steps", ylabel="nats below the highest")
    ax.set_yscale("symlog", linthresh=1.0)
    ax.set_ylim(bottom=-0.2)
    ax.ticklabel_format(axis="x", style="sci", scilimits=(0, 4))
    legend(ax)
    return ax


def moves(after_round: ArrayLike, fit: Fit, ax: Axes | None = None) -> Axes:
    """Draw how far each mean was from its last value, by outer iteration of the search.

    Parameters
    ----------
    after_round : (n, d) array_like
        The means after each outer iteration, in the parameters' units.
    fit : Fit
        The last values, and the search intervals, in fractions of which distances are drawn.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    means = np.asarray(after_round, dtype=float)
    ax = axes_of(ax)
    if len(means) < 2:
        return empty(ax, "The search took one round.")
    distance = np.abs(means - fit.mean) / (fit.space.high - fit.space.low)
    for i, name in enumerate(fit.space.names[:MOST]):
        ax.plot(
            np.arange(1, len(means) + 1),
            np.where(distance[:, i] > 0, distance[:, i], np.nan),
            marker="os^vDP"[i],
            ms=4,
            lw=1.2,
            label=name,
            color=(AFTER, BEFORE, OTHER, INK, GREY, PURPLE)[i],
        )
    ax.set(yscale="log", xlabel="round", ylabel="from the last value [of the interval]")
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax)
    return ax


def trace(fit: Fit, ax: Axes | None = None) -> Axes:
    """Draw the log density of a posterior's walkers by step: level and alike where they agree.

    Parameters
    ----------
    fit : Fit
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax)
    if fit.posterior is None:
        return empty(ax, "Nothing was drawn.")
    density = fit.posterior.log_density
    every = max(1, len(density) // 200)
    ax.plot(
        np.arange(len(density))[::every], density[::every, :MOST], color=AFTER, lw=0.6, alpha=0.6
    )
    ax.set(
        xlabel="step",
        ylabel="log density of six walkers" if density.shape[1] > MOST else "log density",
    )
    return ax


def tuning(fit: Fit, ax: Axes | None = None) -> Axes:
    """Draw the sweep over epsilon: mean squared error and total variance, with the one chosen.

    Parameters
    ----------
    fit : Fit
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes

    References
    ----------
    Tiboni (2021), figure 6.4.
    """
    ax = axes_of(ax)
    if fit.noise_tuning is None:
        return empty(ax, "Epsilon was not tuned.")
    trials = fit.noise_tuning.trials
    epsilon = [trial.epsilon for trial in trials]
    mse = [trial.mse for trial in trials]
    variance = [trial.total_variance for trial in trials]
    ax.plot(epsilon, mse, color=BEFORE, marker="o", ms=4, label="mean squared error")
    ax.plot(epsilon, variance, color=AFTER, marker="s", ms=4, label="variance of the distribution")
    threshold = fit.noise_tuning.mse_threshold
    ax.axhline(threshold, color=GREY, lw=1, ls=(0, (2, 2)), label="largest error accepted")
    ax.axvline(float(fit.epsilon[0]), color=GREY, lw=1, label="chosen")
    ax.set(xscale="log", yscale="log", xlabel="epsilon")
    legend(ax, room=0.35, loc="upper right")
    return ax


def noise(fit: Fit, predictions: Predictions, ax: Axes | None = None) -> Axes:
    """Draw the noise of each signal, as the fit has it, beside the errors that are left.

    Parameters
    ----------
    fit : Fit
        What to draw.
    predictions : Predictions
        The errors.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax)
    place = np.arange(len(predictions.names))[::-1]
    unit = np.where(predictions.spread > 0, predictions.spread, np.nan)
    ax.plot(
        100 * np.sqrt(fit.epsilon) / unit, place, "|", color=AFTER, ms=10, mew=2, label="noise, sd"
    )
    ax.plot(
        100 * predictions.after.by_signal / unit,
        place,
        "s",
        color=GREY,
        ms=3.8,
        label="error that is left",
    )
    ax.set(
        yticks=place,
        yticklabels=predictions.names,
        ylim=(-0.7, len(place) + 1.2),
        xscale="log",
        xlabel="% of the signal's spread",
    )
    plain_log(ax)
    ax.tick_params(axis="y", labelsize=FONT - 1)
    legend(ax, loc="upper left", ncols=2)
    return ax
