"""The page of a run that has no result yet: at work, or interrupted."""

import time
from functools import partial

import numpy as np

from dropo import plots
from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.history import History
from dropo.report.page import Cell, Section, figure, grid, page, paragraph, table
from dropo.report.svg import picture

NAMES = {"fit": "fit", "diagnose": "diagnosis"}
GOES_ON = (
    "The same command with the same --out goes on from here: nothing that was evaluated is "
    "evaluated again."
)


def unfinished_page(result: Result) -> str:
    """Write the page of a run without a result: how far it is, or how far it came.

    Parameters
    ----------
    result : Result
        With the history of its search, where it keeps one.

    Returns
    -------
    str
        The HTML file's text.
    """
    record = result.record
    history = result.history
    command = str(record.get("command", "fit"))
    best = _best(history)
    cards = [("status", "at work" if result.at_work else "interrupted", _tone(result))]
    if result.steps:
        last = result.steps[-1]
        cards.append(("done", f"{last.fraction:.0%}", ""))
        if last.left and result.at_work:
            cards.append(("left", last.left.removesuffix(" left"), ""))
    cards.append(("method", str(record.get("method") or NAMES.get(command, command)), ""))
    if history is not None:
        count = len(history.steps)
        spent = f"{int(history.steps[-1]):,}" if count else "0"
        cards += [("evaluations", f"{count:,}", ""), ("simulator steps", spent, "")]
    if best is not None:
        cards.append(("highest log-likelihood", f"{best:.6g}", ""))
    body = "" if result.at_work else paragraph(GOES_ON)
    body += _steps(result)
    if history is not None:
        body += _searched(result, history, best)
    title = "How far it is" if result.at_work else "How far it came"
    return page(
        f"dropo {command} · {result.problem}",
        _headline(result, NAMES.get(command, command)),
        cards,
        [Section(title, "", body), parts.made(result)],
    )


def _headline(result: Result, name: str) -> str:
    """What the run is, and whether it goes on."""
    begun = f"This {name} of {result.problem}"
    if result.at_work:
        if not result.steps:
            return f"{begun} is at work. It has no result yet."
        last = result.steps[-1]
        text = last.text[:1].upper() + last.text[1:]
        return f"{begun} is at work, {last.fraction:.0%} is done. {text}."
    after = ""
    if result.history is not None:
        count = len(result.history.steps)
        after = f" after {count:,} evaluation{'s' * (count != 1)}"
    return f"{begun} was interrupted{after}. It has no result yet."


def _tone(result: Result) -> str:
    """Whether a status is good or bad."""
    return "good" if result.at_work else "bad"


def _best(history: History | None) -> float | None:
    """The highest log-likelihood so far; None where there is none to compare."""
    if history is None or not np.isfinite(history.values).any():
        return None
    return float(np.nanmax(history.values))


def _steps(result: Result) -> str:
    """The last steps of the work."""
    rows = [
        [
            Cell(time.strftime("%H:%M:%S", time.localtime(step.at)), step.at),
            Cell(f"{step.fraction:.0%}", step.fraction),
            Cell(step.text, words=True),
        ]
        for step in reversed(result.steps)
    ]
    return table(["at", "done", "what it did"], rows, told=True) if rows else ""


def _searched(result: Result, history: History, best: float | None) -> str:
    """How the search went so far."""
    if best is not None:
        text = f"{len(history.steps)} evaluations, the highest log-likelihood {best:.6g}."
        svg = picture(
            partial(plots.convergence, history.steps, history.values),
            f"Log-likelihood over simulator steps: {text}",
        )
        return grid(figure(svg, "The search so far", text))
    if history.means is None:
        return ""
    now = ", ".join(
        f"{p['name']} {value:.4g} {p.get('unit', '')}".rstrip()
        for p, value in zip(result.record.get("parameters", []), history.means[-1], strict=False)
    )
    rounds = len(history.means)
    which = f"The last of {rounds} rounds" if rounds > 1 else "The first round"
    return paragraph(f"{which} ended at {now}.")
