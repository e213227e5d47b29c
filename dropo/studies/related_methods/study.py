"""All methods on the hopper, DROPO's and the related ones.

What each costs, how large its errors are, and what a policy trained under its fit returns.
"""

from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.related_methods.fits import (
    ONLINE,
    TRUTH,
    RelatedStudySize,
    fitted,
    item,
    returned,
)
from dropo.studies.tiboni_2021.hopper_sets import MEAN, SPREAD

TABLES = {
    "6.1": "masses that do not vary",
    "6.2": "torso mass with sd 0.5 kg, another draw every 10 transitions",
}
FULL = RelatedStudySize()
FitKey = tuple[str, str, int]
"""Table, method and seed of a fit."""
HEADER = ("method", "simulator steps", "target transitions", "mean off [kg]", "sd off [kg]")
NOTES = (
    "'mean off' and 'sd off' are root mean squares over the four masses and the data sets, "
    "against the law that the masses are drawn from. Steps and transitions are medians over the "
    "data sets; bayrn's steps are with the training inside.",
    "droid, least squares, epopt and npe look for masses that are the same in all data: "
    "their spreads say how well those are known, or how far a search had come, not how much they "
    "vary. simopt's spread is what its updates have left of the first one.",
    "simopt collects its data with the stored policy; bayrn trains one by a short search "
    "for every law that it tries, and its target transitions are those of the episodes in which it "
    "is evaluated. bayrn looks for a law that trains well, not for the masses.",
    "adr uses no data: it starts from the model's own masses, which here are the truth, "
    "and widens while the stored policy does not fall. Uniform randomization is one random pair of "
    "bounds a data set.",
)


def related_methods(
    work: Work, seeds: int | None = None, *, size: RelatedStudySize = FULL
) -> Study:
    """DROPO, the related and the classical methods on the hopper, each with its cost.

    The related ones are SimOpt, BayRn, EPOpt's adaptation, neural posteriors and ADR.

    Parameters
    ----------
    work : Work
        Runs the fits and trains the policies.
    seeds : int or None
        Number of data sets; None for that of `size`.
    size : RelatedStudySize
        How large the study is.

    Returns
    -------
    Study
        A table for each way in which masses vary.
    """
    methods = [method for method in size.methods if size.updates or method != "bayrn"]
    count = seeds or size.seeds
    keys = [
        (table, method, seed) for table in TABLES for method in methods for seed in range(count)
    ]
    items = [item(table, seed, size, method=method) for table, method, seed in keys]
    fits = dict(zip(keys, work.map(fitted, items), strict=True))
    all_returns = _returns(work, fits, size, count) if size.updates else {}
    tables = []
    data = {}
    for table, title in TABLES.items():
        by_method = {
            method: [fits[table, method, seed] for seed in range(count)] for method in methods
        }
        rows = {method: summary(found, table) for method, found in by_method.items()}
        returns = {}
        for method in (*methods, TRUTH):
            if (table, method) in all_returns:
                returns[method] = all_returns[table, method]
        tables.append(_table(f"{table}, noisy: {title}", rows, returns))
        data[table] = {"summary": rows, "returns": returns, "fits": by_method}
    return Study(
        "related-methods",
        f"All methods on the hopper; {count} data sets",
        tuple(tables),
        (*NOTES, _note_on_returns(size)),
        data,
    )


def _note_on_returns(size: RelatedStudySize) -> str:
    """What the column of returns holds."""
    if not size.updates:
        return "No policies were trained, so returns and bayrn are left out."
    return (
        f"'return' is that of {size.episodes} episodes of {size.steps} steps on the "
        f"target, of a policy that {size.updates} updates of augmented random search find under "
        "the law: its mean over data sets, and the standard error."
    )


def _returns(
    work: Work, fits: dict[FitKey, dict[str, Any]], size: RelatedStudySize, count: int
) -> dict[tuple[str, str], dict[str, float]]:
    """Mean return and its standard error by table and method, and under the truth."""
    distributions: dict[FitKey, Any] = {}
    for key, fit in fits.items():
        distributions[key] = [fit["family"], fit["phi"]]
    for table in TABLES:
        for seed in range(count):
            distributions[table, TRUTH, seed] = None
    items = [
        item(table, seed, size, distribution=given)
        for (table, _, seed), given in distributions.items()
    ]
    answers = work.map(returned, items)
    returns: dict[tuple[str, str], list[list[float]]] = {}
    for (table, method, _), answer in zip(distributions, answers, strict=True):
        returns.setdefault((table, method), []).append(answer["returns"])
    return {key: over_data_sets(values) for key, values in returns.items()}


def over_data_sets(returns: list[list[float]]) -> dict[str, float]:
    """Mean return, and its standard error over data sets.

    Parameters
    ----------
    returns : list of list of float
        Returns of each data set's policy, by episode.

    Returns
    -------
    dict
        mean; error: its standard error, of a single policy over its episodes (NaN for one).
    """
    values = np.array(returns).mean(axis=1) if len(returns) > 1 else np.array(returns[0])
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return {"mean": float(values.mean()), "error": float(error)}


def summary(rows: list[dict[str, Any]], table: str) -> dict[str, float]:
    """Errors and costs of one method over data sets.

    Parameters
    ----------
    rows : list of dict
        What `fitted` gives, for each data set.
    table : str
        Number of the table whose masses the data have.

    Returns
    -------
    dict
        mean, sd: root mean square errors over masses and data sets [kg]; steps, transitions:
        medians.
    """
    out = {}
    for name, truth in (("mean", MEAN), ("sd", SPREAD[table])):
        errors = np.subtract([row[name] for row in rows], truth)
        out[name] = float(np.sqrt(np.mean(errors**2)))
    for name in ("steps", "transitions"):
        out[name] = float(np.median([row[name] for row in rows]))
    return out


def _table(
    title: str, rows: dict[str, dict[str, float]], returns: dict[str, dict[str, float]]
) -> Table:
    """A row for each method, and one for the truth if there are returns."""
    cells = {
        method: (f"{found['mean']:.0f} +- {number(found['error'], 2)}",)
        for method, found in returns.items()
    }
    lines = []
    for method, row in rows.items():
        lines.append(
            (
                f"{method} (online)" if method in ONLINE else method,
                f"{row['steps']:,.0f}",
                f"{row['transitions']:,.0f}",
                number(row["mean"], 2),
                number(row["sd"], 2),
                *(cells[method] if cells else ()),
            )
        )
    if not returns:
        return Table(title, HEADER, tuple(lines))
    lines.append((TRUTH, "-", "-", "0", "0", *cells[TRUTH]))
    return Table(title, (*HEADER, "return"), tuple(lines))
