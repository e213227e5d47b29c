"""What a comparison says: tables for each problem and over all of them, profiles, ranks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import friedmanchisquare, rankdata

from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.studies.engine.comparison_table import comparison_table, error_of, note_on_tests
from dropo.studies.engine.paired import (
    critical_difference,
    data_profile,
    expected_running_time,
    mean_ranks,
    performance_profile,
)
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.variants import Variant

NAME = "comparison"
COSTS = {
    "steps": "simulator steps",
    "evaluations": "evaluations, inner ones too",
    "seconds": "CPU seconds",
}
"""Costs by which variants are compared, and what they are called."""
RANKED = "evaluations"
"""The cost by which variants are ranked: it counts an optimizer's work on an emulator too."""
Fits = dict[str, dict[str, list[dict[str, Any]]]]
"""Problem -> variant -> what `compare.fitted` gives, by data set."""


@dataclass(frozen=True)
class SolvedWithin:
    """When a variant has solved a data set.

    Attributes
    ----------
    nats : float
        No fit by the same method and likelihood is further above its log-likelihood.
    standard_errors : float
        Where the truth is known, the means are this near to it, as a root mean square in standard
        errors of the first variant.
    """

    nats: float = 0.5
    standard_errors: float = 3.0


DEFAULT_TARGET = SolvedWithin()


def summarized(
    title: str,
    fits: Fits,
    variants: Sequence[Variant],
    units: Array,
    seeds: int,
    target: SolvedWithin,
) -> Study:
    """Make the tables, the figure and the sentences.

    Parameters
    ----------
    title : str
        What was compared on what.
    fits : dict
        All fits.
    variants : sequence of Variant
        The reference first.
    units : (n,) array
        Evaluations of a simplex gradient, d + 1, on each of the n data sets, problem by problem.
    seeds : int
        Data sets of each problem.
    target : SolvedWithin
        When a data set counts as solved.

    Returns
    -------
    Study
    """
    first = variants[0]
    labels = [variant.label for variant in variants]
    comparable = {variant.label: variant.shares_likelihood(first) for variant in variants}
    tables = []
    for problem, rows in fits.items():
        tables.append(comparison_table(f"{problem}, {seeds} data sets", rows, comparable))
    solved = _solved(fits, variants, target)
    spent = {name: _costs(fits, labels, name) for name in COSTS}
    to_solve = {name: np.where(solved, costs, np.inf) for name, costs in spent.items()}
    tables.append(_overall(labels, spent, solved))
    remarks = [note_on_tests(seeds), _note_on_target(target), *_ranks(to_solve[RANKED])]
    remarks += _failures(fits, labels)
    data = {
        "fits": fits,
        "solved": {label: solved[:, k] for k, label in enumerate(labels)},
        "target": vars(target),
    }
    draw = partial(_draw, labels=labels, costs=to_solve, units=units)
    return Study(NAME, title, tuple(tables), tuple(remarks), data, draw)


def _rows(fits: Fits, label: str) -> list[dict[str, Any]]:
    """A variant's fits of all data sets of all problems."""
    return [row for by_variant in fits.values() for row in by_variant[label]]


def _costs(fits: Fits, labels: Sequence[str], name: str) -> Array:
    """(n, k) costs on all data sets; of a fit that failed, the largest of that data set."""
    columns = []
    for label in labels:
        spent = []
        for row in _rows(fits, label):
            inner = row.get("inner", 0) if name == "evaluations" else 0
            spent.append(np.nan if "failed" in row else row[name] + inner)
        columns.append(spent)
    costs = np.array(columns, dtype=float).T
    highest = np.nanmax(np.nan_to_num(costs), axis=1, keepdims=True)
    return np.where(np.isnan(costs), highest, costs)


def _solved(fits: Fits, variants: Sequence[Variant], target: SolvedWithin) -> np.ndarray:
    """(n, k) whether a variant reached the target on a data set."""
    columns = []
    for variant in variants:
        alike = [other for other in variants if variant.shares_likelihood(other)]
        peers = [_rows(fits, other.label) for other in alike]
        own = _rows(fits, variant.label)
        reference = _rows(fits, variants[0].label)
        column = []
        for i, row in enumerate(own):
            best = max(peer[i].get("log_likelihood", -np.inf) for peer in peers)
            column.append(_reaches(row, reference[i], best, target))
        columns.append(column)
    return np.array(columns, dtype=bool).T


def _reaches(
    row: Mapping[str, Any], reference: Mapping[str, Any], best: float, to: SolvedWithin
) -> bool:
    """Whether a fit is near the best log-likelihood, and near the truth where that is known."""
    if "failed" in row or row["log_likelihood"] < best - to.nats:
        return False
    error = error_of(row, reference)
    return bool(np.isnan(error) or error <= to.standard_errors)


def _overall(labels: Sequence[str], costs: Mapping[str, Array], solved: np.ndarray) -> Table:
    """Shares solved, expected running times, and average ranks."""
    times = {name: expected_running_time(spent, solved) for name, spent in costs.items()}
    ranks = mean_ranks(np.where(solved, costs[RANKED], np.inf))
    lines = []
    for k, label in enumerate(labels):
        expected = [_time(times[name][k], name) for name in COSTS]
        share = f"{solved[:, k].sum()} of {len(solved)}"
        lines.append((label, share, *expected, f"{ranks[k]:.2f}"))
    header = (
        "all data sets",
        "solved",
        *(f"a success: {text}" for text in COSTS.values()),
        "average rank",
    )
    return Table("over all problems", header, tuple(lines))


def _time(expected: float, cost: str) -> str:
    """An expected running time; a dash where nothing was solved."""
    if not np.isfinite(expected):
        return "-"
    return f"{expected:.2f}" if cost == "seconds" else f"{expected:,.0f}"


def _note_on_target(target: SolvedWithin) -> str:
    """When a data set is solved, and what seconds are."""
    return (
        f"Solved: no fit by the same method and likelihood is more than {target.nats:g} nat above,"
        f" and, where the truth is known, the means are within {target.standard_errors:g} standard"
        " errors of it (root mean square over parameters). 'A success' is all that was spent over"
        " the number of successes. Seconds are of the fitting thread: what a library computes in a"
        " thread of its own is not in them."
    )


def _ranks(costs: Array) -> list[str]:
    """Whether variants differ in rank, and by how much they must."""
    data_sets, variants = costs.shape
    ranks = rankdata(costs, axis=1)
    if variants < 3 or data_sets < 2 or not np.ptp(ranks, axis=1).any():
        return []
    p_value = number(float(friedmanchisquare(*ranks.T).pvalue), 2)
    apart = critical_difference(variants, data_sets)
    return [
        f"Ranks are by {COSTS[RANKED]}, unsolved data sets last. Friedman's test that all are"
        f" alike: p = {p_value}; average ranks that are {apart:.2f} apart differ at the level of"
        " 5 % (Nemenyi; it takes all data sets for independent, also those of one problem)."
    ]


def _failures(fits: Fits, labels: Sequence[str]) -> list[str]:
    """Why fits failed, each reason once."""
    out = []
    for label in labels:
        reasons = {row["failed"] for row in _rows(fits, label) if "failed" in row}
        out += [f"{label} failed: {reason}" for reason in sorted(reasons)]
    return out


def _draw(figure: Any, labels: Sequence[str], costs: Mapping[str, Array], units: Array) -> None:
    """Performance profiles by steps and by evaluations, a data profile, and average ranks."""
    figure.set_size_inches(8, 6)
    panels = figure.subplots(2, 2)
    profiles = (
        ("performance profile, simulator steps", performance_profile(costs["steps"])),
        ("performance profile, evaluations", performance_profile(costs["evaluations"])),
        ("data profile, evaluations", data_profile(costs["evaluations"], units)),
    )
    for axes, (title, (places, shares)) in zip(panels.flat, profiles, strict=False):
        for k, label in enumerate(labels):
            axes.step(places, shares[:, k], where="post", label=label)
        is_ratio = title.startswith("performance")
        axes.set(
            title=title,
            xscale="log" if is_ratio else "symlog",
            xlabel="times the cheapest" if is_ratio else "simplex gradients (d + 1 evaluations)",
            ylabel="share solved",
            ylim=(-0.02, 1.02),
        )
    _draw_ranks(panels.flat[3], costs[RANKED])
    handles = panels.flat[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, fontsize=7)


def _draw_ranks(axes: Any, costs: Array) -> None:
    """Average ranks, and the least difference that means something as a bar from the best."""
    ranks = mean_ranks(costs)
    for k, rank in enumerate(ranks):
        axes.plot(rank, k, "o", color=f"C{k % 10}")
    if len(ranks) > 2:
        apart = critical_difference(len(ranks), len(costs))
        axes.axvspan(ranks.min(), ranks.min() + apart, alpha=0.15, color="gray", linewidth=0)
    axes.set(title="average ranks by evaluations", xlabel="rank; gray: not told from the best")
    axes.set(yticks=[], ylim=(len(ranks), -1))
