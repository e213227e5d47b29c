"""Evaluations kept on disk, so that a run that was killed can be resumed.

Every part of a run is deterministic given its seed. A resumed run therefore evaluates the same
points in the same order, and reads those that the file holds; nothing else needs to be saved,
neither an optimizer's state nor a random generator's. Another processor rounds otherwise: points
that are the recorded ones but for that are taken for them. The file is a journal with an entry for
each batch; numbers are written so that they are read bit for bit.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.errors import InvalidInput
from dropo.core.services.files.journal import Journal, read_lines
from dropo.core.services.files.saved_files import refusing_faults
from dropo.core.services.validation import Array

LOG = "the evaluations of a run, one JSON line each"
"""What the file is, for messages."""

ROUNDING = 1e-8
"""How far points may be from the recorded ones, beside and as a fraction of their size."""
Answer = tuple[Array, dict[str, int]]
"""The values of a batch, and what it cost by kind, such as {"steps": 1000}."""


class EvaluationLog:
    """The evaluations of a run in their order; with a path, they are kept in a file.

    The file begins with the first batch, so a run that is refused before leaves none.

    Parameters
    ----------
    path : Path, optional
        The file; without it nothing is kept.
    header : dict, optional
        What the run is: problem, settings, seed, hashes.

    Raises
    ------
    BadFile
        If the file is no evaluation log, or of another run; the message names what differs.
    """

    def __init__(self, path: Path | None = None, header: dict[str, Any] | None = None):
        self.path = path
        self._next = 0
        self._journal = None if path is None else Journal(path, header or {}, LOG)
        self._known: list[Any] = [] if self._journal is None else self._journal.entries

    @property
    def replayed(self) -> int:
        """Number of batches that the file held when the run was resumed."""
        return len(self._known)

    def evaluate(self, points: Array, function: Callable[[Array], Answer]) -> Answer:
        """Evaluate a batch, or read its values if the file holds them.

        Parameters
        ----------
        points : (P, m) array
            Where.
        function : callable
            Points to values and costs.

        Returns
        -------
        answers : array
            The values, float64.
        counts : dict of str to int
            What the batch cost, by kind.

        Raises
        ------
        InvalidInput
            If the file holds another batch in this place.
        """
        if self._next < len(self._known):
            return self._replay(points)
        answers, counts = function(points)
        if self._journal is not None:
            values = np.asarray(answers).tolist()
            self._journal.append({"points": points.tolist(), "answers": values, "counts": counts})
        return np.asarray(answers, dtype=float), counts

    def _replay(self, points: Array) -> Answer:
        """The answer that the file holds for the next batch."""
        assert self.path is not None
        entry = self._known[self._next]
        self._next += 1
        with refusing_faults(self.path, LOG):
            recorded = np.asarray(entry["points"])
            alike = recorded.shape == np.shape(points)
            if not (alike and np.allclose(recorded, points, ROUNDING, ROUNDING, equal_nan=True)):
                sentence = (
                    f"batch {self._next} was asked for at other points, so another version "
                    "wrote it."
                )
                raise InvalidInput(f"{self.path}: {sentence} Use another --out.")
            return np.array(entry["answers"], dtype=float), dict(entry["counts"])


def read_log(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """Read an evaluation log without going on with its run.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    header : dict
        What the run is; empty where the first line was cut off.
    batches : list of dict
        Its points, answers and counts, in order.

    Raises
    ------
    BadFile
        If it is no evaluation log, or a newer version wrote it.
    """
    lines = read_lines(path, LOG)
    with refusing_faults(path, LOG):
        return (dict(lines[0]), lines[1:]) if lines else ({}, [])
