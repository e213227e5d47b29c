"""Evaluations kept on disk, so that a run that was killed can be resumed.

Every part of a run is deterministic given its seed. A resumed run therefore evaluates the same
points in the same order, and reads those that the file holds; nothing else needs to be saved,
neither an optimizer's state nor a random generator's. The file holds one JSON line for each batch;
numbers are written so that they are read bit for bit.
"""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.atomic_write import write_text
from dropo.core.services.errors import BadFile, InvalidInput
from dropo.core.services.validation import Array

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
        If the file is no evaluation log.
    InvalidInput
        If the file is of another run; the message names what differs.
    """

    def __init__(self, path: Path | None = None, header: dict[str, Any] | None = None):
        self.path = path
        self._next = 0
        self._known: list[dict[str, Any]] = []
        if path is None:
            return
        self._header = {"header": header or {}}
        if path.exists():
            self._known = _read(path, self._header)

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
            entry = self._known[self._next]
            self._next += 1
            if not np.array_equal(np.asarray(entry["points"]), points):
                sentence = (
                    f"batch {self._next} was asked for at other points, so another version "
                    "wrote it."
                )
                raise InvalidInput(f"{self.path}: {sentence} Use another --out.")
            return np.array(entry["answers"], dtype=float), entry["counts"]
        answers, counts = function(points)
        if self.path is not None:
            values = np.asarray(answers).tolist()
            self._append({"points": points.tolist(), "answers": values, "counts": counts})
        return np.asarray(answers, dtype=float), counts

    def _append(self, entry: dict[str, Any]) -> None:
        """Write one more line, behind the header."""
        assert self.path is not None
        new = not self.path.exists() or self.path.stat().st_size == 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write((json.dumps(self._header) + "\n" if new else "") + json.dumps(entry) + "\n")
            file.flush()
            os.fsync(file.fileno())


def _read(path: Path, header: dict[str, Any]) -> list[dict[str, Any]]:
    """The whole lines of an evaluation log; a half-written last line is cut off."""
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        write_text(path, whole)
    try:
        lines = [json.loads(line) for line in whole.splitlines()]
    except json.JSONDecodeError:
        expected = "the evaluations of a run, one JSON line each"
        raise BadFile(path, "", expected, "something else") from None
    if not lines:
        return []
    if lines[0] != json.loads(json.dumps(header)):
        ours = header["header"]
        theirs = lines[0].get("header", {})
        differ = sorted(key for key in {*ours, *theirs} if ours.get(key) != theirs.get(key))
        raise InvalidInput(
            f"{path}: holds another run; it differs in {', '.join(differ)}. Use another "
            "--out, or the settings of that run."
        )
    return lines[1:]
