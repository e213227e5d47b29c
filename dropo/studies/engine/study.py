"""What a study finds: tables to read, the same numbers for machines, remarks, and a picture.

A study is a function `study(work, seeds=None) -> Study`, in the catalogue under "studies". It gives
its tasks to `work.map(task, items)`, which spreads them over cores and keeps finished ones on disk;
`seeds` is how many data sets (or repetitions) it takes, None for its own choice.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dropo.core.services.tables import Report
from dropo.core.services.tables import Table as Table


@dataclass(frozen=True, repr=False)
class Study(Report):
    """A finished study.

    name: as in the catalogue; title: a line that says what was done, and how often; remarks:
    sentences that follow from the numbers; data: every number unrounded, by names (dicts, lists,
    numbers and strings; NaN becomes null); draw: draw(figure) on a matplotlib Figure, or None.
    """

    name: str
    title: str
    tables: tuple[Table, ...]
    remarks: tuple[str, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)
    draw: Callable[[Any], None] | None = None

    def parts(self) -> list[str | Table]:
        """The title, the tables and the remarks, with an empty line between."""
        remarks = ["", "\n".join(f"- {text}" for text in self.remarks)] if self.remarks else []
        return [self.title, *(part for table in self.tables for part in ("", table)), *remarks]

    def to_json(self) -> dict[str, Any]:
        """The study for machines: name, title, remarks and data."""
        from dropo._version import __version__

        return {
            "study": self.name,
            "version": __version__,
            "title": self.title,
            "remarks": list(self.remarks),
            "data": _plain(self.data),
        }


def _plain(value: Any) -> Any:
    """For JSON: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
