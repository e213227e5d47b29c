"""Tables 6.2 and 6.3: masses drawn anew every 10 transitions, fitted by every method."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.studies.engine.comparison_table import note_on_tests
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_fits import (
    AS_PUBLISHED,
    as_published,
    compared,
    fitted,
    item,
    variant_item,
)
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, MEAN, SPREAD, THESIS, HopperStudySize
from dropo.studies.tiboni_2021.rows import (
    Rows,
    comparison_of,
    costs,
    likelihoods,
    means,
    over_data_sets,
    spreads,
)

FAST = ("dropo", "random effects", "least squares")
SLOW = ("droid",)

NOTES = (
    "z is (estimate - drawn sample's value) / standard error; '-' where there is no "
    "standard error. Seconds are those of one thread.",
    "sd is that of the law itself; the thesis prints the scale of a Gaussian cut at two of "
    "it, whose sd is 0.88 of the scale. Its data are another draw: that alone moves a mean by a "
    "tenth of the spread, and a spread by 7 %, in one standard error.",
    "dropo takes every transition for an independent draw, as the thesis does; random "
    "effects know which ten share one.",
)


def recovered(
    name: str,
    table: str,
    work: Work,
    seeds: int | None,
    published: bool,
    size: HopperStudySize,
    variants: Sequence[Variant] = (),
    *,
    full: bool = False,
) -> Study:
    """The study of table 6.2 or 6.3.

    Parameters
    ----------
    name : str
        Name of the study.
    table : str
        "6.2" or "6.3".
    work : Work
        Runs the fits.
    seeds : int or None
        Number of data sets; None for that of `size`.
    published : bool
        Whether the method is also run as published.
    size : HopperStudySize
        How large the study is.
    variants : sequence of Variant
        Methods with parts exchanged, which fit every data set too.
    full : bool
        Whether the method is run as published at full size, on the first data sets.

    Returns
    -------
    Study
        Means, spreads, likelihoods and costs, without and with noise.
    """
    count = seeds or size.seeds
    methods = (*FAST, *SLOW, *(("dropo, published",) if published else ()))
    labels = [variant.label for variant in variants]
    keys = []
    for kind in EPSILON:
        for seed in range(count):
            keys += [(kind, seed, method) for method in (methods if seed == 0 else FAST)]
    items = [item(table, kind, seed, size, method=method) for kind, seed, method in keys]
    for kind in EPSILON:
        for seed in range(count):
            keys += [(kind, seed, variant.label) for variant in variants]
            items += [variant_item(table, kind, seed, size, variant) for variant in variants]
    fits = dict(zip(keys, work.map(fitted, items), strict=True))
    if full:
        for kind in EPSILON:
            fits[kind, 0, AS_PUBLISHED] = as_published(work, item(table, kind, 0, size))
        methods = (*methods, AS_PUBLISHED)
    firsts: dict[str, Rows] = {
        kind: {method: fits[kind, 0, method] for method in (*methods, *labels)} for kind in EPSILON
    }
    items = [_distributions(table, kind, size, rows) for kind, rows in firsts.items()]
    compared_by_kind = work.map(compared, items)
    tables: list[Table] = []
    data: dict[str, Any] = {}
    for (kind, rows), values in zip(firsts.items(), compared_by_kind, strict=True):
        title = f"table {table}, {kind}, epsilon {EPSILON[kind]:.0e}"
        over = {}
        for method in (*FAST, *labels):
            over[method] = [fits[kind, seed, method] for seed in range(count)]
        tables += [
            means(title, rows, table, kind),
            spreads(title, rows, table, kind),
            likelihoods(title, values, size.draws),
            over_data_sets(title, over),
            costs(title, over),
            *comparison_of(title, over, variants),
        ]
        data[kind] = {"first": rows, "data_sets": over, "laws": values}
    what = "the torso's mass varies" if table == "6.2" else "thigh, leg and foot vary"
    title = (
        f"Table {table}: {what}, other masses every 10 of {size.transitions} transitions; "
        f"{count} data sets"
    )
    small = (*((reduced(size),) if published else ()), *((of_full(size),) if full else ()))
    tests = (note_on_tests(count),) if variants else ()
    remarks = (*NOTES, *small, *tests, *_remarks(table, data))
    return Study(name, title, tuple(tables), remarks, data)


def reduced(size: HopperStudySize) -> str:
    """Say what "dropo, published" means in a table of that size.

    Parameters
    ----------
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    str
        A sentence.
    """
    draws, budget, stride = size.published
    return (
        f"'dropo, published' is Monte Carlo and CMA-ES at a reduced size: K = {draws}, "
        f"{budget} evaluations, every {stride}th transition"
        " (the thesis: K = 100, 5000 evaluations, all of them)."
    )


def of_full(size: HopperStudySize) -> str:
    """Say what "dropo, as published" means in a table of that size.

    Parameters
    ----------
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    str
        Two sentences.
    """
    draws, budget = size.full
    return (
        f"{AS_PUBLISHED!r} is Monte Carlo with K = {draws} draws of their own for every evaluation,"
        f" and CMA-ES without restarts, {budget} evaluations, all transitions. Its seconds are the"
        " processor's."
    )


def _distributions(table: str, kind: str, size: HopperStudySize, rows: Rows) -> dict[str, Any]:
    """The item that compares fits, the drawn sample, the truth and the thesis' own fit."""
    dropo = rows["dropo"]
    distributions = {
        "dropo": [dropo["mean"], dropo["sd"]],
        "random effects": [rows["random effects"]["mean"], rows["random effects"]["sd"]],
        "drawn sample's moments": [dropo["drawn_mean"], dropo["drawn_sd"]],
        "law the masses were drawn from": [MEAN.tolist(), SPREAD[table].tolist()],
    }
    if kind == "clean":  # the thesis' noisy row of table 6.2 has no spread at all
        mean, scale = THESIS[table, kind, "dropo"]
        distributions["thesis, dropo"] = [list(mean), (0.88 * np.array(scale)).tolist()]
    return item(table, kind, 0, size, distributions=distributions)


def _remarks(table: str, data: dict[str, Any]) -> list[str]:
    """What the numbers say against the thesis, and of each other."""
    varying = SPREAD[table] > 1e-3
    out = []
    for kind, part in data.items():
        distributions = part["laws"]
        gains = []
        for name, row in distributions.items():
            if name not in ("dropo", "random effects"):
                gain = distributions["dropo"]["exact"] - row["exact"]
                gains.append(f"{gain:+.1f} nat over the {name}")
        apart = max(abs(row["simulator"] - row["emulator"]) for row in distributions.values())
        out.append(
            f"{kind}: the log-likelihood of dropo's fit is {', '.join(gains)}; simulator and "
            f"emulator differ by at most {apart:.1f} nat."
        )
        effects = part["data_sets"]["random effects"]
        errors = np.array([np.subtract(row["sd"], row["drawn_sd"])[varying] for row in effects])
        out.append(
            f"{kind}: random effects give each spread within {np.abs(errors).max():.2g} kg of "
            "the drawn sample's, in the worst data set."
        )
    scale = THESIS[table, "noisy", "dropo"][1]
    if max(scale) < 1e-5 and "noisy" in data:
        out.append(
            f"noisy: the thesis prints scales of about {max(scale):.0e}, below the lowest "
            "that its search allows (1e-5), in the pattern of its DROID rows: that is not DROPO's "
            "optimum, which keeps a spread of "
            f"{max(data['noisy']['first']['dropo']['sd']):.2f} kg."
        )
    return out
