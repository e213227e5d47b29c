"""Tables of the studies: estimates with their z, the thesis' own beneath, errors over data sets."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.studies.engine.comparison_table import comparison_table, rms
from dropo.studies.engine.study import Table
from dropo.studies.engine.variants import Variant
from dropo.studies.tiboni_2021.hopper_sets import MASSES, PUBLISHED_STEPS, THESIS

Rows = dict[str, dict[str, Any]]
"""What `hopper_fits.fitted` gives, by method."""

MEANS = ("mean [kg] (z)", *MASSES, "steps", "fewer", "s")
SPREADS = ("sd [kg] (z)", *MASSES)


def z_of(row: dict[str, Any], what: str) -> np.ndarray:
    """Errors against the drawn sample in standard errors.

    Parameters
    ----------
    row : dict
        What `hopper_fits.fitted` gives.
    what : str
        "mean" or "sd".

    Returns
    -------
    (4,) array
        (estimate - drawn sample's) / standard error; NaN where there is no standard error.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.subtract(row[what], row[f"drawn_{what}"]) / np.array(row[f"{what}_se"])


def means(title: str, rows: Rows, table: str, kind: str) -> Table:
    """Means with their z, and what they cost.

    "fewer" is how many times fewer steps than the published 2e9.

    Parameters
    ----------
    title : str
        What the data are.
    rows : dict
        Fits by method.
    table, kind : str
        The thesis' table and data, whose numbers stand beneath.

    Returns
    -------
    Table
        The drawn sample, then a row for each method, the thesis' own beneath it.
    """
    first = next(iter(rows.values()))
    lines = [("drawn sample", *(f"{v:.4f}" for v in first["drawn_mean"]), "-", "-", "-")]
    for method, row in rows.items():
        steps = f"{row['steps']:,}"
        fewer = f"{PUBLISHED_STEPS / row['steps']:,.0f}"
        cells = _with_z(row, "mean", ".4f")
        lines.append((method, *cells, steps, fewer, f"{row['seconds']:.1f}"))
        if (table, kind, method) in THESIS:
            printed, _ = THESIS[table, kind, method]
            lines.append((f"  thesis, {method}", *(f"{v:.3f}" for v in printed), "-", "-", "-"))
    return Table(f"{title}: means", MEANS, tuple(lines))


def spreads(title: str, rows: Rows, table: str, kind: str) -> Table:
    """Standard deviations of the fitted distributions with their z.

    The thesis prints the scale of a Gaussian cut at two of it.

    Parameters
    ----------
    title : str
        What the data are.
    rows : dict
        Fits by method.
    table, kind : str
        The thesis' table and data, whose numbers stand beneath.

    Returns
    -------
    Table
        The drawn sample, then a row for each method, the thesis' own beneath it.
    """
    first = next(iter(rows.values()))
    lines = [("drawn sample", *(number(v, 3) for v in first["drawn_sd"]))]
    for method, row in rows.items():
        lines.append((method, *_with_z(row, "sd", ".3g")))
        if (table, kind, method) in THESIS:
            _, printed = THESIS[table, kind, method]
            lines.append((f"  thesis, {method} (scale)", *(number(v, 3) for v in printed)))
    return Table(f"{title}: spreads", SPREADS, tuple(lines))


def over_data_sets(title: str, found: dict[str, list[dict[str, Any]]]) -> Table:
    """Errors of means and spreads against each data set's own drawn sample.

    They are the average +- its standard error, the root mean square, and that of z.

    Parameters
    ----------
    title : str
        What the data are.
    found : dict
        Fits of each data set by method.

    Returns
    -------
    Table
        A row for each mass, by method and by mean or standard deviation [kg].
    """
    lines = []
    for method, rows in found.items():
        for what in ("mean", "sd"):
            if not np.any([row[what] for row in rows]):  # a point has no spread
                continue
            errors = np.array([np.subtract(row[what], row[f"drawn_{what}"]) for row in rows])
            z = np.array([z_of(row, what) for row in rows])
            for i, mass in enumerate(MASSES):
                own = errors[:, i]
                standard_error = own.std(ddof=1) / np.sqrt(len(own)) if len(own) > 1 else np.nan
                known = z[np.isfinite(z[:, i]), i]
                lines.append(
                    (
                        f"{method}, {what} {mass}",
                        f"{own.mean():+.1e}",
                        number(standard_error, 2),
                        number(rms(own), 2),
                        number(rms(known), 2),
                        str(len(known)),
                    )
                )
    count = len(next(iter(found.values())))
    header = ("error against the drawn sample [kg]", "average", "+-", "RMS", "RMS z", "with z")
    return Table(f"{title}: over {count} data sets", header, tuple(lines))


def costs(title: str, found: dict[str, list[dict[str, Any]]]) -> Table:
    """What each method took over data sets, on one thread.

    Parameters
    ----------
    title : str
        What the data are.
    found : dict
        Fits of each data set by method.

    Returns
    -------
    Table
        Simulator steps and seconds, a row for each method.
    """
    lines = []
    for method, rows in found.items():
        steps = [row["steps"] for row in rows]
        seconds = [row["seconds"] for row in rows]
        lines.append(
            (
                method,
                f"{np.median(steps):,.0f}",
                f"{max(steps):,}",
                f"{PUBLISHED_STEPS / max(steps):,.0f}",
                f"{np.median(seconds):.1f}",
                f"{max(seconds):.1f}",
            )
        )
    header = ("cost of a fit", "steps, median", "most", "fewer, least", "s, median", "most")
    return Table(f"{title}: cost", header, tuple(lines))


def comparison_of(
    title: str, found: dict[str, list[dict[str, Any]]], variants: Sequence[Variant]
) -> list[Table]:
    """The variants beside DROPO's default on the same data sets; nothing where there are none.

    Parameters
    ----------
    title : str
        What the data are.
    found : dict
        Fits of each data set by method, the variants' by their labels.
    variants : sequence of Variant
        Methods with parts exchanged.

    Returns
    -------
    list of Table
        One table, or none.
    """
    if not variants:
        return []
    rows = {"dropo": found["dropo"]}
    comparable = {}
    for variant in variants:
        rows[variant.label] = found[variant.label]
        comparable[variant.label] = variant.shares_likelihood(Variant())
    return [comparison_table(f"{title}: parts exchanged", rows, comparable)]


def likelihoods(title: str, distributions: dict[str, dict[str, float]], draws: int) -> Table:
    """Distributions compared by their log-likelihoods.

    Parameters
    ----------
    title : str
        What the data are.
    distributions : dict
        What `hopper_fits.compared` gives: the emulator's exact log-likelihood, and those of
        simulator and emulator at the same draws.
    draws : int
        Number of these draws.

    Returns
    -------
    Table
        Log-likelihoods [nats], a row for each distribution.
    """
    header = (
        "log-likelihood [nat]",
        "emulator, exact",
        f"simulator, {draws} draws",
        "emulator, same",
        "difference",
    )
    lines = []
    for name, row in distributions.items():
        values = [f"{row[source]:,.1f}" for source in ("exact", "simulator", "emulator")]
        lines.append((name, *values, f"{row['simulator'] - row['emulator']:+.1f}"))
    return Table(f"{title}: laws", header, tuple(lines))


def _with_z(row: dict[str, Any], what: str, form: str) -> list[str]:
    """The estimates of the four masses, each with its z in brackets."""
    cells = []
    for value, z in zip(row[what], z_of(row, what), strict=True):
        if not np.isfinite(z):
            shown = "-"
        elif abs(z) < 100:
            shown = f"{z:+.1f}"
        else:
            shown = f"{z:+.0e}"
        cells.append(f"{value:{form}} ({shown})")
    return cells
