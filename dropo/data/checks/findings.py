"""What a check finds: how bad, in which signal, where, and what to do about it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "information"]
LEVELS: tuple[Level, ...] = ("error", "warning", "information")


@dataclass(frozen=True)
class Finding:
    """One thing that looks odd: an "error" makes the data useless, a "warning" may, "information"
    is only said.

    sentence: what was found, with how much and where; advice: what to do; run, row, time: the first
    place, where there is one (rows count from 0 in the log or the data; seconds in its own clock).
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
    """The same findings, the worst first."""
    return sorted(findings, key=lambda finding: LEVELS.index(finding.level))
