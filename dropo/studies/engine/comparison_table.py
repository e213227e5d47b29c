"""Variants beside the first one on the same data sets: errors, costs and paired tests."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dropo.core.numerics.multiple_tests import holm
from dropo.core.services.tables import Table, number
from dropo.core.services.validation import Array
from dropo.studies.engine.paired import paired_p_value, smallest_p_value

Row = Mapping[str, Any]
"""What is kept of a fit: mean, mean_se, drawn_mean, log_likelihood, steps, evaluations, inner,
seconds; of one that failed: `failed`, a sentence."""
HEADER = (
    "same data for all",
    "steps",
    "evaluations",
    "inner",
    "s",
    "error [se]",
    "p of it",
    "RMS z",
    "log-lik. to the first",
    "p",
    "failed",
)


def error_of(row: Row, reference: Row) -> float:
    """The error of a fit's means against the truth, in standard errors of a reference.

    Parameters
    ----------
    row, reference : mapping
        Fits of the same data.

    Returns
    -------
    float
        The root mean square over the parameters that the reference has a standard error of; NaN
        where there is none, or no truth, infinite where the fit failed.
    """
    if "failed" in row:
        return float("inf")
    if "failed" in reference or row["drawn_mean"] is None:
        return float("nan")
    return rms(_ratio(np.subtract(row["mean"], row["drawn_mean"]), reference["mean_se"]))


def z_of(row: Row) -> float:
    """Compute the error of a fit in its own standard errors.

    Parameters
    ----------
    row : dict
        The fit, as a task gives it.

    Returns
    -------
    float
        Root mean square over the parameters; NaN of a fit that failed.
    """
    if "failed" in row:
        return float("nan")
    return error_of(row, row)


def comparison_table(
    title: str, rows: Mapping[str, Sequence[Row]], comparable: Mapping[str, bool]
) -> Table:
    """Errors, log-likelihoods and costs of variants, tested in pairs against the first.

    "error" is the root mean square over parameters and data sets of the means' errors in standard
    errors of the first variant, "z" that in its own. Costs are medians; "inner" counts evaluations
    of an emulator or a linearization. p-values are of Wilcoxon's signed ranks, and Holm's over all
    of the table.

    Parameters
    ----------
    title : str
        What the data are.
    rows : mapping of str to sequence of mapping
        Fits of each data set by variant, the reference first.
    comparable : mapping of str to bool
        Whether a variant's log-likelihood is on the scale of the first.

    Returns
    -------
    Table
    """
    reference, *others = rows
    first = rows[reference]
    errors = {}
    for label, own in rows.items():
        pairs = zip(own, first, strict=True)
        errors[label] = np.array([error_of(row, base) for row, base in pairs])
    gains = {label: _gains(rows[label], first) for label in others if comparable[label]}
    p_of_errors = [paired_p_value(errors[label], errors[reference]) for label in others]
    p_of_gains = [_p_of_gain(gains.get(label)) for label in others]
    adjusted = holm([*p_of_errors, *p_of_gains])
    lines = [(reference, *_costs(first), *_errors(errors[reference], first, None), "-", "-", "")]
    for i, label in enumerate(others):
        own = rows[label]
        gain = "-"
        if label in gains:
            gain = f"{np.nanmedian(gains[label]):+.3g}" if len(gains[label]) else "-"
        p_gain = number(adjusted[len(others) + i], 2)
        lines.append(
            (
                label,
                *_costs(own),
                *_errors(errors[label], own, adjusted[i]),
                gain,
                p_gain,
                _failures(own),
            )
        )
    return Table(title, HEADER, tuple(lines))


def note_on_tests(data_sets: int) -> str:
    """Say what paired tests of a number of data sets can show.

    Parameters
    ----------
    data_sets : int
        The number.

    Returns
    -------
    str
        Two sentences for beneath a table.
    """
    least = smallest_p_value(data_sets)
    return (
        f"p: Wilcoxon's signed ranks over {data_sets} data sets, Holm's over all tests of a table;"
        f" before Holm, no p below {least:.2g} is possible with so many. 'error' is in standard"
        " errors of the table's first row, 'inner' counts evaluations that simulate nothing."
    )


def _gains(rows: Sequence[Row], first: Sequence[Row]) -> Array:
    """Log-likelihoods above those of the first variant, where neither failed."""
    gains = []
    for row, base in zip(rows, first, strict=True):
        if "failed" not in row and "failed" not in base:
            gains.append(row["log_likelihood"] - base["log_likelihood"])
    return np.array(gains)


def _p_of_gain(gains: Array | None) -> float:
    """The p-value of gains; NaN where there are none."""
    if gains is None:
        return float("nan")
    return paired_p_value(gains, np.zeros(len(gains)))


def _costs(rows: Sequence[Row]) -> tuple[str, str, str, str]:
    """Medians of steps, evaluations, inner evaluations and seconds of the fits that succeeded."""
    done = [row for row in rows if "failed" not in row]
    if not done:
        return "-", "-", "-", "-"
    steps, evaluations, inner = (
        f"{np.median([row[name] for row in done]):,.0f}"
        for name in ("steps", "evaluations", "inner")
    )
    return steps, evaluations, inner, f"{np.median([row['seconds'] for row in done]):.1f}"


def _errors(errors: Array, rows: Sequence[Row], p_value: float | None) -> tuple[str, str, str]:
    """Root mean square error, its p-value, and the root mean square z."""
    z = np.array([z_of(row) for row in rows])
    shown = "-" if p_value is None else number(p_value, 2)
    return number(rms(errors[np.isfinite(errors)]), 3), shown, number(rms(z[np.isfinite(z)]), 3)


def _failures(rows: Sequence[Row]) -> str:
    """How many fits failed, if any did."""
    failed = sum("failed" in row for row in rows)
    return f"{failed} of {len(rows)}" if failed else ""


def _ratio(values: Array, units: Any) -> Array:
    """Values in units that are positive and finite; the others are left out."""
    sizes = np.array(units, dtype=float)
    known = np.isfinite(sizes) & (sizes > 0)
    return np.asarray(values[known] / sizes[known])


def rms(values: Array) -> float:
    """Compute a root mean square.

    Parameters
    ----------
    values : (n,) array
        Of any unit.

    Returns
    -------
    float
        In the same unit; NaN of no values.
    """
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
