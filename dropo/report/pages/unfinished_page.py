"""The page of a run that was interrupted before it wrote a result."""

from functools import partial

import numpy as np

from dropo import plots
from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.page import Section, figure, grid, page, paragraph
from dropo.report.svg import picture


def unfinished_page(result: Result) -> str:
    """Write the page of a run that was interrupted: how far it came.

    Parameters
    ----------
    result : Result
        With the history of its search.

    Returns
    -------
    str
        The HTML file's text.
    """
    history = result.history
    record = result.record
    assert history is not None
    best = np.nanmax(history.values) if np.isfinite(history.values).any() else None
    spent = f"{int(history.steps[-1]):,}" if len(history.steps) else "0"
    count = len(history.steps)
    headline = (
        f"This fit of {result.problem} was interrupted after {count:,} "
        f"evaluation{'s' * (count != 1)}. It has no result yet."
    )
    cards = [
        ("status", "interrupted", "bad"),
        ("method", str(record.get("method", "?")), ""),
        ("evaluations", f"{count:,}", ""),
        ("simulator steps", spent, ""),
        *([("highest log-likelihood", f"{best:.6g}", "")] if best is not None else []),
    ]
    body = paragraph(
        "The same command with the same --out goes on from here: nothing that was "
        "evaluated is evaluated again."
    )
    if best is not None:
        text = f"{count} evaluations, the highest log-likelihood {best:.6g}."
        svg = picture(
            partial(plots.convergence, history.steps, history.values),
            f"Log-likelihood over simulator steps: {text}",
        )
        body += grid(figure(svg, "The search so far", text))
    elif history.means is not None:
        now = ", ".join(
            f"{p['name']} {value:.4g} {p.get('unit', '')}".rstrip()
            for p, value in zip(record.get("parameters", []), history.means[-1], strict=False)
        )
        rounds = len(history.means)
        body += paragraph(
            f"{f'The last of {rounds} rounds' if rounds > 1 else 'The first round'} ended at {now}."
        )
    return page(
        f"dropo fit · {result.problem}",
        headline,
        cards,
        [Section("How far it came", "", body), parts.made(result)],
    )
