"""The play operator."""

import numpy as np

from dropo.core.services.validation import Array


def play(inputs: Array, width: float, start: float) -> Array:
    """(T,) an output that follows the inputs (T,) no closer than half the width (Krasnosel'skii and
    Pokrovskii 1989, ch. 2).

    It rests while the input moves within the width, and is drawn along at either end: w(t) =
    min(max(w(t-1), v(t) - width / 2), v(t) + width / 2), from w = start.
    """
    out = []
    now = start
    half = width / 2
    for wanted in inputs.tolist():
        now = min(max(now, wanted - half), wanted + half)
        out.append(now)
    return np.array(out)
