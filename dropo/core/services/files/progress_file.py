"""How far a run is, in a file of its folder that others may look at while it lives."""

import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from dropo.core.services.errors import BadFile
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.files.saved_files import read_json

PROGRESS = "progress.json"
"""There while a run computes, and after a run that was killed."""
LOCK = ".lock"
"""There while a run lives; it says which process that is."""
EVERY = 2.0
"""Seconds from one writing to the next, at least."""
KEPT = 8
"""Steps of the work that are kept, the last ones."""


@dataclass(frozen=True)
class Step:
    """What a run said of its work.

    Attributes
    ----------
    at : float
        When [s since 1970].
    fraction : float
        Of the work that was done then.
    text : str
        What was done.
    left : str
        About how long the rest takes; empty where that is not known.
    """

    at: float
    fraction: float
    text: str
    left: str = ""


class ProgressFile:
    """Writes the steps of a run now and then; a disk that is full ends no run.

    Parameters
    ----------
    path : Path or None
        The file; None writes nothing.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self._steps: list[Step] = []

    def __call__(self, fraction: float, text: str, left: str) -> None:
        """Keep a step, if the last one is some time ago."""
        now = time.time()
        if self.path is None or (self._steps and now - self._steps[-1].at < EVERY):
            return
        self._steps = [*self._steps[1 - KEPT :], Step(now, float(fraction), text, left)]
        with suppress(OSError):
            write_json(self.path, {"steps": [asdict(step) for step in self._steps]})

    def close(self) -> None:
        """Remove the file: the work has come to its end."""
        if self.path is not None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)


def read_progress(folder: Path) -> tuple[Step, ...]:
    """Read how far a run is.

    Parameters
    ----------
    folder : Path
        Of the run.

    Returns
    -------
    tuple of Step
        The last steps, in order; none where the run keeps no such file, or one that is broken.
    """
    path = folder / PROGRESS
    if not path.is_file():
        return ()
    with suppress(BadFile, TypeError, KeyError):
        return tuple(Step(**one) for one in read_json(path, "how far a run is")["steps"])
    return ()
