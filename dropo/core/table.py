"""Results as plain text."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from dropo.core.fit import Fit


def text_table(header: list[str], rows: list[list[str]]) -> str:
    """Columns padded with blanks; the first one to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(row: list[str]) -> str:
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join([line(header), "  ".join("-" * width for width in widths), *(line(row) for row in rows)])


def number(value: float, digits: int = 5) -> str:
    """A number for a table; a dash where there is none."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def held_out_lines(found: dict[str, Any] | None) -> list[str]:
    """One line on the held-out errors, by unit, with the nominal model's before the arrow."""
    if found is None:
        return []
    before = found.get("rmse_nominal", {})
    shown = [
        (f"{number(_nan(before[unit]), 3)} -> " if unit in before else "") + f"{number(_nan(value), 3)} {unit}"
        for unit, value in found["rmse"].items()
    ]
    return [f"held-out error after {found['steps']} steps (RMS, {found['rows']} rows): {', '.join(shown)}"]


def _nan(value: float | None) -> float:
    return np.nan if value is None else value


def fit_table(fit: "Fit") -> str:
    """The fit as a table, with what it cost beneath."""
    truth = fit.details.get("truth", {})
    header = ["parameter", "unit", "mean", "se", "scale", "sd", *(["truth"] if truth else [])]
    rows = [
        [p.name, p.unit, number(fit.mean[i], 7), number(fit.mean_se[i], 2), number(fit.scale[i], 4), number(fit.sd[i], 4)]
        + ([number(truth[p.name], 7)] if truth else [])
        for i, p in enumerate(fit.space)
    ]
    likelihood = f"log-likelihood {fit.log_likelihood:.6g} ({fit.log_likelihood / fit.transitions:.4g} a transition)"
    lines = [
        f"{fit.problem}: {fit.method}, {fit.family.replace('_', ' ')}",
        text_table(header, rows),
        f"{likelihood}, mean squared error {fit.mse:.3g}, {fit.transitions} transitions",
        *held_out_lines(fit.details.get("held_out")),
        f"{fit.simulator_steps:,} simulator steps, {fit.objective_evaluations} evaluations, {fit.wall_time_s:.1f} s",
        f"{fit.status.value}: {fit.message}",
        *(f"warning: {text}" for text in fit.warnings),
    ]
    return "\n".join(lines)
