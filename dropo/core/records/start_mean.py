"""Where a search begins: by name, at values that the caller gives, or at another fit's mean."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np

from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, float_array, known

Start: TypeAlias = (
    Literal["middle", "least-squares", "random"] | Mapping[str, float] | Sequence[float] | Fit
)
"""A name; values by parameter, of which those left out begin in the middle; all of them in order;
or a fit, whose mean it is.
"""


def checked_start(start: Any, names: Sequence[str]) -> Any:
    """Return a start as a setting: a name, or values that can be written down.

    Parameters
    ----------
    start : Start
        As the caller gives it.
    names : sequence of str
        The names that the method knows.

    Returns
    -------
    str, dict of str to float, or tuple of float

    Raises
    ------
    UnknownName
        If it is a name that the method does not know.
    BadArgument
        If a value is no finite number.
    """
    if isinstance(start, str):
        return known("start", start, names)
    if isinstance(start, Fit):
        return dict(zip(start.space.names, start.mean.tolist(), strict=True))
    values = list(start.values()) if isinstance(start, Mapping) else start
    numbers = tuple(float_array("start", values, (None,), "start").tolist())
    return dict(zip(start, numbers, strict=True)) if isinstance(start, Mapping) else numbers


def given_start(start: Any, space: ParameterSpace) -> Array | None:
    """Return the values where a search begins, if the setting gives them.

    Parameters
    ----------
    start : str, mapping or tuple
        As `checked_start` returns it.
    space : ParameterSpace
        The d parameters.

    Returns
    -------
    (d,) array or None
        In the parameters' units; None where the setting is a name.

    Raises
    ------
    UnknownName
        If a value is given for a parameter that does not exist.
    BadArgument
        If there are more or fewer values than parameters, or one is outside its bounds.
    """
    if isinstance(start, str):
        return None
    values = space.from_unit(np.full(len(space), 0.5))
    if isinstance(start, Mapping):
        for name, value in start.items():
            values[space.names.index(known("parameter to start at", name, space.names))] = value
    else:
        values = np.array(float_array("start", start, (len(space),), "start"))
    for parameter, value in zip(space, values.tolist(), strict=True):
        if not parameter.low <= value <= parameter.high:
            raise BadArgument(
                f"start of {parameter.name} must be within its bounds, {parameter.low:g} to"
                f" {parameter.high:g}, got {value:g}."
            )
    return values
