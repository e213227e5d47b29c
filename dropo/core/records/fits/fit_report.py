"""A fit as it is printed: a table of its parameters, and what it cost beneath."""

import numpy as np

from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.fit_parts import HeldOutErrors, PriorUse
from dropo.core.services.tables import MOST_DIGITS, Table, estimate, number
from dropo.core.services.validation import Array

INTERVAL = {
    True: "95 % interval",
    False: "(95 % if the model were right)",
    None: "95 % if the model is right",
}
"""What intervals are, by what a check of the model said; None: there was none."""

SHOWN_CORRELATIONS = 3
"""The strongest correlations, so many of which are printed."""


def fit_report(fit: Fit) -> list[str | Table]:
    """The sentences and the table that print a fit.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    list of str or Table
        In the order in which they are read.
    """
    per_transition = fit.log_likelihood / fit.transitions
    likelihood = f"log-likelihood {fit.log_likelihood:.6g} ({per_transition:.4g} a transition)"
    cost = f"{fit.simulator_steps:,} simulator steps, {fit.objective_evaluations} evaluations"
    return [
        f"{fit.problem}: {fit.method}, {fit.family.replace('_', ' ')}",
        _parameter_table(fit),
        *_correlation_sentence(fit),
        *([] if fit.priors is None else [prior_sentence(fit.priors)]),
        *(fit.identifiability or ()),
        f"{likelihood}, mean squared error {fit.mse:.3g}, {fit.transitions} transitions",
        *([] if fit.held_out is None else [_held_out_sentence(fit.held_out)]),
        f"{cost}, {fit.wall_time_s:.1f} s",
        *f"{fit.status.value}: {fit.message}".split("\n", 1),  # a method's own table stands alone
        *(f"warning: {text}" for text in fit.warnings),
    ]


def span(low: float, high: float) -> str:
    """An interval, with as many digits as its width deserves; a dash where there is none.

    Parameters
    ----------
    low, high : float
        Its ends.

    Returns
    -------
    str
    """
    if not (np.isfinite(low) and np.isfinite(high)):
        return "-"
    size = max(abs(low), abs(high), 1e-300)
    digits = 3
    if high > low:
        digits = int(np.clip(np.ceil(np.log10(size / (high - low))) + 2, 3, MOST_DIGITS))
    return f"{low:.{digits}g} .. {high:.{digits}g}"


def z_scores(fit: Fit) -> Array:
    """Count how many standard errors each mean is from the truth.

    Parameters
    ----------
    fit : Fit
        Of a problem whose truth is known.

    Returns
    -------
    (d,) array
        NaN without a standard error.
    """
    truth = np.array([fit.truth[p.name] for p in fit.space])
    return (fit.mean - truth) / np.where(fit.mean_se > 0, fit.mean_se, np.nan)


def _parameter_table(fit: Fit) -> Table:
    """A row for each parameter, with the true value where it is known."""
    header = ("parameter", "unit", "mean", "se", INTERVAL[fit.trusted], "scale", "sd")
    intervals = fit.interval()
    rows = [
        (
            p.name,
            p.unit,
            estimate(fit.mean[i], fit.mean_se[i]),
            number(fit.mean_se[i], 2),
            span(*intervals[i]),
            number(fit.scale[i], 4),
            number(fit.sd[i], 4),
        )
        for i, p in enumerate(fit.space)
    ]
    if not fit.truth:
        return Table("", header, tuple(rows))
    with_truth = [
        (*row, estimate(fit.truth[p.name], error), number(z, 2))
        for row, p, error, z in zip(rows, fit.space, fit.mean_se, z_scores(fit), strict=True)
    ]
    return Table("", (*header, "truth", "z"), tuple(with_truth))


def _correlation_sentence(fit: Fit) -> list[str]:
    """The strongest correlations with their intervals, where the family has such."""
    if fit.correlation_se is None or len(fit.mean) < 2:
        return []
    first, second = np.triu_indices(len(fit.mean), 1)
    intervals = fit.correlation_interval()
    known = np.isfinite(intervals[first, second]).all(axis=1)
    first, second = first[known], second[known]
    strongest = np.argsort(-np.abs(fit.correlation[first, second]))[:SHOWN_CORRELATIONS]
    names = fit.space.names
    shown = []
    for i, j in zip(first[strongest], second[strongest], strict=True):
        low, high = intervals[i, j]
        r = fit.correlation[i, j]
        shown.append(f"{names[i]}, {names[j]} {r:+.2f} ({low:+.2f} .. {high:+.2f})")
    return [f"correlations (95 % intervals): {'; '.join(shown)}"] if shown else []


def prior_sentence(found: PriorUse) -> str:
    """Say how much of what is known the priors give, by parameter.

    Parameters
    ----------
    found : PriorUse

    Returns
    -------
    str
    """
    shares = []
    for name, share in found.share.items():
        shown = "an unknown part" if np.isnan(share) else f"{100 * share:.3g} %"
        shares.append(f"{shown} of what is known of {name}")
    laws = ", ".join(f"{name} ~ {law}" for name, law in found.laws.items())
    return f"priors ({laws}) give {', '.join(shares)}"


def _held_out_sentence(found: HeldOutErrors) -> str:
    """The errors by unit, with the nominal model's before the arrow."""
    before = found.rmse_nominal or {}
    shown = []
    for unit, value in found.rmse.items():
        nominal = f"{number(before[unit], 3)} -> " if unit in before else ""
        shown.append(f"{nominal}{number(value, 3)} {unit}")
    after = f"after {found.steps} steps (RMS, {found.rows} rows)"
    return f"held-out error {after}: {', '.join(shown)}"
