"""What a study finds: tables to read, the same numbers for programs, remarks, and a figure.

A study is a function `study(work, seeds=None) -> Study`, registered under "studies". It gives its
tasks to `work.map(task, items)`, which runs them on all cores and keeps finished ones on disk;
`seeds` is the number of data sets (or repetitions), None for the study's own number.
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

    Attributes
    ----------
    name : str
        Its name in the registry.
    title : str
        One line that says what was done, and how often.
    tables : tuple of Table
        The numbers, rounded for reading.
    remarks : tuple of str
        Sentences that follow from the numbers.
    data : dict
        Every number unrounded, by names: dicts, lists, numbers and strings; NaN becomes null.
    draw : callable or None
        `draw(figure)` draws on a matplotlib Figure.
    settings : dict
        What decides the study beside its name, as JSON has it.
    release : callable or None
        Is called once the study is written: what was kept of its tasks may go.
    """

    name: str
    title: str
    tables: tuple[Table, ...]
    remarks: tuple[str, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)
    draw: Callable[[Any], None] | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    release: Callable[[], None] | None = None

    def parts(self) -> list[str | Table]:
        """The title, the tables and the remarks, with an empty line between."""
        parts: list[str | Table] = [self.title]
        for table in self.tables:
            parts += ["", table]
        if self.remarks:
            parts += ["", "\n".join(f"- {text}" for text in self.remarks)]
        return parts

    def to_json(self) -> dict[str, Any]:
        """Give the study as JSON holds it.

        Returns
        -------
        dict
            Name, version, settings, title, remarks and data.
        """
        from dropo._version import __version__

        return {
            "study": self.name,
            "version": __version__,
            **({"settings": _plain(self.settings)} if self.settings else {}),
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
