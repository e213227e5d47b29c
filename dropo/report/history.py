"""How a search went, from the log of its evaluations."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.files.evaluation_log import LOG, read_log
from dropo.core.services.files.saved_files import refusing_faults
from dropo.core.services.validation import Array


@dataclass(frozen=True, eq=False)
class History:
    """How a search went.

    Attributes
    ----------
    steps : (n,) array
        Simulator steps up to each evaluation.
    values : (n,) array
        The log-likelihood there [nats]; NaN where it is not comparable, as in rounds on parts of
        the data.
    means : (r, d) array or None
        The distribution's mean after each outer iteration of a local likelihood; None without one.
    """

    steps: Array
    values: Array
    means: Array | None


def read_history(path: Path, parameters: int | None) -> tuple[dict[str, Any], History]:
    """Read an evaluation log; a half-written last line is left out.

    Parameters
    ----------
    path : Path
        The log.
    parameters : int or None
        d, how many parameters are fitted; None: as the header says.

    Returns
    -------
    header : dict
        What the run is.
    history : History
        How its search went.

    Raises
    ------
    BadFile
        If it is no evaluation log, or a newer version wrote it.
    """
    header, entries = read_log(path)
    with refusing_faults(path, LOG):
        d = len(header.get("parameters", ())) if parameters is None else parameters
        return header, _history(entries, d)


def _history(entries: list[dict[str, Any]], d: int) -> History:
    """The history of the batches behind the header."""
    steps: list[float] = []
    values: list[float] = []
    means: list[Array] = []
    spent = 0
    for entry in entries:
        points = np.asarray(entry["points"], dtype=float)
        answers = np.asarray(entry["answers"], dtype=float).reshape(len(points), -1)
        before = spent
        spent = spent + entry["counts"]["steps"]
        if len(points) == 1 and points.shape[1] == 2 * d and answers.shape[1] > 2 * d + 2:
            means.append(answers[0, 2 * d + 2 : 3 * d + 2])
        steps += np.linspace(before, spent, len(points) + 1)[1:].tolist()
        values += [np.nan] * len(points) if means else answers[:, 0].tolist()
    return History(np.array(steps), np.array(values), np.array(means) if means else None)
