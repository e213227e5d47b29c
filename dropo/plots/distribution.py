"""Figures of the fitted parameters: their intervals, joint distribution and correlations."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.prior import Prior, read_prior
from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array
from dropo.plots.style import (
    AFTER,
    BEFORE,
    FONT,
    GREY,
    INK,
    LIGHT,
    OTHER,
    Axes,
    axes_of,
    empty,
    folded,
    legend,
    with_unit,
)

MOST = 6
"""Parameters in a corner plot at most."""
DRAWS = 4000
"""Draws from a fitted distribution, for a corner plot."""
NARROW = 5e-3
"""A distribution whose sd is less than this fraction of its mean is drawn about its mean."""
CHARACTER = 0.0019
"""Width of a letter as a fraction of a figure's, for each point of its size."""
INSIDE = (0.9, 0.5)
"""Fractions of the draws inside the contours."""


def parameters(fit: Fit, ax: Axes | None = None, *, priors: dict[str, Prior] | None = None) -> Axes:
    """Draw every parameter on its own search interval.

    The 95 % interval of the mean, the distribution's mean +- 2 sd, and the truth where it is known.

    Parameters
    ----------
    fit : Fit
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    priors : dict of str to Prior, optional
        Priors by parameter, drawn as heights above the interval.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, size=(4.2, 0.6 + 0.38 * len(fit.space)))
    place = np.arange(len(fit.space))[::-1]
    ends = np.stack([fit.mean - 2 * fit.sd, fit.mean, fit.mean + 2 * fit.sd])
    spread = fit.space.to_unit(fit.space.clip(ends))
    interval = fit.space.to_unit(fit.interval().T)
    ax.barh(place, 1, height=0.44, color=LIGHT, label="searched")
    for name, prior in (priors or {}).items():
        i = fit.space.names.index(name)
        _draw_prior(ax, fit.space, i, prior, place[i])
    ax.barh(
        place,
        spread[2] - spread[0],
        left=spread[0],
        height=0.44,
        color=AFTER,
        alpha=0.45,
        label="distribution ± 2 sd",
    )
    ax.hlines(place, *interval, color=AFTER, lw=2.2)
    ax.plot(spread[1], place, "|", color=AFTER, ms=11, mew=2, label="mean, 95 % interval")
    truth = fit.truth
    if truth:
        values = np.array([truth.get(name, np.nan) for name in fit.space.names])
        ax.plot(fit.space.to_unit(values), place, "D", color=BEFORE, ms=3.6, label="truth")
    labels = [f"{with_unit(p.name, p.unit)}\n{p.low:.3g} … {p.high:.3g}" for p in fit.space]
    ax.set(
        yticks=place,
        yticklabels=labels,
        xlim=(-0.02, 1.02),
        xticks=[0, 0.5, 1],
        ylim=(-0.6, len(fit.space) + 0.9),
    )
    ax.set_xticklabels(["lower end", "middle", "upper end"])
    ax.tick_params(axis="y", labelsize=FONT - 1, length=0)
    legend(ax, loc="upper left", ncols=2, columnspacing=1.0, handlelength=1.4, borderaxespad=0)
    return ax


def _draw_prior(ax: Axes, space: ParameterSpace, i: int, prior: Prior, base: float) -> None:
    """Draw the prior of parameter i as heights above its bar."""
    unit = np.linspace(0, 1, 121)
    values = space.from_unit(np.repeat(unit[:, None], len(space), axis=1))[:, i]
    density = np.nan_to_num(read_prior(prior, space[i]).pdf(values), posinf=0.0)
    height = 0.42 * density / max(float(density.max()), 1e-300)
    ax.fill_between(unit, base + 0.22, base + 0.22 + height, color=OTHER, alpha=0.5, lw=0)


def draws_of(fit: Fit) -> Array:
    """Take the draws of a posterior, or draw from the fitted distribution.

    Parameters
    ----------
    fit : Fit
        The fit.

    Returns
    -------
    (K, d) array
        In the parameters' units.
    """
    if fit.posterior is not None and fit.parameters_are_constant:
        chain = fit.posterior.chain
        return np.asarray(chain.reshape(-1, chain.shape[2])[:, : len(fit.space)])
    return fit.sample(DRAWS, 0)


def corner(fit: Fit, axes: Any = None) -> Any:
    """Draw the joint distribution of the parameters, two by two.

    Contours hold half and 90 % of the draws. Of more than six parameters, those are drawn that vary
    most relative to their search interval.

    Parameters
    ----------
    fit : Fit
        What to draw.
    axes : (d, d) array of Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    (d, d) array of Axes

    Raises
    ------
    MissingPackage
        If matplotlib is not installed (extra `plots`) and no axes are given.
    """
    draws = draws_of(fit)
    order = np.argsort(-draws.std(axis=0) / (fit.space.high - fit.space.low), kind="stable")
    chosen = np.sort(order[:MOST])
    if axes is None:
        need("matplotlib", extra="plots", caller="A figure")
        import matplotlib.pyplot as plt

        side = 1.2 + 0.8 * len(chosen)
        axes = plt.subplots(
            len(chosen), len(chosen), figsize=(side, side), layout="constrained", squeeze=False
        )[1]
    units = [_near(fit, i) for i in range(len(fit.space))]
    base = np.array([unit.base for unit in units])
    scale = np.array([unit.scale for unit in units])
    draws = (draws - base) / scale
    for row, i in enumerate(chosen):
        for column, j in enumerate(chosen):
            _cell(axes[row][column], units, draws, int(i), int(j), row, column, len(chosen))
    return axes


def correlated_pairs(fit: Fit, maximum: int = 12) -> list[tuple[int, int, float]]:
    """List the pairs of parameters that are correlated most.

    Parameters
    ----------
    fit : Fit
        The fit.
    maximum : int
        Pairs at most.

    Returns
    -------
    list of (int, int, float)
        Two parameters, the later one second, and their correlation in the draws; the strongest
        first. Those of a parameter with one value alone are left out.
    """
    spread = fit.sd > 0
    draws = draws_of(fit)
    varies = np.flatnonzero(spread & (np.ptp(draws, axis=0) > 0))
    if len(varies) < 2:
        return []
    matrix = np.asarray(np.corrcoef(draws[:, varies].T))
    first, second = np.triu_indices(len(varies), 1)
    values = matrix[first, second]
    order = np.argsort(-np.abs(values), kind="stable")[:maximum]
    return [(int(varies[first[k]]), int(varies[second[k]]), float(values[k])) for k in order]


def pair(fit: Fit, i: int, j: int, ax: Axes | None = None) -> Axes:
    """Draw the joint distribution of two parameters: contours that hold half and 90 % of the draws.

    Parameters
    ----------
    fit : Fit
        What to draw.
    i, j : int
        The parameters, across and up.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, size=(2.2, 2.1))
    units = [_near(fit, k) for k in range(len(fit.space))]
    draws = draws_of(fit)
    x, y = ((draws[:, k] - units[k].base) / units[k].scale for k in (i, j))
    _contours(ax, x, y)
    for k, line in ((i, ax.axvline), (j, ax.axhline)):
        truth = units[k].truth
        ends = x if k == i else y
        if truth is not None and ends.min() <= truth <= ends.max():
            line(truth, color=BEFORE, lw=1)
    ax.set_xlabel(units[i].label, fontsize=FONT)
    ax.set_ylabel(units[j].label, fontsize=FONT)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(_few_ticks(2))
    ax.spines[["top", "right"]].set_visible(False)
    return ax


@dataclass(frozen=True)
class _Unit:
    """How a parameter is written on its axis: (value - base) / scale, as the label says."""

    label: str
    base: float
    scale: float
    truth: float | None


def _near(fit: Fit, i: int) -> _Unit:
    """Choose how a parameter is written.

    As it is; in a power of ten where it is very small or large; as a difference where its
    distribution is narrow relative to its mean.
    """
    parameter = fit.space[i]
    mean = float(fit.mean[i])
    sd = float(fit.sd[i])
    narrow = 0 < sd < NARROW * abs(mean)
    power = int(np.floor(np.log10(sd if narrow else max(abs(mean), sd, 1e-300))))
    base = round(mean, -power) if narrow else 0.0
    power = power if narrow or not -3 < power < 4 else 0
    name = folded(parameter.name) + (f"\n− {base:.{max(0, -power)}f}" if narrow else "")
    unit = f"1e{power} {parameter.unit}".rstrip() if power else parameter.unit
    truth = fit.truth.get(parameter.name)
    return _Unit(
        f"{name}\n[{unit}]" if unit else name,
        base,
        10.0**power,
        None if truth is None else (truth - base) / 10.0**power,
    )


def _cell(
    ax: Axes, units: list[_Unit], draws: Array, i: int, j: int, row: int, column: int, count: int
) -> None:
    """Draw parameter i over parameter j, or the histogram of one."""
    if column > row:
        ax.set_axis_off()
        return
    ax.spines[["top", "right"]].set_visible(False)
    if i == j:
        ax.hist(draws[:, i], bins=30, density=True, histtype="stepfilled", color=AFTER, alpha=0.45)
        ax.set_yticks([])
    else:
        _contours(ax, draws[:, j], draws[:, i])
    truth = units[j].truth
    if truth is not None and draws[:, j].min() <= truth <= draws[:, j].max():
        ax.axvline(truth, color=BEFORE, lw=1)
    ax.tick_params(labelsize=FONT - 1.5)
    for axis, last, unit in (
        (ax.xaxis, row == count - 1, units[j]),
        (ax.yaxis, column == 0 and row > 0, units[i]),
    ):
        axis.set_major_locator(_few_ticks(3 if count < 4 else 2))
        if last:
            axis.set_label_text(unit.label, fontsize=FONT - 1)
        else:
            axis.set_ticklabels([])


def _few_ticks(intervals: int) -> Any:
    """A locator of a few ticks."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(intervals)


def _contours(ax: Axes, x: Array, y: Array) -> None:
    """Draw contours of a smoothed histogram; a dot where a parameter has one value alone."""
    from scipy.ndimage import gaussian_filter

    if np.ptp(x) <= 0 or np.ptp(y) <= 0:
        ax.plot(x[:1], y[:1], ".", color=AFTER)
        return
    counts, across, up = np.histogram2d(x, y, bins=40)
    smooth = gaussian_filter(np.pad(counts, 3), 1.6)
    ranked = np.sort(smooth.ravel())[::-1]
    shares = np.cumsum(ranked) / ranked.sum()
    levels = [float(ranked[np.searchsorted(shares, share)]) for share in INSIDE]
    centres = [_padded((edges[:-1] + edges[1:]) / 2) for edges in (across, up)]
    ax.contourf(
        *centres,
        smooth.T,
        levels=[*levels, float(ranked[0]) * 1.001],
        colors=[AFTER, AFTER],
        alpha=0.35,
    )
    ax.contour(*centres, smooth.T, levels=levels, colors=[AFTER], linewidths=0.8)


def _padded(centres: Array) -> Array:
    """Centres of bins with three more at each end."""
    step = centres[1] - centres[0]
    before = centres[0] - step * np.arange(3, 0, -1)
    after = centres[-1] + step * np.arange(1, 4)
    return np.concatenate([before, centres, after])


def correlation(fit: Fit, ax: Axes | None = None) -> Axes:
    """Draw the correlations between parameters as numbers on squares: blue above 0, orange below.

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
    matrix = np.corrcoef(draws_of(fit).T) if fit.parameters_are_constant else fit.correlation
    otherwise = "Only one parameter was fitted."
    return squares(np.atleast_2d(matrix), fit.space.names, axes_of(ax), otherwise)


def squares(matrix: Array, names: tuple[str, ...], ax: Axes, otherwise: str) -> Axes:
    """Draw the lower half of a symmetric matrix, with names along its diagonal.

    Parameters
    ----------
    matrix : (n, n) array
        Numbers in [-1, 1].
    names : tuple of str
        Of the n rows.
    ax : Axes
        Where to draw.
    otherwise : str
        What to write where there are fewer than two rows.

    Returns
    -------
    Axes
    """
    count = len(names)
    if count < 2:
        return empty(ax, otherwise)
    small = FONT - 1.5
    for i in range(count):
        for j in range(i):
            value = float(matrix[i, j])
            shade = AFTER if value >= 0 else BEFORE
            ax.fill(
                [j, j + 1, j + 1, j],
                [-i, -i, -i - 1, -i - 1],
                color=shade,
                alpha=min(1.0, abs(value)) * 0.6,
                lw=0,
            )
            ax.text(
                j + 0.5,
                -i - 0.5,
                f"{value:.2f}",
                ha="center",
                va="center",
                fontsize=small,
                color=INK,
            )
        ax.text(
            i + 0.1,
            -i - 0.5,
            names[i],
            ha="left",
            va="center",
            fontsize=small,
            color=INK if count < 12 else GREY,
        )
    wide = max(
        (i + 0.1) / max(0.2, 1 - len(name) * small * CHARACTER) for i, name in enumerate(names)
    )
    ax.set(xlim=(0, max(count + 0.5, wide)), ylim=(-count, 0))
    ax.set_axis_off()
    return ax
