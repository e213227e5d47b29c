"""What a check finds: how bad, in which signal, where, and what to do about it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "information"]
LEVELS: tuple[Level, ...] = ("error", "warning", "information")
"""From the worst to the least."""


@dataclass(frozen=True)
class Finding:
    """One thing that looks odd in a log or in data.

    Attributes
    ----------
    level : "error", "warning" or "information"
        An error makes the data useless, a warning may, information is only reported.
    signal : str
        The signal; empty where it is none.
    sentence : str
        What was found, with how much and where.
    advice : str
        What to do about it.
    run : str or None
        The run of a log, where there are several.
    row : int or None
        The first place, counted from 0 in the log or the data.
    time : float or None
        The same in seconds of its own clock.
    """

    level: Level
    signal: str
    sentence: str
    advice: str = ""
    run: str | None = None
    row: int | None = None
    time: float | None = None

    def __str__(self) -> str:
        head = ": ".join(part for part in (self.level, self.run, self.signal) if part)
        return " ".join(part for part in (f"{head}: {self.sentence}", self.advice) if part)


def errors_first(findings: Iterable[Finding]) -> list[Finding]:
    """Sort findings by level, the worst first.

    Parameters
    ----------
    findings : iterable of Finding
        In any order.

    Returns
    -------
    list of Finding
        Those of the same level stay in their order.
    """
    return sorted(findings, key=lambda finding: LEVELS.index(finding.level))
