"""Table 6.1: four masses that do not vary."""

from typing import Any

import numpy as np
from scipy.special import ndtr

from dropo.core.services.tables import number
from dropo.problems.hopper.model import BODIES
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.distribution_recovery import reduced
from dropo.studies.tiboni_2021.hopper_fits import AUTHORS, at_hand, fitted, item, judged
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, FULL, MASSES, MEAN, Size
from dropo.studies.tiboni_2021.rows import Rows, costs, means, over_data_sets, spreads

FAST = ("dropo", "least squares")
SLOW = ("droid",)
PRINTED = 5e-4  # [kg] half the last digit that the thesis prints
POINT = [1e-5] * 4  # [kg] the spread of a law that is a point

NOTES = (
    (
        "z is (estimate - truth) / standard error. Without noise nothing but rounding is left, "
        "in the errors and in the standard errors."
    ),
    (
        "log-lik. is the thesis' likelihood of every fitted law at the table's epsilon, from "
        "the same draws. Seconds are those of one thread."
    ),
    (
        "The scales of DROID, in the thesis and here, say how far the search had shrunk when "
        "it stopped, nothing about the parameters."
    ),
)


def table_6_1(
    work: Work, seeds: int | None = None, *, published: bool = False, size: Size = FULL
) -> Study:
    """Four masses that do not vary, from 1000 transitions, the authors' and our own, without and
    with noise (thesis, table 6.1).
    """
    count = seeds or size.seeds
    found = _fits(work, count, published, size)
    sets = sorted({key[:2] for key in found})
    starts = _from_random_starts(work, sets, size)
    worth = _judged(work, sets, found, size)
    tables: list[Table] = []
    data: dict[str, Any] = {}
    remarks = [*NOTES, *([reduced(size)] if published else [])]
    for table, kind in sets:
        title = f"{table if table == AUTHORS else 'our data'}, {kind}, epsilon {EPSILON[kind]:.0e}"
        rows: Rows = {
            method: row
            for (t, k, seed, method), row in found.items()
            if (t, k, seed) == (table, kind, 0)
        }
        tables += [
            means(title, rows, "6.1", kind),
            spreads(title, rows, "6.1", kind),
            _worth_table(title, worth[table, kind]),
        ]
        tables.append(_starts_table(title, starts[table, kind], rows["dropo"]))
        data[title] = {
            "first": rows,
            "likelihoods": worth[table, kind],
            "random_starts": starts[table, kind],
        }
        if table == "6.1":
            over = {
                method: [found[table, kind, seed, method] for seed in range(count)]
                for method in FAST
            }
            tables += [over_data_sets(title, over), costs(title, over)]
            data[title]["data_sets"] = over
        remarks += _remarks(title, rows, worth[table, kind])
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
    work: Work, count: int, published: bool, size: Size
) -> dict[tuple[str, str, int, str], dict[str, Any]]:
    slow = (*SLOW, *(("dropo, published",) if published else ()))
    asked = [
        ("6.1", kind, seed, m)
        for kind in EPSILON
        for seed in range(count)
        for m in ((*FAST, *slow) if seed == 0 else FAST)
    ]
    if at_hand():
        asked += [(AUTHORS, kind, 0, method) for kind in EPSILON for method in (*FAST, *slow)]
        asked += [
            (AUTHORS, "noisy", 0, method)
            for method in ("dropo, learned epsilon", "dropo, all data")
        ]
    answers = work.map(
        fitted,
        [item(table, kind, seed, size, method=method) for table, kind, seed, method in asked],
    )
    return dict(zip(asked, answers, strict=True))


def _from_random_starts(
    work: Work, sets: list[tuple[str, str]], size: Size
) -> dict[tuple[str, str], list[dict[str, Any]]]:
    asked = [(table, kind, start) for table, kind in sets for start in range(size.starts)]
    items = [
        item(table, kind, 0, size, method="dropo, random start", start=start)
        for table, kind, start in asked
    ]
    answers = work.map(fitted, items)
    return {
        (t, k): [
            row
            for (table, kind, _), row in zip(asked, answers, strict=True)
            if (table, kind) == (t, k)
        ]
        for t, k in sets
    }


def _judged(
    work: Work, sets: list[tuple[str, str]], found: dict[Any, Any], size: Size
) -> dict[tuple[str, str], dict[str, float]]:
    items = []
    for table, kind in sets:
        chosen = [m for m in (*FAST, *SLOW, "dropo, published") if (table, kind, 0, m) in found]
        distributions = {
            method: [found[table, kind, 0, method][what] for what in ("mean", "sd")]
            for method in chosen
        }
        items.append(
            item(
                table,
                kind,
                0,
                size,
                distributions={**distributions, "truth, scale 1e-5": [MEAN.tolist(), POINT]},
            )
        )
    return dict(zip(sets, work.map(judged, items), strict=True))


def _worth_table(title: str, worth: dict[str, float]) -> Table:
    best = max(worth.values())
    lines = tuple((name, f"{value:,.2f}", f"{value - best:+.2f}") for name, value in worth.items())
    return Table(f"{title}: likelihoods", ("log-lik. [nat]", "value", "to the best"), lines)


def _starts_table(title: str, rows: list[dict[str, Any]], middle: dict[str, Any]) -> Table:
    """How far apart fits from random starts end: of each other and of the truth."""
    errors = np.array([np.subtract(row["mean"], row["drawn_mean"]) for row in rows])
    apart = np.array([np.subtract(row["mean"], middle["mean"]) for row in rows])
    values = [row["log_likelihood"] for row in rows]
    lines = (
        ("worst error of a mean [kg]", *(number(v, 2) for v in np.abs(errors).max(axis=0))),
        ("farthest from the middle's fit [kg]", *(number(v, 2) for v in np.abs(apart).max(axis=0))),
        ("certified at the least scale", *(_share(rows, f"{part}_mass") for part in BODIES)),
        (
            "largest scale [kg]",
            *(number(v, 2) for v in np.max([row["scale"] for row in rows], axis=0)),
        ),
        ("log-likelihood, least and most", f"{min(values):,.3f}", f"{max(values):,.3f}", "", ""),
        (
            "steps, median and most",
            f"{np.median([row['steps'] for row in rows]):,.0f}",
            f"{max(row['steps'] for row in rows):,}",
            "",
            "",
        ),
        (
            "s, median and most",
            *(f"{f([row['seconds'] for row in rows]):.1f}" for f in (np.median, np.max)),
            "",
            "",
        ),
    )
    return Table(f"{title}: from {len(rows)} random starts", ("dropo", *MASSES), lines)


def _share(rows: list[dict[str, Any]], name: str) -> str:
    """In how many fits the likelihood itself says that the parameter does not vary."""
    return f"{sum(name in row['certified'] for row in rows)} of {len(rows)}"


def _remarks(title: str, rows: Rows, worth: dict[str, float]) -> list[str]:
    """Where these rows contradict the thesis', and what was learned of the noise."""
    row = rows["dropo"]
    out = []
    error = np.subtract(row["mean"], MEAN)
    se = np.array(row["mean_se"])
    scale = np.array(row["scale"])
    gain = worth["dropo"] - worth["truth, scale 1e-5"]
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
