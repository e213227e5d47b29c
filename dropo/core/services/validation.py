"""Refusals that name the argument, its owner, the rule and what was got."""

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.services.errors import BadArgument, UnknownName

Array = NDArray[np.float64]


def require(ok: bool, name: str, rule: str, got: object, caller: str) -> None:
    """Raises BadArgument unless `ok`."""
    if not ok:
        raise BadArgument(f"The {name!r} of {caller} must be {rule}. Got {got!r} instead.")


def float_array(name: str, values: ArrayLike, shape: tuple[int | None, ...], caller: str) -> Array:
    """A read-only float64 copy of `values`, of the given shape (None: any length) and finite."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadArgument(
            f"The {name!r} of {caller} must be numbers. Got {type(values).__name__}: {error}."
        ) from None
    check_shape(name, array, shape, caller)
    bad = np.argwhere(~np.isfinite(array))
    require(
        len(bad) == 0,
        name,
        "finite",
        f"{array[tuple(bad[0])]} at {tuple(map(int, bad[0]))}" if len(bad) else "",
        caller,
    )
    array.setflags(write=False)
    return array


def check_shape(name: str, array: Any, shape: tuple[int | None, ...], caller: str) -> None:
    """Refuses an array of another shape; None in `shape` stands for any length."""
    fits = array.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, array.shape, strict=True)
    )
    wanted = (
        "("
        + ", ".join("any" if n is None else str(n) for n in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
    require(fits, name, f"of shape {wanted}", tuple(array.shape), caller)


def nearest(name: object, valid: Iterable[str]) -> str:
    """The end of a message about an unknown name: the nearest valid one, else the list."""
    options = sorted(filter(None, valid))
    near = difflib.get_close_matches(str(name), options, n=1, cutoff=0.5)
    if near:
        return f"Did you mean {near[0]!r}?"
    shown = ", ".join(options[:12]) + (", ..." if len(options) > 12 else "")
    return f"There is {shown}." if options else "There is none."


def known(kind: str, name: str, valid: Iterable[str]) -> str:
    """`name`, where it is one of the valid ones; else UnknownName with the nearest."""
    options = list(valid)
    if name not in options:
        raise UnknownName(f"No {kind} called {name!r}. {nearest(name, options)}")
    return name
