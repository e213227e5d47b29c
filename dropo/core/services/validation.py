"""Checks of arguments, whose messages name the argument, its owner, the rule and what was got."""

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.services.errors import BadArgument, UnknownName

SHOWN = 300
"""Characters of a value that a message shows."""

Array = NDArray[np.float64]
"""An array of float64."""


def require(ok: bool, name: str, rule: str, got: object, caller: str) -> None:
    """Refuse an argument that breaks a rule.

    Parameters
    ----------
    ok : bool
        Whether the rule holds.
    name : str
        The argument's name.
    rule : str
        What it must be, the end of "must be ...".
    got : object
        What it is.
    caller : str
        Whose argument it is.

    Raises
    ------
    BadArgument
        Unless `ok`.
    """
    if not ok:
        shown = repr(got)
        if len(shown) > SHOWN:
            shown = f"{shown[:SHOWN]}..."
        raise BadArgument(f"The {name!r} of {caller} must be {rule}. Got {shown} instead.")


def float_array(name: str, values: ArrayLike, shape: tuple[int | None, ...], caller: str) -> Array:
    """Copy an array into a read-only float64 one, checked.

    Parameters
    ----------
    name : str
        The argument's name.
    values : array_like
        The argument.
    shape : tuple of int or None
        The shape that it must have; None stands for any length.
    caller : str
        Whose argument it is.

    Returns
    -------
    array
        Read-only.

    Raises
    ------
    BadArgument
        If these are no numbers, or the array has another shape or is not finite.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadArgument(
            f"The {name!r} of {caller} must be numbers. Got {type(values).__name__}: {error}."
        ) from None
    check_shape(name, array, shape, caller)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        first = tuple(map(int, bad[0]))
        require(False, name, "finite", f"{array[first]} at {first}", caller)
    array.setflags(write=False)
    return array


def check_shape(name: str, array: Any, shape: tuple[int | None, ...], caller: str) -> None:
    """Refuse an array of another shape.

    Parameters
    ----------
    name : str
        The argument's name.
    array : array
        The argument, array or tensor.
    shape : tuple of int or None
        The shape that it must have; None stands for any length.
    caller : str
        Whose argument it is.

    Raises
    ------
    BadArgument
        If it has another shape.
    """
    fits = array.ndim == len(shape)
    if fits:
        lengths = zip(shape, array.shape, strict=True)
        fits = all(wanted in (None, length) for wanted, length in lengths)
    if fits:
        return
    wanted = ", ".join("any" if length is None else str(length) for length in shape)
    comma = "," if len(shape) == 1 else ""
    require(False, name, f"of shape ({wanted}{comma})", tuple(array.shape), caller)


def nearest(name: object, valid: Iterable[str]) -> str:
    """Suggest a valid name in place of an unknown one.

    Parameters
    ----------
    name : object
        The unknown name.
    valid : iterable of str
        The valid ones.

    Returns
    -------
    str
        A sentence with the nearest valid name, else with the first twelve.
    """
    options = sorted(filter(None, valid))
    near = _alike(name, options)
    if near:
        return f"Did you mean {near[0]!r}?"
    shown = ", ".join(options[:12]) + (", ..." if len(options) > 12 else "")
    return f"There is {shown}." if options else "There is none."


def _alike(name: object, options: Iterable[str]) -> list[str]:
    """The option that a name is nearly, if there is one."""
    return difflib.get_close_matches(str(name), filter(None, options), n=1, cutoff=0.5)


def known(kind: str, name: str, valid: Iterable[str], hint: str = "") -> str:
    """Return a name that must be one of the valid ones.

    Parameters
    ----------
    kind : str
        What it names, for the message.
    name : str
        The name.
    valid : iterable of str
        The valid names.
    hint : str
        A sentence that says what else to do where no valid name is near, else "".

    Returns
    -------
    str
        The name itself.

    Raises
    ------
    UnknownName
        If it is none of them; the message gives the nearest.
    """
    options = list(valid)
    if name not in options:
        said = f"No {kind} called {name!r}. {nearest(name, options)}"
        raise UnknownName(said if _alike(name, options) else f"{said} {hint}".rstrip())
    return name
