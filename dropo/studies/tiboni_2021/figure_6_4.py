"""Figure 6.4: what epsilon does to the fitted distribution."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import number
from dropo.estimators.dropo import DROPO, SWEEP
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_fits import Item, problem_of, variant_item
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, FULL, HopperStudySize

HEADER = (
    "epsilon",
    "total variance [kg^2]",
    "least",
    "most",
    "mean squared error",
    "least",
    "most",
    "chosen",
)


def figure_6_4(
    work: Work,
    seeds: int | None = None,
    *,
    variants: Sequence[Variant] = (),
    size: HopperStudySize = FULL,
) -> Study:
    """Total variance and mean squared error against epsilon, and the one chosen (figure 6.4).

    Parameters
    ----------
    work : Work
        Runs the sweeps.
    seeds : int or None
        Number of data sets; None for that of `size`.
    variants : sequence of Variant
        DROPO with parts exchanged, each with a table of its own.
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    Study
        The sweep over data sets, and how often each epsilon is chosen (section 5.3).

    Raises
    ------
    Incompatible
        If a variant is of another method, which sweeps no epsilon.
    """
    count = seeds or size.seeds
    for variant in variants:
        if variant.method != Variant().method:
            raise Incompatible(
                f"Figure 6.4 is DROPO's sweep over epsilon, which {variant.method!r} has not."
                " Leave --method out."
            )
    sweeps = _sweeps(work, count, size, Variant())
    columns = _columns(sweeps)
    title = (
        f"figure 6.4, noise of variance {EPSILON['noisy']:.0e}: median, least and most of "
        f"{count} data sets"
    )
    tables = [_table(title, sweeps)]
    others = {variant.label: _sweeps(work, count, size, variant) for variant in variants}
    tables += [_table(f"{label}, the same data", swept) for label, swept in others.items()]
    remarks = (
        "Chosen is the smallest epsilon whose mean squared error is at most 1.1 times the "
        "least of the sweep; the thesis chooses 1e-5.",
        f"From epsilon {SWEEP[0]:.0e} to 1e-5 the median mean squared error falls by "
        f"{_fall(columns['mse']):.3g} times, the median total variance by "
        f"{_fall(columns['total_variance']):.3g} times.",
    )
    data = {"epsilon": list(SWEEP), **_numbers(sweeps)}
    if others:
        data["variants"] = {label: _numbers(swept) for label, swept in others.items()}
    return Study(
        "figure-6.4",
        f"Figure 6.4: the choice of epsilon; {count} data sets",
        tuple(tables),
        remarks,
        data,
        lambda figure: _draw(figure, columns),
    )


def tuned(item: Item) -> dict[str, Any]:
    """The sweep over epsilon on one data set, and the epsilon that it chooses.

    Parameters
    ----------
    item : dict
        As `hopper_fits.variant_item` gives it.

    Returns
    -------
    dict
        The table of the sweep, the chosen epsilon, and the cost on one thread.
    """
    problem, _ = problem_of(item)
    settings = {**item["variant"]["settings"], "epsilon": "tune", "sweep": SWEEP}
    fit = DROPO(**settings).fit(problem, rng=0)
    assert fit.noise_tuning is not None
    return {
        "tuning": [dict(vars(trial)) for trial in fit.noise_tuning.trials],
        "chosen": float(fit.epsilon[0]),
        "steps": fit.simulator_steps,
        "seconds": fit.wall_time_s,
    }


def _sweeps(
    work: Work, count: int, size: HopperStudySize, variant: Variant
) -> list[dict[str, Any]]:
    """A variant's sweeps over data sets."""
    items = [variant_item("6.1", "noisy", seed, size, variant) for seed in range(count)]
    return work.map(tuned, items)


def _columns(sweeps: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Total variances and mean squared errors (N, number of epsilons) of N sweeps."""
    columns = {}
    for name in ("total_variance", "mse"):
        columns[name] = np.array([[row[name] for row in sweep["tuning"]] for sweep in sweeps])
    return columns


def _numbers(sweeps: list[dict[str, Any]]) -> dict[str, Any]:
    """Everything that sweeps found."""
    further = {name: np.array([sweep[name] for sweep in sweeps]) for name in ("chosen", "steps")}
    return {**_columns(sweeps), **further}


def _table(title: str, sweeps: list[dict[str, Any]]) -> Table:
    """Median, least and most over data sets, and how often each epsilon is chosen."""
    chosen = np.array([sweep["chosen"] for sweep in sweeps])
    columns = _columns(sweeps)
    lines = []
    for i, epsilon in enumerate(SWEEP):
        numbers = [v for values in columns.values() for v in _median_and_range(values[:, i])]
        times = int((chosen == epsilon).sum())
        lines.append((f"{epsilon:.0e}", *(number(v, 3) for v in numbers), str(times)))
    return Table(title, HEADER, tuple(lines))


def _median_and_range(values: np.ndarray) -> tuple[float, float, float]:
    """Median, minimum and maximum."""
    return float(np.median(values)), float(values.min()), float(values.max())


def _fall(values: np.ndarray) -> float:
    """The median at the first epsilon over that at 1e-5."""
    medians = np.median(values, axis=0)
    return float(medians[0] / medians[SWEEP.index(1e-5)])


def _draw(figure: Any, columns: dict[str, np.ndarray]) -> None:
    """Median and range of each quantity against epsilon."""
    for axes, (name, values) in zip(figure.subplots(1, 2), columns.items(), strict=True):
        axes.fill_between(SWEEP, values.min(axis=0), values.max(axis=0), alpha=0.2, linewidth=0)
        axes.plot(SWEEP, np.median(values, axis=0), "o-", markersize=4)
        axes.axvline(EPSILON["noisy"], color="gray", linestyle=":", linewidth=1)
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="epsilon",
            title=name.replace("_", " ").replace("mse", "mean squared error"),
        )
