"""What was evaluated so far, on disk: a run that was killed goes on by asking the same questions
and reading the answers.

Every part of a run is deterministic given its seed, so nothing else needs to be saved: neither an
optimizer's state nor a random generator's. The file holds one JSON line a batch; numbers are
written so that they come back bit for bit.
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


class EvaluationLog:
    """Evaluations by the order in which they were asked for; with `path`, kept in a file.

    header: what the run is (problem, settings, seed, hashes); a file of another run is refused. The
    file begins with the first batch, so that a run that is refused before it leaves none.
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
        """Batches that the file already held when the run was taken up."""
        return len(self._known)

    def evaluate(self, points: Array, function: Callable[[Array], Answer]) -> Answer:
        """function(points) -> (answers, counts); from the file where the same batch was asked for
        before.
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
            self._append(
                {
                    "points": points.tolist(),
                    "answers": np.asarray(answers).tolist(),
                    "counts": counts,
                }
            )
        return np.asarray(answers, dtype=float), counts

    def _append(self, entry: dict[str, Any]) -> None:
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
        raise BadFile(
            path, "", "the evaluations of a run, one JSON line each", "something else"
        ) from None
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
