"""The best place for something whose size is found by least squares, by a grid that closes in."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropo.core.services.validation import Array


@dataclass(frozen=True)
class ClosingGridSettings:
    """How places are tried.

    Attributes
    ----------
    points : int
        Number of places along each axis.
    rounds : int
        Number of times that the grid closes in on the best place.
    closer : float
        Width of a grid in steps of the one before.
    same_gain : float
        Places whose gains differ by less than this fraction are equally good.
    seen : float
        Fraction of all responses below which that to a place counts as none.
    """

    points: int = 7
    rounds: int = 5
    closer: float = 2.4
    same_gain: float = 1e-6
    seen: float = 1e-9


SETTINGS = ClosingGridSettings()


@dataclass(frozen=True, eq=False)
class BestPlace:
    """A place, what explains most there, and how much that is.

    Attributes
    ----------
    gain : float
        The fall of the sum of squares.
    size : float
        Above 0.
    place : (c,) array
        In the units of the grid.
    """

    gain: float
    size: float
    place: Array


def best_place(
    numbers: Callable[[Array], Array],
    gram: Array,
    moments: Array,
    centre: Array,
    reach: Array,
    settings: ClosingGridSettings = SETTINGS,
) -> BestPlace | None:
    """Find the place and the size by which a response explains most.

    The response to a size s at a place p is s n(p)' C, linear in k numbers n(p). So the sum of
    squares that it leaves depends on the place through k columns alone, whatever they are.

    Parameters
    ----------
    numbers : callable
        The numbers (K, k) of one unit at K places (K, c).
    gram : (k, k) array
        C C', of the responses to the numbers.
    moments : (k,) array
        C y, with what is to be explained.
    centre : (c,) array
        Where the grid begins. Of places that are equally good, the one near it is taken.
    reach : (c,) array
        How far from 0 a place may be along each axis.
    settings : ClosingGridSettings
        How places are tried.

    Returns
    -------
    BestPlace or None
        None where no size above 0 explains anything.
    """
    best: BestPlace | None = None
    centre = np.array(centre, dtype=float)
    width = np.array(reach, dtype=float)
    unit = np.linspace(-1.0, 1.0, settings.points)
    axes = np.meshgrid(*[unit] * len(centre))
    grid = np.stack(axes, axis=-1).reshape(-1, len(centre))
    for _ in range(settings.rounds):
        places = np.clip(centre + width * grid, -reach, reach)
        n = numbers(places)
        along = n @ moments
        squares = np.einsum("ij,jk,ik->i", n, gram, n)
        seen = (along > 0) & (squares > settings.seen * np.trace(gram))
        gains = np.where(seen, along**2 / np.where(seen, squares, 1.0), 0.0)
        as_good = np.flatnonzero(gains >= (1 - settings.same_gain) * gains.max())
        k = int(as_good[np.argmin(np.linalg.norm(places[as_good] - centre, axis=1))])
        if gains[k] > (0.0 if best is None else best.gain):
            best = BestPlace(float(gains[k]), float(along[k] / squares[k]), places[k])
            centre = places[k]
        width = width * settings.closer / (settings.points - 1)
    return best
