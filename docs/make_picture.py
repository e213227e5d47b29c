"""Draws docs/images/fit.png by fitting: `python docs/make_picture.py` (needs the extra `plots`;
about 10 s).

The data are those of the thesis' table 6.2: 1000 hopper transitions whose torso mass is drawn anew
every 10 transitions. The errors are those of one control step, on 1000 further transitions that the
fit has not seen.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.random import Generator

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import CUT
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import hopper_problem

mpl.use("Agg")
import matplotlib.pyplot as plt

# of Okabe and Ito's palette, told apart by all kinds of sight
BLUE = "#0072B2"
ORANGE = "#D55E00"
GREY = "#BBBBBB"
DARK = "#222222"
# [kg] table 6.2
MEAN = np.array(list(TRUTH.values()))
SD = np.array([0.5, 1e-5, 1e-5, 1e-5])
# of the fitted and of the unseen transitions
SEED = 62
FRESH = 63


def draw_masses(rng: Generator, blocks: int) -> Array:
    """The four masses of so many blocks (blocks, 4): the torso's varies, the others hardly."""
    return MEAN + SD * rng.standard_normal((blocks, 4))


def measured(seed: int) -> tuple[Trajectories, Array]:
    """1000 transitions and the masses behind each 10 of them, (100, 4)."""
    return simulate(500, 2, rng=np.random.default_rng(seed), masses=draw_masses, block=10)


def errors(problem: Problem, data: Trajectories, values: Array) -> Array:
    """(p,) RMS error of the predictions of one step under a parameter vector (d,)."""
    segments = problem.cut(data)
    misfit = problem.simulator.predict(values[None], segments)[0] - problem.simulator.targets(
        segments
    )
    rms: Array = np.sqrt(np.mean(misfit**2, axis=0))
    return rms


def density(fit: Fit, at: Array, i: int) -> Array:
    """The fitted truncated Gaussian's density of parameter i."""
    z = (at - fit.mean[i]) / fit.scale[i]
    bell = np.where(np.abs(z) <= CUT, np.exp(-(z**2) / 2), 0.0)
    out: Array = bell / np.trapezoid(bell, at)
    return out


def torso_panel(ax: Any, fit: Fit, drawn: Array) -> None:
    """The fitted law of the torso's mass over the draws behind the data."""
    low = fit.space[0].low
    high = fit.space[0].high
    at = np.linspace(low, high, 2001)
    ax.hist(
        drawn,
        bins=np.arange(low, high, 0.2),
        density=True,
        color=GREY,
        label=f"{len(drawn)} masses behind the data",
    )
    ax.plot(at, density(fit, at, 0), color=BLUE, lw=2.2, label="fitted distribution")
    ax.axhline(
        1 / (high - low),
        color=DARK,
        lw=1.2,
        ls=(0, (4, 3)),
        label="uniform over the search interval",
    )
    ax.set(
        xlim=(low, high),
        xlabel="torso mass [kg]",
        ylabel="density [1/kg]",
        title="A mass that varies",
    )
    ax.set_ylim(0, 1.32 * ax.get_ylim()[1])
    ax.legend(loc="upper right", frameon=False, fontsize=8)


def masses_panel(ax: Any, fit: Fit) -> None:
    """All four masses: what was searched, what was found, what is true."""
    y = np.arange(4)[::-1]
    low = fit.space.low
    high = fit.space.high
    ax.barh(y, high - low, left=low, height=0.5, color="#E6E6E6", label="search interval")
    ax.barh(
        y, 4 * fit.sd, left=fit.mean - 2 * fit.sd, height=0.5, color=BLUE, label="fit: mean ± 2 sd"
    )
    ax.plot(fit.mean, y, "|", color=BLUE, ms=15, mew=2.2)
    ax.plot(MEAN, y, "D", color=ORANGE, ms=4.5, label="true mean")
    ax.set(
        yticks=y,
        yticklabels=[name.removesuffix("_mass") for name in fit.space.names],
        xlabel="mass [kg]",
        title="All four masses",
    )
    ax.set(xlim=(0, 11.5), ylim=(-0.55, 4.75))
    handles, labels = ax.get_legend_handles_labels()
    ax.legend(
        handles[1:] + handles[:1],
        labels[1:] + labels[:1],
        loc="upper right",
        frameon=False,
        fontsize=8,
    )  # bars first


def error_panel(ax: Any, names: list[str], before: Array, after: Array) -> None:
    """The error of one step for every signal, at the middle of the search box and at the fitted
    mean.
    """
    y = np.arange(len(names))[::-1]
    ax.hlines(y, after, before, color=GREY, lw=1.6, zorder=1)
    ax.plot(before, y, "o", color=ORANGE, ms=5.5, label="middle of the search box")
    ax.plot(after, y, "s", color=BLUE, ms=5, label="fitted mean")
    ax.set(
        xscale="log",
        yticks=y,
        yticklabels=names,
        xlabel="RMS error one step ahead, unseen data",
        title="Prediction",
    )
    ax.set_ylim(-0.7, len(names) + 1.6)
    ax.tick_params(axis="y", labelsize=7.5)
    ax.legend(loc="upper left", frameon=False, fontsize=8)


def main() -> None:
    """Fits, draws, and prints the figures that the picture shows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("images") / "fit.png")
    options = parser.parse_args()
    data, drawn = measured(SEED)
    problem = hopper_problem("hopper, torso mass varies", data, 1e-8)
    fit = DROPO().fit(problem, rng=0)
    fresh = measured(FRESH)[0]
    before = errors(problem, fresh, (fit.space.low + fit.space.high) / 2)
    after = errors(problem, fresh, fit.mean)
    print(fit)
    print(
        f"torso masses behind the data: mean {drawn[:, 0].mean():.3f} kg, sd "
        f"{drawn[:, 0].std(ddof=1):.3f} kg"
    )
    print(
        "error one step ahead, middle of the box over fitted mean: "
        f"{(before / after).min():.1f} to {(before / after).max():.1f}"
    )
    mpl.rcParams.update(
        {
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.titlesize": 10.5,
        }
    )
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(12, 3.7), width_ratios=(1.15, 1, 1), layout="constrained"
    )
    torso_panel(left, fit, drawn[:, 0])
    masses_panel(middle, fit)
    error_panel(right, [f"{s.name} [{s.unit}]" for s in problem.simulator.signals], before, after)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=130)


if __name__ == "__main__":
    main()
