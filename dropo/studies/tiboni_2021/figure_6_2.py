"""Figure 6.2: the fitted distributions of the masses that vary."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import norm

from dropo.core.services.tables import number
from dropo.core.services.validation import require
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_fits import fitted, item, variant_item
from dropo.studies.tiboni_2021.hopper_sets import (
    EPSILON,
    FULL,
    MASSES,
    MEAN,
    SPREAD,
    THESIS,
    HopperStudySize,
)

PANELS = (("6.2", 0), ("6.3", 1), ("6.3", 2), ("6.3", 3))
"""The data set's table and the mass of each panel: (a) the torso, (b) the other three."""
METHODS = ("dropo", "random effects", "droid")
REMARKS = (
    "The law is what the masses were drawn from, the sample the masses drawn; no "
    "method can know more than the sample.",
    "DROID's spread is that of its search; the thesis' DROPO rows give the scale of a "
    "Gaussian cut at two of it (sd 0.88 of it).",
)
Fits = dict[tuple[str, str, str], dict[str, Any]]
"""(table, kind, method) -> what `hopper_fits.fitted` gives."""
COLORS = {"clean": "tab:orange", "noisy": "tab:red"}


def figure_6_2(
    work: Work,
    seeds: int | None = None,
    *,
    variants: Sequence[Variant] = (),
    size: HopperStudySize = FULL,
) -> Study:
    """Fitted distributions of the masses that vary, beside the true ones (figure 6.2).

    Parameters
    ----------
    work : Work
        Runs the fits.
    seeds : int or None
        None or 1, as the figure shows one data set.
    variants : sequence of Variant
        Methods with parts exchanged, in the tables beside the others.
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    Study
        A table for each mass that varies.

    Raises
    ------
    BadArgument
        If `seeds` is another number.
    """
    require(seeds in (None, 1), "seeds", "1, as the figure shows one data set", seeds, "figure-6.2")
    keys = [
        (table, kind, method) for table in ("6.2", "6.3") for kind in EPSILON for method in METHODS
    ]
    items = [item(table, kind, 0, size, method=method) for table, kind, method in keys]
    for table, kind in product(("6.2", "6.3"), EPSILON):
        keys += [(table, kind, variant.label) for variant in variants]
        items += [variant_item(table, kind, 0, size, variant) for variant in variants]
    fits = dict(zip(keys, work.map(fitted, items), strict=True))
    methods = (*METHODS, *(variant.label for variant in variants))
    tables = tuple(_panel(table, i, fits, methods) for table, i in PANELS)
    data: dict[str, Any] = {" ".join(key): fit for key, fit in fits.items()}
    title = "Figure 6.2: distributions of the masses that vary, data set 0 of tables 6.2 and 6.3"
    return Study("figure-6.2", title, tables, REMARKS, data, lambda figure: _draw(figure, fits))


def _panel(table: str, i: int, rows: Fits, methods: Sequence[str]) -> Table:
    """Means and standard deviations of the i-th mass by method, the thesis' own beneath."""
    sample = rows[table, "clean", "dropo"]
    lines = [
        ("law", f"{MEAN[i]:.4f}", number(SPREAD[table][i], 3)),
        ("drawn sample", f"{sample['drawn_mean'][i]:.4f}", number(sample["drawn_sd"][i], 3)),
    ]
    for kind in EPSILON:
        for method in methods:
            row = rows[table, kind, method]
            lines.append((f"{method}, {kind}", f"{row['mean'][i]:.4f}", number(row["sd"][i], 3)))
            if (table, kind, method) in THESIS:
                mean, scale = THESIS[table, kind, method]
                lines.append((f"  thesis, {method}, {kind}", f"{mean[i]:.3f}", number(scale[i], 3)))
    header = (MASSES[i], "mean [kg]", "sd [kg]")
    return Table(f"{MASSES[i]}, data of table {table}", header, tuple(lines))


def _draw(figure: Any, rows: Fits) -> None:
    """Densities of each mass: the true one, DROPO's, and DROID's points."""
    for axes, (table, i) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
        mean = MEAN[i]
        sd = SPREAD[table][i]
        grid = np.linspace(mean - 4 * sd, mean + 4 * sd, 200)
        truth = norm.pdf(grid, mean, sd)
        axes.fill_between(grid, truth, alpha=0.2, linewidth=0, label="ground truth")
        for kind in EPSILON:
            color = COLORS[kind]
            row = rows[table, kind, "dropo"]
            density = norm.pdf(grid, row["mean"][i], max(row["sd"][i], 1e-3))
            axes.plot(grid, density, color=color, label=f"DROPO, {kind}")
            point = rows[table, kind, "droid"]["mean"][i]
            axes.axvline(point, color=color, linestyle="--", linewidth=1, label=f"DROID, {kind}")
        axes.set(title=MASSES[i], xlabel="mass [kg]", yticks=[], ylim=(0, 2 * norm.pdf(0) / sd))
    figure.axes[0].legend(fontsize=6)
