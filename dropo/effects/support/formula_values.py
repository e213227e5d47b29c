"""The value of a formula, and of the hidden states that it remembers.

What is here is written into `model.py` files, which run without this package.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array

Node = tuple[Any, ...]
"""A part of a formula: its kind, then what belongs to it (`dropo.effects.support.formula`).

("alike", term, names) is the sum of terms that differ by their constants alone: each constant of
one of them, and what it is called in all.
"""
Remembered = Callable[[Node, list[Any], dict[tuple[str, str], Array]], Array]
"""Gives the values of a hidden state, of its arguments and the variables."""
DIRECTION_WIDTH = 1e-2
"""The speed below which the sign of a speed fades out [rad/s, m/s]."""
TINY = 1e-12
"""Stands for a time constant or a distance of 0."""


@dataclass(frozen=True)
class Program:
    """A formula that can be evaluated.

    Attributes
    ----------
    root : tuple
        Its tree, in which terms that are alike stand together.
    constants : tuple of str
        The names of its q constants, in the order of their magnitudes.
    variables : tuple of (str, str)
        The variables that it takes, each with the joint that it belongs to; "" for the own one.
    hidden : int
        How many hidden states it remembers.
    """

    root: Node
    constants: tuple[str, ...]
    variables: tuple[tuple[str, str], ...]
    hidden: int


def evaluate(
    program: Program,
    values: dict[tuple[str, str], Array],
    magnitudes: Array,
    memory: dict[int, Any],
) -> Array:
    """Evaluate a formula in n states, and carry its hidden states on to them.

    Parameters
    ----------
    program : Program
        The formula.
    values : dict of (str, str) to (n,) array
        The variables that it takes; with hidden states also the time "t", and the own "q".
    magnitudes : (q,) array
        Its constants.
    memory : dict of int to tuple
        What each hidden state was in the states before these; changed in place.

    Returns
    -------
    (n,) array
        0 where the formula has no finite value.
    """
    return evaluate_with(program, values, magnitudes, partial(_hidden, memory=memory))


def evaluate_with(
    program: Program,
    values: dict[tuple[str, str], Array],
    magnitudes: Array,
    remembered: Remembered,
) -> Array:
    """Evaluate a formula in n states, whose hidden states a function gives.

    Parameters
    ----------
    program : Program
        The formula.
    values : dict of (str, str) to (n,) array
        As of `evaluate`.
    magnitudes : (q,) array
        Its constants.
    remembered : callable
        Of a hidden state, its arguments and the variables: its values (n,).

    Returns
    -------
    (n,) array
        0 where the formula has no finite value.
    """
    constants = dict(zip(program.constants, magnitudes, strict=True))
    with np.errstate(all="ignore"):
        found = np.asarray(_value(program.root, values, constants, remembered), dtype=float)
    count = len(next(iter(values.values()))) if values else 1
    found = np.broadcast_to(found, (count,))
    return np.where(np.isfinite(found), found, 0.0)


def _value(
    node: Node,
    values: dict[tuple[str, str], Array],
    constants: dict[str, Any],
    remembered: Remembered,
) -> Any:
    """The value of a part of a formula."""
    kind = node[0]
    if kind == "number":
        return node[1]
    if kind == "constant":
        return constants[node[1]]
    if kind == "variable":
        return values[node[1], node[2]]
    if kind == "alike":
        each = constants | {
            name: np.array([constants[one] for one in names])[:, None] for name, names in node[2]
        }
        return np.sum(_value(node[1], values, each, remembered), axis=0)
    inside = [_value(one, values, constants, remembered) for one in node[2]]
    if kind == "hidden":
        return remembered(node, inside, values)
    return _operation(node[1], inside)


def _operation(name: str, inside: list[Any]) -> Any:
    """The value of a function or an operator."""
    first = inside[0]
    if name == "-" and len(inside) == 1:
        return -first
    if name == "direction":
        return np.tanh(first / DIRECTION_WIDTH)
    if name == "dead":
        return np.sign(first) * np.maximum(np.abs(first) - np.abs(inside[1]), 0.0)
    one = {
        "abs": np.abs,
        "sign": np.sign,
        "tanh": np.tanh,
        "exp": np.exp,
        "sin": np.sin,
        "cos": np.cos,
        "sqrt": np.sqrt,
    }
    if name in one:
        return one[name](first)
    two = {
        "+": np.add,
        "-": np.subtract,
        "*": np.multiply,
        "/": np.true_divide,
        "**": np.power,
        "max": np.maximum,
        "min": np.minimum,
    }
    return two[name](first, np.asarray(inside[1], dtype=float))


def _hidden(
    node: Node, inside: list[Any], values: dict[tuple[str, str], Array], memory: dict[int, Any]
) -> Array:
    """A hidden state, carried on from the states before these.

    lag(x, T): T dz/dt = x - z. dahl(w): dz/dq = (1 - z sign(dq)) / w, between -1 and 1.
    """
    place = node[3]
    time = values["t", ""]
    now = _remembered_input(node, inside, values)
    if place in memory:
        state, before, then = memory[place]
        kept, added = _carried(node, inside, before, now, time - then)
        state = kept * state + added
    else:
        state = _at_first(node, now)
    memory[place] = (state, now, time)
    return state


def _remembered_input(node: Node, inside: list[Any], values: dict[tuple[str, str], Array]) -> Array:
    """What a hidden state follows: (n,) its argument, or the joint's position."""
    if node[1] == "lag":
        return np.broadcast_to(np.asarray(inside[0], dtype=float), values["t", ""].shape)
    return values["q", ""]


def _at_first(node: Node, now: Array) -> Array:
    """A hidden state where nothing came before: (n,) its input, or 0 of what slides."""
    return np.array(now) if node[1] == "lag" else np.zeros_like(now)


def _carried(
    node: Node, inside: list[Any], before: Array, now: Array, passed: Array
) -> tuple[Array, Array]:
    """(n,) by what a hidden state is multiplied from one input to the next, and what is added.

    Exact for an input that changes evenly in between.
    """
    if node[1] == "lag":
        times = np.maximum(passed, TINY) / max(abs(inside[1]), TINY)
        slope = (now - before) / times
        kept = np.exp(-times)
        return kept, now - slope + (slope - before) * kept
    moved = now - before
    kept = np.exp(-np.abs(moved) / max(abs(inside[0]), TINY))
    return kept, np.sign(moved) * (1 - kept)


def followed(
    node: Node,
    inside: list[Any],
    values: dict[tuple[str, str], Array],
    begins: NDArray[np.bool_],
) -> tuple[Array, Array, Array]:
    """Follow a hidden state along runs, as `evaluate` carries it from one state to the next.

    Parameters
    ----------
    node : tuple
        The hidden state's part of the formula.
    inside : list
        The values of its arguments, (n,) arrays or numbers.
    values : dict of (str, str) to (n,) array
        The variables, in the order of time.
    begins : (n,) array of bool
        Where a run begins.

    Returns
    -------
    tuple of three (n,) arrays
        What `evaluate` remembers: the state, its input, and the time.
    """
    time = values["t", ""]
    now = _remembered_input(node, inside, values)
    before = np.append(now[:1], now[:-1])
    kept, added = _carried(node, inside, before, now, np.diff(time, prepend=time[:1]))
    kept = np.where(begins, 0.0, kept)
    added = np.where(begins, _at_first(node, now), added)
    state = []
    last = 0.0
    for share, more in zip(kept.tolist(), added.tolist(), strict=True):
        last = share * last + more
        state.append(last)
    return np.array(state), now, time
