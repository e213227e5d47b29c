"""The page of a fit."""

from functools import partial

import numpy as np

from dropo import plots
from dropo.core.contracts.prior import Prior
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_parts import PosteriorDraws
from dropo.core.records.fits.fit_report import INTERVAL, span, z_scores
from dropo.core.services.tables import estimate
from dropo.plots.distribution import correlated_pairs
from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.page import (
    Cell,
    Section,
    figure,
    grid,
    notes,
    page,
    paragraph,
    percent,
    plain,
    table,
)
from dropo.report.svg import picture
from dropo.report.svg import rows as svg_rows

LEVEL = "Level, and alike for all walkers, where they have come to the posterior."
FEW = 4
"""Parameters of which all pairs are drawn in one corner plot ..."""
READABLE = 14
"""... and of which a matrix of correlations can be read."""
LEAST = 0.1
"""The smallest correlation that is drawn by itself."""
INSIDE = "Contours hold half and 90 % of the draws."
# [in] of a picture with a row for each parameter
ROW = 0.4
HEAD = 0.8
WIDE = (
    "The orange band is that of all parameters in the search intervals: what the data had to "
    "decide."
)
POSTERIORS = ("epopt", "npe")
SPREAD = (
    "The mean with its standard error and 95 % interval; sd is the spread of the parameter "
    "itself, from draw to draw."
)
KNOWN = (
    "The posterior of parameters that are the same in all data: sd is how well each is known, "
    "and no spread from draw to draw."
)
CHECKED = {
    True: "Nothing in the residuals speaks against the model.",
    False: "The residuals say that the model is wrong, so intervals are too narrow.",
    None: "Whether the model is right was not tested.",
}


def fit_page(result: Result) -> str:
    """Write the page of a fit.

    Parameters
    ----------
    result : Result
        With its fit.

    Returns
    -------
    str
        The HTML file's text.
    """
    fit = result.fit
    assert fit is not None
    sections = [
        parts.motion(result.predictions, result.media, WIDE),
        _parameters(fit, result.record.get("priors", {})),
        parts.errors(result.predictions),
        _remaining(fit, result),
        _search(fit, result),
        parts.made(result),
    ]
    shown = [section for section in sections if section is not None]
    return page(f"dropo fit · {fit.problem}", headline(fit, result), _cards(fit), shown)


def headline(fit: Fit, result: Result) -> str:
    """Say what was found, in a few sentences.

    Parameters
    ----------
    fit : Fit
        The fit.
    result : Result
        Its predictions.

    Returns
    -------
    str
    """
    count = len(fit.space)
    begun = (
        f"{count} parameter{'s' * (count > 1)} of {fit.problem}, found from "
        f"{fit.transitions:,} transitions"
    )
    found = result.predictions
    if found is not None and np.isfinite(found.before.by_horizon[-1]):
        steps = int(found.horizons[-1])
        ahead = f"{steps} step{'s' * (steps > 1)} ahead"
        before = percent(found.before.by_horizon[-1])
        after = percent(found.after.by_horizon[-1])
        begun += f": the error {ahead} goes from {before} to {after} of the motion's spread"
    checked = CHECKED[fit.trusted]
    ended = {
        Status.INTERRUPTED: " The search was interrupted: this is the best so far.",
        Status.OUT_OF_BUDGET: " The search ran out of budget.",
    }
    return f"{begun}. {checked}{ended.get(fit.status, '')}"


def _cards(fit: Fit) -> list[tuple[str, str, str]]:
    """The cards beneath the headline: name, value, and whether it is good or bad."""
    good = "good" if fit.status in (Status.CONVERGED, Status.DONE) else "bad"
    checked = []
    if fit.model_check is not None:
        passed = ("model check", "passed", "good")
        checked = [passed if fit.trusted else ("model check", "failed", "bad")]
    return [
        ("status", fit.status.value.replace("_", " "), good),
        *checked,
        ("method", fit.method, ""),
        ("transitions", f"{fit.transitions:,}", ""),
        ("nats per transition", plain(fit.log_likelihood / fit.transitions), ""),
        ("simulator steps", f"{fit.simulator_steps:,}", ""),
        ("time", f"{fit.wall_time_s:.1f} s", ""),
    ]


def _parameters(fit: Fit, priors: dict[str, Prior]) -> Section:
    """The table of parameters, and their distribution in the search intervals."""
    truth = fit.truth
    scores = z_scores(fit) if truth else np.zeros(0)
    intervals = fit.interval()
    header = [
        "parameter",
        "unit",
        "mean",
        "standard error",
        INTERVAL[fit.trusted],
        "sd",
        "searched from",
        "to",
    ]
    if priors:
        header.append("prior")
    if fit.priors is not None:
        header.append("share of the priors")
    if truth:
        header += ["truth", "z"]
    rows = []
    for i, p in enumerate(fit.space):
        row = [
            Cell(p.name),
            Cell(p.unit),
            Cell(estimate(fit.mean[i], fit.mean_se[i]), fit.mean[i]),
            _number(fit.mean_se[i], 2),
            Cell(span(*intervals[i]), fit.mean[i]),
            _number(fit.sd[i], 4),
            _number(p.low, 4),
            _number(p.high, 4),
        ]
        if priors:
            row.append(Cell(str(priors.get(p.name, "uniform"))))
        if fit.priors is not None:
            share = 100 * fit.priors.share[p.name]
            row.append(Cell(f"{share:.3g} %" if np.isfinite(share) else "-", share))
        if truth:
            true = truth[p.name]
            row += [Cell(estimate(true, fit.mean_se[i]), true), _number(scores[i], 2)]
        rows.append(row)
    values = "; ".join(
        f"{p.name} {plain(fit.mean[i])} {p.unit}, sd {plain(fit.sd[i], 2)}"
        for i, p in enumerate(fit.space)
    )
    svg = picture(
        partial(plots.parameters, fit, priors=priors),
        f"Bars: each parameter in its search interval. {values}.",
        size=svg_rows(len(fit.space), ROW, HEAD),
    )
    lead = KNOWN if fit.parameters_are_constant or fit.method in POSTERIORS else SPREAD
    caption = "Grey is what was searched, pale blue the distribution, the line the mean."
    shown = [figure(svg, "Where in the search interval", caption), *_joint(fit)]
    pictures = grid(*shown) + _pairs(fit)
    return Section("Parameters", lead, table(header, rows) + pictures)


def _number(value: float, digits: int) -> Cell:
    """A cell with a number."""
    return Cell(plain(value, digits), float(value))


def _joint(fit: Fit) -> list[str]:
    """All pairs of few parameters in one picture, and the correlations where they can be read."""
    count = len(fit.space)
    if count < 2 or not np.any(fit.sd > 0):
        return []
    shown = []
    if count <= FEW:
        strongest = _strongest(fit)
        text = f"Corner plot of {count} parameters. {strongest}"
        svg = picture(partial(plots.corner, fit), text, size=(4.4, 4.4), grid=count)
        shown = [figure(svg, "Joint distribution", f"{INSIDE} {strongest}{_orange(fit)}")]
    correlated = np.any(np.abs(fit.correlation - np.eye(count)) > 0)
    return [*shown, _matrix(fit)] if correlated and 2 < count <= READABLE else shown


def _pairs(fit: Fit) -> str:
    """Of many parameters a small picture for each of the pairs that are correlated most."""
    names = fit.space.names
    if len(names) <= FEW or not np.any(fit.sd > 0):
        return ""
    found = [one for one in correlated_pairs(fit) if abs(one[2]) >= LEAST]
    if not found:
        return paragraph(f"No two parameters have a correlation of {LEAST:g} or more.")
    shown = []
    for i, j, value in found:
        text = f"Contours of {names[i]} and {names[j]}, correlation {value:.2f}."
        svg = picture(partial(plots.pair, fit, i, j), text, size=(2.2, 2.1))
        shown.append(figure(svg, f"{value:+.2f}"))
    count = len(names) * (len(names) - 1) // 2
    listed = f"The strongest correlations, {len(shown)} of {count}. {INSIDE}{_orange(fit)}"
    body = "<h3>Which parameters the data tell only together</h3>"
    return body + paragraph(listed) + grid(*shown, small=True)


def _orange(fit: Fit) -> str:
    """What orange is, where it is there."""
    return " Orange: the truth." if fit.truth else ""


def _matrix(fit: Fit) -> str:
    """The matrix of correlations."""
    strongest = _strongest(fit)
    svg = picture(partial(plots.correlation, fit), f"Correlation matrix. {strongest}")
    return figure(svg, "Correlation", strongest)


def _strongest(fit: Fit) -> str:
    """The strongest correlation, in a sentence."""
    off = np.abs(fit.correlation - np.diag(np.diagonal(fit.correlation)))
    i, j = np.unravel_index(int(off.argmax()), off.shape)
    if off[i, j] == 0:
        return "Each parameter is drawn by itself: this family has no correlations."
    return (
        f"The strongest correlation is {fit.correlation[i, j]:.2f}, of "
        f"{fit.space[int(i)].name} and {fit.space[int(j)].name}."
    )


def _noise(fit: Fit, result: Result) -> list[str]:
    """How epsilon was found, and what it is beside the errors that are left."""
    shown = []
    if fit.noise_tuning is not None:
        text = f"The smallest epsilon whose error is acceptable is {fit.epsilon[0]:.3g}."
        svg = picture(partial(plots.tuning, fit), f"Error and variance over epsilon. {text}")
        shown.append(figure(svg, "Tuning of epsilon", text))
    found = result.predictions
    if found is not None and len(fit.epsilon) == len(found.names) and np.any(fit.epsilon > 0):
        overridden = result.record.get("settings", {}).get("epsilon") is not None
        known = result.record.get("epsilon") is not None and not overridden
        how = "stated by the problem" if known else "of the fit"
        noise = np.sqrt(np.where(fit.epsilon > 0, fit.epsilon, np.nan))
        worst = int(np.nanargmax(found.after.by_signal / noise))
        ratio = found.after.by_signal[worst] / np.sqrt(fit.epsilon[worst])
        text = (
            f"The error that is left is at most {ratio:.2g} times the noise {how}, in "
            f"{found.names[worst]}."
        )
        svg = picture(
            partial(plots.noise, fit, found),
            f"Noise and errors of each signal. {text}",
            size=svg_rows(len(found.names)),
        )
        shown.append(figure(svg, "Noise", text))
    return shown


def _search(fit: Fit, result: Result) -> Section:
    """The noise, and how the search went."""
    history = result.history
    shown = _noise(fit, result)
    diagnostics = ""
    # The log of several fits holds the evaluations of all.
    several = fit.noise_tuning is not None or fit.horizon_choice is not None
    if fit.posterior is not None:
        svg = picture(partial(plots.trace, fit), "Log density of the walkers by step.")
        shown.append(figure(svg, "The walkers", LEVEL))
        diagnostics = _posterior(fit.posterior)
    elif several:
        diagnostics = _horizons(fit)
    elif history is not None and history.means is not None and len(history.means) > 1:
        rounds = len(history.means)
        text = (
            "How far each mean was from where it ended, in shares of its search interval, "
            f"after each of {rounds} rounds."
        )
        svg = picture(partial(plots.moves, history.means, fit), text)
        shown.append(figure(svg, "The estimate, round by round", text))
    elif history is not None and np.isfinite(history.values).any():
        text = (
            f"{len(history.values)} evaluations, the highest log-likelihood "
            f"{np.nanmax(history.values):.6g}."
        )
        svg = picture(
            partial(plots.convergence, history.steps, history.values),
            f"Log-likelihood over simulator steps: {text}",
        )
        shown.append(figure(svg, "The search", text))
    return Section("Noise and search", fit.message, (grid(*shown) if shown else "") + diagnostics)


def _horizons(fit: Fit) -> str:
    """The table of the horizons that were tried, where one was chosen."""
    if fit.horizon_choice is None:
        return ""
    rows = [
        [
            _number(trial.horizon, 6),
            _number(trial.below_best, 4),
            _number(trial.paired_error, 3),
            Cell("chosen" if trial.chosen else ""),
        ]
        for trial in fit.horizon_choice.trials
    ]
    return table(["lambda", "nats below the best on data held out", "standard error", ""], rows)


def _posterior(draws: PosteriorDraws) -> str:
    """The table of the diagnostics of each unknown."""
    found = draws.diagnostics
    rows = [
        [
            Cell(name),
            _number(found.autocorrelation_time[name], 4),
            _number(found.split_r_hat[name], 4),
            _number(found.effective_sample_size[name], 4),
        ]
        for name in draws.unknowns
    ]
    header = ["unknown", "autocorrelation time", "split R-hat", "effective sample size"]
    return table(header, rows)


def _remaining(fit: Fit, result: Result) -> Section:
    """What speaks against the fit."""
    remarks = [*(fit.identifiability or ()), *fit.warnings]
    if fit.failed_simulations:
        remarks.append(f"{fit.failed_simulations:,} simulations did not reach their end.")
    if result.predictions is not None and parts.too_sure(result.predictions):
        remarks.append(parts.calibrated(result.predictions))
    if fit.model_check is None:
        remarks.append(CHECKED[None])
    nothing = "Nothing: the residuals look like noise, and the data tell every parameter."
    body = notes(remarks) if remarks else paragraph(nothing)
    return Section("What remains unexplained", "", body)
