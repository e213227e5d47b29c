"""All methods on the hopper, DROPO's and the related ones: what each costs, how far off it is, and
what a policy under it is worth.
"""

from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.related_methods.fits import ONLINE, TRUTH, Size, fitted, item, returned
from dropo.studies.tiboni_2021.hopper_sets import MEAN, SPREAD

TABLES = {
    "6.1": "masses that do not vary",
    "6.2": "torso mass with sd 0.5 kg, another draw every 10 transitions",
}
FULL = Size()
HEADER = ("method", "simulator steps", "target transitions", "mean off [kg]", "sd off [kg]")
NOTES = (
    "'mean off' and 'sd off' are root mean squares over the four masses and the data sets, "
    "against the law that the masses are drawn from."
    " Steps and transitions are medians over the data sets; bayrn's steps are with the "
    "training inside.",
    "droid, least squares, epopt and npe look for masses that are the same in all data: "
    "their spreads say how well those are"
    " known, or how far a search had come, not how much they vary. simopt's spread is what "
    "its updates have left of the first one.",
    "simopt collects its data with the stored policy; bayrn trains one by a short search "
    "for every law that it tries, and its target"
    " transitions are those of the episodes in which it is judged. bayrn looks for a law "
    "that trains well, not for the masses.",
    "adr uses no data: it starts from the model's own masses, which here are the truth, "
    "and widens while the stored policy does not fall."
    " Uniform randomization is one random pair of bounds a data set.",
)


def related_methods(work: Work, seeds: int | None = None, *, size: Size = FULL) -> Study:
    """DROPO, SimOpt, BayRn, EPOpt's adaptation, neural posteriors, ADR and the classical methods on
    the hopper, each with its cost.
    """
    methods = [method for method in size.methods if size.updates or method != "bayrn"]
    count = seeds or size.seeds
    asked = [
        (table, method, seed) for table in TABLES for method in methods for seed in range(count)
    ]
    answers = work.map(
        fitted, [item(table, seed, size, method=method) for table, method, seed in asked]
    )
    found: dict[Any, dict[str, Any]] = dict(zip(asked, answers, strict=True))
    worth = _returns(work, found, size, count) if size.updates else {}
    tables = []
    data = {}
    for table, title in TABLES.items():
        rows = {
            method: summary([found[table, method, seed] for seed in range(count)], table)
            for method in methods
        }
        returns = {
            method: worth[table, method] for method in (*methods, TRUTH) if (table, method) in worth
        }
        tables.append(_table(f"{table}, noisy: {title}", rows, returns))
        data[table] = {
            "summary": rows,
            "returns": returns,
            "fits": {m: [found[table, m, seed] for seed in range(count)] for m in methods},
        }
    trained = (
        f"'return' is that of {size.episodes} episodes of {size.steps} steps on the "
        f"target, of a policy that {size.updates} updates of"
        " augmented random search find under the law: its mean over data sets, and the "
        "standard error."
        if size.updates
        else "No policies were trained, so returns and bayrn are left out."
    )
    return Study(
        "related-methods",
        f"All methods on the hopper; {count} data sets",
        tuple(tables),
        (*NOTES, trained),
        data,
    )


def _returns(
    work: Work, found: dict[Any, dict[str, Any]], size: Size, count: int
) -> dict[tuple[str, str], dict[str, float]]:
    """Mean return and its standard error under each method's laws, and under the machine's own, by
    table and method.
    """
    distributions: dict[Any, Any] = {key: [row["family"], row["phi"]] for key, row in found.items()}
    distributions |= {(table, TRUTH, seed): None for table in TABLES for seed in range(count)}
    answers = work.map(
        returned,
        [
            item(table, seed, size, distribution=given)
            for (table, _, seed), given in distributions.items()
        ],
    )
    returns: dict[tuple[str, str], list[list[float]]] = {}
    for (table, method, _), answer in zip(distributions, answers, strict=True):
        returns.setdefault((table, method), []).append(answer["returns"])
    return {key: over_data_sets(values) for key, values in returns.items()}


def over_data_sets(returns: list[list[float]]) -> dict[str, float]:
    """Mean and standard error of the policies' mean returns; of one policy, over its episodes."""
    values = np.array(returns).mean(axis=1) if len(returns) > 1 else np.array(returns[0])
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return {"mean": float(values.mean()), "error": float(error)}


def summary(rows: list[dict[str, Any]], table: str) -> dict[str, float]:
    """Errors and costs of one method over data sets."""
    off = {
        what: np.subtract([row[what] for row in rows], truth)
        for what, truth in (("mean", MEAN), ("sd", SPREAD[table]))
    }
    return {
        **{what: float(np.sqrt(np.mean(errors**2))) for what, errors in off.items()},
        **{
            what: float(np.median([row[what] for row in rows])) for what in ("steps", "transitions")
        },
    }


def _table(
    title: str, rows: dict[str, dict[str, float]], returns: dict[str, dict[str, float]]
) -> Table:
    worth = {
        method: f"{found['mean']:.0f} +- {number(found['error'], 2)}"
        for method, found in returns.items()
    }
    lines = [
        (
            f"{method} (online)" if method in ONLINE else method,
            f"{row['steps']:,.0f}",
            f"{row['transitions']:,.0f}",
            number(row["mean"], 2),
            number(row["sd"], 2),
            *([worth[method]] if worth else []),
        )
        for method, row in rows.items()
    ]
    if worth:
        lines.append((TRUTH, "-", "-", "0", "0", worth[TRUTH]))
    return Table(title, (*HEADER, *(["return"] if worth else [])), tuple(lines))
