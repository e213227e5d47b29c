"""The page of a fit."""

import numpy as np

from dropo import plots
from dropo.core.contracts.prior import Prior
from dropo.core.records.fit import Fit, Status, span
from dropo.core.services.tables import estimate
from dropo.plots.distribution import MOST
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
    """The file's text."""
    fit = result.fit
    assert fit is not None
    sections = [
        parts.motion(result.predictions, WIDE),
        _parameters(fit, result.record.get("priors", {})),
        parts.errors(result.predictions),
        _remaining(fit, result),
        _search(fit, result),
        parts.made(result),
    ]
    return page(
        f"dropo fit · {fit.problem}",
        headline(fit, result),
        _cards(fit, result),
        [s for s in sections if s is not None],
    )


def headline(fit: Fit, result: Result) -> str:
    """The finding in a few sentences."""
    count = len(fit.space)
    begun = (
        f"{count} parameter{'s' * (count > 1)} of {fit.problem}, found from "
        f"{fit.transitions:,} transitions"
    )
    found = result.predictions
    if found is not None and np.isfinite(found.before.by_horizon[-1]):
        reach = len(found.before.by_horizon)
        ahead = f"{reach} step{'s' * (reach > 1)} ahead"
        before = percent(found.before.by_horizon[-1])
        after = percent(found.after.by_horizon[-1])
        begun += f": the error {ahead} goes from {before} to {after} of the motion's spread"
    told = CHECKED[fit.trusted if "model_check" in fit.details else None]
    ended = {
        Status.INTERRUPTED: " The search was interrupted: this is the best so far.",
        Status.OUT_OF_BUDGET: " The search ran out of budget.",
    }
    return f"{begun}. {told}{ended.get(fit.status, '')}"


def _cards(fit: Fit, result: Result) -> list[tuple[str, str, str]]:
    good = "good" if fit.status in (Status.CONVERGED, Status.DONE) else "bad"
    checked = [
        ("model check", "passed", "good") if fit.trusted else ("model check", "failed", "bad")
    ]
    return [
        ("status", fit.status.value.replace("_", " "), good),
        *(checked if "model_check" in fit.details else []),
        ("method", fit.method, ""),
        ("transitions", f"{fit.transitions:,}", ""),
        ("nats per transition", plain(fit.log_likelihood / fit.transitions), ""),
        ("simulator steps", f"{fit.simulator_steps:,}", ""),
        ("time", f"{fit.wall_time_s:.1f} s", ""),
    ]


def _parameters(fit: Fit, priors: dict[str, Prior]) -> Section:
    truth = fit.details.get("truth", {})
    intervals = fit.interval()
    header = [
        "parameter",
        "unit",
        "mean",
        "standard error",
        "95 % interval",
        "sd",
        "searched from",
        "to",
        *(["prior"] if priors else []),
    ]
    header += ["truth"] if truth else []
    rows = []
    for i, p in enumerate(fit.space):
        row = [
            Cell(p.name),
            Cell(p.unit),
            Cell(estimate(fit.mean[i], fit.mean_se[i]), fit.mean[i]),
            _number(fit.mean_se[i], 2),
            Cell(span(*intervals[i]), fit.mean[i]),
        ]
        row += [
            _number(fit.sd[i], 4),
            _number(p.low, 4),
            _number(p.high, 4),
            *([Cell(str(priors.get(p.name, "uniform")))] if priors else []),
        ]
        rows.append(row + ([_number(truth[p.name], 7)] if truth else []))
    said = "; ".join(
        f"{p.name} {plain(fit.mean[i])} {p.unit}, sd {plain(fit.sd[i], 2)}"
        for i, p in enumerate(fit.space)
    )
    svg = picture(
        lambda ax: plots.parameters(fit, ax, priors=priors),
        f"Bars: each parameter in its search interval. {said}.",
        size=svg_rows(len(fit.space), ROW, HEAD),
    )
    lead = (
        SPREAD
        if fit.details.get("over") != "parameters" and fit.method not in POSTERIORS
        else KNOWN
    )
    caption = "Grey is what was searched, pale blue the distribution, the line the mean."
    return Section(
        "Parameters",
        lead,
        table(header, rows)
        + grid(figure(svg, "Where in the search interval", caption), *_joint(fit)),
    )


def _number(value: float, digits: int) -> Cell:
    return Cell(plain(value, digits), float(value))


def _joint(fit: Fit) -> list[str]:
    """The joint distribution, and the correlations where the family has such."""
    if len(fit.space) < 2 or not np.any(fit.sd > 0):
        return []
    count = min(len(fit.space), MOST)
    strongest = _strongest(fit)
    shown = [
        figure(
            picture(
                lambda axes: plots.corner(fit, axes),
                f"Corner plot of {count} parameters. {strongest}",
                size=(4.4, 4.4),
                grid=count,
            ),
            "Joint distribution",
            f"Contours hold half and 90 % of the draws. {strongest}"
            + (" Orange: the truth." if fit.details.get("truth") else ""),
        )
    ]
    if len(fit.space) > 2 and np.any(np.abs(fit.correlation - np.eye(len(fit.space))) > 0):
        shown.append(
            figure(
                picture(lambda ax: plots.correlation(fit, ax), f"Correlation matrix. {strongest}"),
                "Correlation",
                strongest,
            )
        )
    return shown


def _strongest(fit: Fit) -> str:
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
    if fit.details.get("tuning"):
        text = f"The smallest epsilon whose error is acceptable is {fit.epsilon[0]:.3g}."
        shown.append(
            figure(
                picture(
                    lambda ax: plots.tuning(fit, ax), f"Error and variance over epsilon. {text}"
                ),
                "Tuning of epsilon",
                text,
            )
        )
    found = result.predictions
    if found is not None and len(fit.epsilon) == len(found.names) and np.any(fit.epsilon > 0):
        known = (
            result.record.get("epsilon") is not None
            and result.record.get("settings", {}).get("epsilon") is None
        )
        how = "stated by the problem" if known else "of the fit"
        worst = int(
            np.nanargmax(
                found.after.by_signal / np.sqrt(np.where(fit.epsilon > 0, fit.epsilon, np.nan))
            )
        )
        ratio = found.after.by_signal[worst] / np.sqrt(fit.epsilon[worst])
        text = (
            f"The error that is left is at most {ratio:.2g} times the noise {how}, in "
            f"{found.names[worst]}."
        )
        svg = picture(
            lambda ax: plots.noise(fit, found, ax),
            f"Noise and errors of each signal. {text}",
            size=svg_rows(len(found.names)),
        )
        shown.append(figure(svg, "Noise", text))
    return shown


def _search(fit: Fit, result: Result) -> Section:
    history = result.history
    shown = _noise(fit, result)
    diagnostics = ""
    several = bool(
        {"tuning", "lambda_choice"} & set(fit.details)
    )  # fits, of which the evaluation log holds all
    if "log_density" in fit.arrays:
        shown.append(
            figure(
                picture(lambda ax: plots.trace(fit, ax), "Log density of the walkers by step."),
                "The walkers",
                LEVEL,
            )
        )
        diagnostics = _posterior(fit)
    elif several:
        diagnostics = _lengths(fit)
    elif history is not None and history.means is not None and len(history.means) > 1:
        rounds = len(history.means)
        means = history.means
        text = (
            "How far each mean was from where it ended, in shares of its search interval, "
            f"after each of {rounds} rounds."
        )
        shown.append(
            figure(
                picture(lambda ax: plots.moves(means, fit, ax), text),
                "The estimate, round by round",
                text,
            )
        )
    elif history is not None and np.isfinite(history.values).any():
        text = (
            f"{len(history.values)} evaluations, the highest log-likelihood "
            f"{np.nanmax(history.values):.6g}."
        )
        svg = picture(
            lambda ax: plots.convergence(history.steps, history.values, ax),
            f"Log-likelihood over simulator steps: {text}",
        )
        shown.append(figure(svg, "The search", text))
    return Section("Noise and search", fit.message, (grid(*shown) if shown else "") + diagnostics)


def _lengths(fit: Fit) -> str:
    """The table of the lengths of segments that were tried, where one was chosen."""
    tried = fit.details.get("lambda_choice", [])
    rows = [
        [
            _number(row["lambda"], 6),
            _number(np.nan if row["below_best"] is None else row["below_best"], 4),
            _number(row["paired_error"], 3),
            Cell("chosen" if row["chosen"] else ""),
        ]
        for row in tried
    ]
    return (
        table(["lambda", "nats below the best on data held out", "standard error", ""], rows)
        if rows
        else ""
    )


def _posterior(fit: Fit) -> str:
    columns = fit.details.get("posterior", {})
    names = list(next(iter(columns.values()), {}))
    rows = [
        [
            Cell(name),
            *(_number(np.nan if v[name] is None else v[name], 4) for v in columns.values()),
        ]
        for name in names
    ]
    return table(
        ["unknown", *(column.replace("_", " ").replace("r hat", "R-hat") for column in columns)],
        rows,
    )


def _remaining(fit: Fit, result: Result) -> Section:
    told = [*fit.details.get("identifiability", ()), *fit.warnings]
    if fit.failed_simulations:
        told.append(f"{fit.failed_simulations:,} simulations did not reach their end.")
    if result.predictions is not None and parts.too_sure(result.predictions):
        told.append(parts.calibrated(result.predictions))
    if "model_check" not in fit.details:
        told.append(CHECKED[None])
    body = (
        notes(told)
        if told
        else paragraph("Nothing: the residuals look like noise, and the data tell every parameter.")
    )
    return Section("What remains unexplained", "", body)
