"""Table 6.1: four masses that do not vary."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtr

from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.problems.hopper.model import BODIES
from dropo.studies.engine.comparison_table import note_on_tests
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.distribution_recovery import of_full, reduced
from dropo.studies.tiboni_2021.hopper_fits import (
    AS_PUBLISHED,
    AUTHORS,
    as_published,
    at_hand,
    evaluated,
    fitted,
    item,
    variant_item,
)
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, FULL, MASSES, MEAN, HopperStudySize
from dropo.studies.tiboni_2021.rows import (
    Rows,
    comparison_of,
    costs,
    means,
    over_data_sets,
    spreads,
)

FAST = ("dropo", "least squares")
SLOW = ("droid",)
EXTRA = ("dropo, learned epsilon", "dropo, all data")
"""Fits with another noise or other data, whose likelihoods are on other scales."""
PRINTED = 5e-4  # [kg] half the last digit that the thesis prints
POINT = [1e-5] * 4  # [kg] the standard deviation of a distribution that is a point

NOTES = (
    "z is (estimate - truth) / standard error. Without noise nothing but rounding is left, "
    "in the errors and in the standard errors.",
    "log-lik. is the thesis' likelihood of every fitted law at the table's epsilon, from "
    "the same draws. Seconds are those of one thread.",
    "The scales of DROID, in the thesis and here, say how far the search had shrunk when "
    "it stopped, nothing about the parameters.",
)
Set = tuple[str, str]
"""Table (or `AUTHORS`) and kind of a data set."""
Fits = dict[tuple[str, str, int, str], dict[str, Any]]
"""(table, kind, seed, method) -> what `hopper_fits.fitted` gives."""


def table_6_1(
    work: Work,
    seeds: int | None = None,
    *,
    published: bool = False,
    full: bool = False,
    variants: Sequence[Variant] = (),
    size: HopperStudySize = FULL,
) -> Study:
    """Four masses that do not vary, from 1000 transitions, without and with noise (table 6.1).

    The data are the authors', if they are at hand, and our own.

    Parameters
    ----------
    work : Work
        Runs the fits.
    seeds : int or None
        Number of our own data sets; None for that of `size`.
    published : bool
        Whether the method is also run as published, at a reduced size.
    full : bool
        Whether it is run as published at full size, on the first data sets: many hours.
    variants : sequence of Variant
        Methods with parts exchanged, beside the others.
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    Study
        Means, spreads, likelihoods, random starts and costs of each data set.
    """
    count = seeds or size.seeds
    slowest = _as_published(work, size) if full else {}
    fits = _fits(work, count, published, variants, size) | slowest
    sets = sorted({key[:2] for key in fits})
    starts = _from_random_starts(work, sets, size)
    log_likelihoods = _log_likelihoods(work, sets, fits, size)
    tables: list[Table] = []
    data: dict[str, Any] = {}
    remarks = [*NOTES, *([reduced(size)] if published else []), *([of_full(size)] if full else [])]
    remarks += [note_on_tests(count)] if variants else []
    for table, kind in sets:
        title = f"{table if table == AUTHORS else 'our data'}, {kind}, epsilon {EPSILON[kind]:.0e}"
        rows: Rows = {}
        for (own_table, own_kind, seed, method), row in fits.items():
            if (own_table, own_kind, seed) == (table, kind, 0):
                rows[method] = row
        own_starts = starts[table, kind]
        own_likelihoods = log_likelihoods[table, kind]
        tables += [
            means(title, rows, "6.1", kind),
            spreads(title, rows, "6.1", kind),
            _likelihoods_table(title, own_likelihoods),
            _starts_table(title, own_starts, rows["dropo"]),
        ]
        data[title] = {
            "first": rows,
            "likelihoods": own_likelihoods,
            "random_starts": own_starts,
        }
        if table == "6.1":
            over = {}
            for method in (*FAST, *(variant.label for variant in variants)):
                over[method] = [fits[table, kind, seed, method] for seed in range(count)]
            tables += [over_data_sets(title, over), costs(title, over)]
            tables += comparison_of(title, over, variants)
            data[title]["data_sets"] = over
        remarks += _remarks(title, rows, own_likelihoods)
    if not any(table == AUTHORS for table, _ in sets):
        remarks.append("The authors' data are not at hand, so their tables are left out.")
    return Study(
        "table-6.1",
        f"Table 6.1: masses that do not vary; {count} data sets of our own",
        tuple(tables),
        tuple(remarks),
        data,
    )


def _fits(
    work: Work, count: int, published: bool, variants: Sequence[Variant], size: HopperStudySize
) -> Fits:
    """All methods on the first data sets, the fast ones and the variants on the others."""
    methods = (*FAST, *SLOW, *(("dropo, published",) if published else ()))
    keys = []
    for kind in EPSILON:
        for seed in range(count):
            keys += [("6.1", kind, seed, method) for method in (methods if seed == 0 else FAST)]
    if at_hand():
        keys += [(AUTHORS, kind, 0, method) for kind in EPSILON for method in methods]
        keys += [(AUTHORS, "noisy", 0, method) for method in EXTRA]
    items = [item(table, kind, seed, size, method=method) for table, kind, seed, method in keys]
    sets = [("6.1", kind, seed) for kind in EPSILON for seed in range(count)]
    sets += [(AUTHORS, kind, 0) for kind in EPSILON] if at_hand() else []
    for table, kind, seed in sets:
        keys += [(table, kind, seed, variant.label) for variant in variants]
        items += [variant_item(table, kind, seed, size, variant) for variant in variants]
    return dict(zip(keys, work.map(fitted, items), strict=True))


def _as_published(work: Work, size: HopperStudySize) -> Fits:
    """The published method at full size on the first data sets, one after the other."""
    sets = [(table, kind) for table in _tables_at_hand() for kind in EPSILON]
    return {
        (table, kind, 0, AS_PUBLISHED): as_published(work, item(table, kind, 0, size))
        for table, kind in sets
    }


def _tables_at_hand() -> tuple[str, ...]:
    """Our data, and the authors' where they are at hand."""
    return ("6.1", AUTHORS) if at_hand() else ("6.1",)


def _from_random_starts(
    work: Work, sets: list[Set], size: HopperStudySize
) -> dict[Set, list[dict[str, Any]]]:
    """DROPO's fits of each data set from random starts."""
    keys = [(table, kind, start) for table, kind in sets for start in range(size.starts)]
    items = [
        item(table, kind, 0, size, method="dropo, random start", start=start)
        for table, kind, start in keys
    ]
    out: dict[Set, list[dict[str, Any]]] = {key: [] for key in sets}
    for (table, kind, _), row in zip(keys, work.map(fitted, items), strict=True):
        out[table, kind].append(row)
    return out


def _log_likelihoods(
    work: Work, sets: list[Set], fits: Fits, size: HopperStudySize
) -> dict[Set, dict[str, float]]:
    """The thesis' log-likelihood of each fitted distribution and of the truth [nats]."""
    items = []
    for table, kind in sets:
        distributions = {}
        for (own_table, own_kind, seed, method), fit in fits.items():
            if (own_table, own_kind, seed) == (table, kind, 0) and method not in EXTRA:
                distributions[method] = [fit["mean"], fit["sd"]]
        distributions["truth, scale 1e-5"] = [MEAN.tolist(), POINT]
        items.append(item(table, kind, 0, size, distributions=distributions))
    return dict(zip(sets, work.map(evaluated, items), strict=True))


def _likelihoods_table(title: str, log_likelihoods: dict[str, float]) -> Table:
    """Log-likelihoods, and how far they are from the best."""
    best = max(log_likelihoods.values())
    lines = []
    for name, value in log_likelihoods.items():
        lines.append((name, f"{value:,.2f}", f"{value - best:+.2f}"))
    return Table(f"{title}: likelihoods", ("log-lik. [nat]", "value", "to the best"), tuple(lines))


def _starts_table(title: str, rows: list[dict[str, Any]], middle: dict[str, Any]) -> Table:
    """How far apart fits from random starts end: of each other and of the truth."""
    errors = np.array([np.subtract(row["mean"], row["drawn_mean"]) for row in rows])
    apart = np.array([np.subtract(row["mean"], middle["mean"]) for row in rows])
    scales = np.array([row["scale"] for row in rows])
    values = [row["log_likelihood"] for row in rows]
    steps = [row["steps"] for row in rows]
    seconds = [row["seconds"] for row in rows]
    steps_cells = (f"{np.median(steps):,.0f}", f"{max(steps):,}")
    seconds_cells = (f"{np.median(seconds):.1f}", f"{max(seconds):.1f}")
    lines = (
        ("worst error of a mean [kg]", *_numbers(np.abs(errors).max(axis=0))),
        ("farthest from the middle's fit [kg]", *_numbers(np.abs(apart).max(axis=0))),
        ("certified at the least scale", *(_certified(rows, f"{body}_mass") for body in BODIES)),
        ("largest scale [kg]", *_numbers(scales.max(axis=0))),
        ("log-likelihood, least and most", f"{min(values):,.3f}", f"{max(values):,.3f}", "", ""),
        ("steps, median and most", *steps_cells, "", ""),
        ("s, median and most", *seconds_cells, "", ""),
    )
    return Table(f"{title}: from {len(rows)} random starts", ("dropo", *MASSES), lines)


def _numbers(values: Array) -> list[str]:
    """Values with two digits."""
    return [number(value, 2) for value in values]


def _certified(rows: list[dict[str, Any]], name: str) -> str:
    """In how many fits the likelihood itself says that the parameter does not vary."""
    return f"{sum(name in row['certified'] for row in rows)} of {len(rows)}"


def _remarks(title: str, rows: Rows, log_likelihoods: dict[str, float]) -> list[str]:
    """Where these rows contradict the thesis', and what was learned of the noise."""
    row = rows["dropo"]
    out = []
    error = np.subtract(row["mean"], MEAN)
    se = np.array(row["mean_se"])
    scale = np.array(row["scale"])
    gain = log_likelihoods["dropo"] - log_likelihoods["truth, scale 1e-5"]
    if (np.abs(error) > PRINTED).any():
        chance = float(np.prod(2 * ndtr(PRINTED / se) - 1))
        errors = ", ".join(f"{s:.4f}" for s in se)
        out.append(
            f"{title}: the thesis prints the truth to 0.001 kg. The best fit is up to "
            f"{np.abs(error).max():.4f} kg off and {gain:.2f} nat"
            f" better than the truth; with standard errors {errors} kg, four estimates "
            f"round to the truth with probability {chance:.0e}."
        )
    if (scale > 1e-4).any():
        out.append(
            f"{title}: the thesis prints scales of 1e-5; the best fit has "
            f"{scale.max():.2g} kg for {MASSES[int(scale.argmax())]}."
        )
    if "dropo, learned epsilon" in rows:
        learned = np.array(rows["dropo, learned epsilon"]["epsilon"])
        shown = (
            f"{learned.min():.3g} to {learned.max():.3g} over the 11 signals, "
            f"{learned.mean():.4g} on average"
        )
        out.append(
            f"{title}: epsilon learned from the data: {shown}; the noise was made with "
            f"{EPSILON['noisy']:.0e}."
        )
    return out
