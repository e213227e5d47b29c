"""Results as plain text."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dropo.core.fit import Fit


def text_table(header: list[str], rows: list[list[str]]) -> str:
    """Columns padded with blanks; the first one to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    line = lambda row: "  ".join(cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True)))  # noqa: E731
    return "\n".join([line(header).rstrip(), "  ".join("-" * w for w in widths), *(line(row).rstrip() for row in rows)])


def number(value: float, digits: int = 5) -> str:
    """A number for a table; a dash where there is none."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def fit_table(fit: "Fit") -> str:
    """The fit as a table, with what it cost beneath."""
    header = ["parameter", "unit", "mean", "se", "scale", "sd"]
    rows = [
        [p.name, p.unit, number(fit.mean[i], 7), number(fit.mean_se[i], 2), number(fit.scale[i], 4), number(fit.sd[i], 4)]
        for i, p in enumerate(fit.space)
    ]
    per = fit.log_likelihood / fit.transitions
    lines = [
        f"{fit.problem}: {fit.method}, {fit.family.replace('_', ' ')}",
        text_table(header, rows),
        f"log-likelihood {fit.log_likelihood:.6g} ({per:.4g} a transition), mean squared error {fit.mse:.3g}, {fit.transitions} transitions",
        f"{fit.simulator_steps:,} simulator steps, {fit.objective_evaluations} evaluations, {fit.wall_time_s:.1f} s",
        f"{fit.status.value}: {fit.message}",
        *(f"warning: {text}" for text in fit.warnings),
    ]
    return "\n".join(lines)
