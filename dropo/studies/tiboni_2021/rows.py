"""Rows of the studies' tables: estimates with their z, the thesis' own beneath, and errors over
many data sets.
"""

from typing import Any

import numpy as np

from dropo.core.services.tables import number
from dropo.studies.engine.study import Table
from dropo.studies.tiboni_2021.hopper_sets import MASSES, PUBLISHED_STEPS, THESIS

Rows = dict[str, dict[str, Any]]
"""What `hopper_fits.fitted` gives, by method."""

MEANS = ("mean [kg] (z)", *MASSES, "steps", "fewer", "s")
SPREADS = ("sd [kg] (z)", *MASSES)


def z_of(row: dict[str, Any], what: str) -> np.ndarray:
    """(4,) (estimate - drawn sample's) / standard error, of the "mean" or the "sd"; NaN where there
    is no standard error.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.subtract(row[what], row[f"drawn_{what}"]) / np.array(row[f"{what}_se"])


def means(title: str, rows: Rows, table: str | None, kind: str) -> Table:
    """Means with their z, and what they cost; "fewer" is how many times fewer steps than the
    published 2e9.
    """
    first = next(iter(rows.values()))
    lines = [("drawn sample", *(f"{v:.4f}" for v in first["drawn_mean"]), "-", "-", "-")]
    for method, row in rows.items():
        cost = (
            f"{row['steps']:,}",
            f"{PUBLISHED_STEPS / row['steps']:,.0f}",
            f"{row['seconds']:.1f}",
        )
        lines.append(
            (
                method,
                *(
                    _with_z(v, z, ".4f")
                    for v, z in zip(row["mean"], z_of(row, "mean"), strict=True)
                ),
                *cost,
            )
        )
        if (table, kind, method) in THESIS:
            lines.append(
                (
                    f"  thesis, {method}",
                    *(f"{v:.3f}" for v in THESIS[table, kind, method][0]),
                    "-",
                    "-",
                    "-",
                )
            )  # type: ignore[index]
    return Table(f"{title}: means", MEANS, tuple(lines))


def spreads(title: str, rows: Rows, table: str | None, kind: str) -> Table:
    """Standard deviations of the fitted laws with their z; the thesis prints the scale of a
    Gaussian cut at two of it.
    """
    first = next(iter(rows.values()))
    lines = [("drawn sample", *(number(v, 3) for v in first["drawn_sd"]))]
    for method, row in rows.items():
        lines.append(
            (
                method,
                *(_with_z(v, z, ".3g") for v, z in zip(row["sd"], z_of(row, "sd"), strict=True)),
            )
        )
        if (table, kind, method) in THESIS:
            lines.append(
                (
                    f"  thesis, {method} (scale)",
                    *(number(v, 3) for v in THESIS[table, kind, method][1]),
                )
            )  # type: ignore[index]
    return Table(f"{title}: spreads", SPREADS, tuple(lines))


def over_data_sets(title: str, found: dict[str, list[dict[str, Any]]]) -> Table:
    """For every method: the errors of its means and spreads against each data set's own drawn
    sample.

    average +- its standard error, root mean square, and root mean square of z.
    """
    lines = []
    for method, rows in found.items():
        for what in ("mean", "sd"):
            if not np.any([row[what] for row in rows]):  # a point has no spread
                continue
            errors = np.array(
                [np.subtract(row[what], row[f"drawn_{what}"]) for row in rows]
            )  # (data sets, 4)
            z = np.array([z_of(row, what) for row in rows])
            for i, mass in enumerate(MASSES):
                known = z[np.isfinite(z[:, i]), i]
                error = errors[:, i].std(ddof=1) / np.sqrt(len(rows)) if len(rows) > 1 else np.nan
                cells = (
                    f"{errors[:, i].mean():+.1e}",
                    number(error, 2),
                    number(_rms(errors[:, i]), 2),
                )
                lines.append(
                    (f"{method}, {what} {mass}", *cells, number(_rms(known), 2), str(len(known)))
                )
    count = len(next(iter(found.values())))
    header = ("error against the drawn sample [kg]", "average", "+-", "RMS", "RMS z", "with z")
    return Table(f"{title}: over {count} data sets", header, tuple(lines))


def costs(title: str, found: dict[str, list[dict[str, Any]]]) -> Table:
    """What each method took, over data sets: one thread each."""
    lines = []
    for method, rows in found.items():
        steps = [row["steps"] for row in rows]
        seconds = [row["seconds"] for row in rows]
        few = f"{PUBLISHED_STEPS / max(steps):,.0f}"
        lines.append(
            (
                method,
                f"{np.median(steps):,.0f}",
                f"{max(steps):,}",
                few,
                f"{np.median(seconds):.1f}",
                f"{max(seconds):.1f}",
            )
        )
    header = ("cost of a fit", "steps, median", "most", "fewer, least", "s, median", "most")
    return Table(f"{title}: cost", header, tuple(lines))


def likelihoods(title: str, distributions: dict[str, dict[str, float]], draws: int) -> Table:
    """Laws compared: the emulator's exact log-likelihood, and simulator and emulator at the same
    draws.
    """
    header = (
        "log-likelihood [nat]",
        "emulator, exact",
        f"simulator, {draws} draws",
        "emulator, same",
        "difference",
    )
    lines = [
        (
            name,
            *(f"{row[way]:,.1f}" for way in ("exact", "simulator", "emulator")),
            f"{row['simulator'] - row['emulator']:+.1f}",
        )
        for name, row in distributions.items()
    ]
    return Table(f"{title}: laws", header, tuple(lines))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _with_z(value: float, z: float, form: str) -> str:
    shown = "-" if not np.isfinite(z) else f"{z:+.1f}" if abs(z) < 100 else f"{z:+.0e}"
    return f"{value:{form}} ({shown})"
