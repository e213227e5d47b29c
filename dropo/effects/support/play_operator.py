"""The play operator: an output that follows its input through a gap."""

import numpy as np

from dropo.core.services.validation import Array


def play(inputs: Array, width: float, start: float) -> Array:
    """Let an output follow the inputs no closer than half the width.

    Parameters
    ----------
    inputs : (T,) array
        The input v(t).
    width : float
        The width of the play, in the input's unit.
    start : float
        The output before the first input.

    Returns
    -------
    (T,) array
        The output w(t) = min(max(w(t-1), v(t) - width / 2), v(t) + width / 2): it rests while the
        input moves within the width, and is drawn along at either end.

    References
    ----------
    Krasnosel'skii and Pokrovskii 1989, Systems with Hysteresis, chapter 2.
    """
    half = width / 2
    output = start
    outputs = []
    for value in inputs.tolist():
        output = min(max(output, value - half), value + half)
        outputs.append(output)
    return np.array(outputs)
