"""Scrambled Sobol points without scipy.stats, whose import takes longer than a small fit."""

import numpy as np

from dropo.core.services.validation import Array

BITS = 30
"""Binary digits of a coordinate."""
DIRECTIONS = (
    *((3, (1,)), (7, (1, 3)), (11, (1, 3, 1)), (13, (1, 1, 1)), (19, (1, 1, 3, 3))),
    *((25, (1, 3, 5, 13)), (37, (1, 1, 5, 5, 17)), (41, (1, 1, 5, 5, 5)), (47, (1, 1, 7, 11, 19))),
    *((55, (1, 1, 5, 1, 1)), (59, (1, 1, 1, 3, 11)), (61, (1, 3, 5, 5, 31))),
    *((67, (1, 3, 3, 9, 7, 49)), (91, (1, 1, 1, 15, 21, 21)), (97, (1, 3, 1, 13, 27, 49))),
    *((103, (1, 1, 1, 15, 7, 5)), (109, (1, 3, 1, 15, 13, 25)), (115, (1, 1, 5, 5, 19, 61))),
    *((131, (1, 3, 7, 11, 23, 15, 103)), (137, (1, 3, 7, 13, 13, 15, 69))),
    *((143, (1, 1, 3, 13, 7, 35, 63)), (145, (1, 3, 5, 9, 1, 25, 53))),
    *((157, (1, 3, 1, 13, 9, 35, 107)), (167, (1, 3, 1, 5, 27, 61, 31))),
    *((171, (1, 1, 5, 11, 19, 41, 61)), (185, (1, 3, 5, 3, 3, 13, 69))),
    *((191, (1, 1, 7, 13, 1, 19, 1)), (193, (1, 3, 7, 5, 13, 19, 59))),
    *((203, (1, 1, 3, 9, 25, 29, 41)), (211, (1, 3, 5, 13, 23, 1, 55))),
    *((213, (1, 3, 7, 3, 13, 59, 17)),),
)
"""Of every coordinate but the first its primitive polynomial, as binary digits, and the first
direction numbers (Joe, Kuo, SIAM Journal on Scientific Computing 30 (2008), set D(6))."""


def sobol_points(d: int, exponent: int, rng: np.random.Generator) -> Array:
    """Make a scrambled Sobol set.

    Parameters
    ----------
    d : int
        Coordinates.
    exponent : int
        There are 2^exponent points.
    rng : numpy.random.Generator
        Scrambles the digits and shifts the points.

    Returns
    -------
    (2^exponent, d) array
        In [0, 1), bit for bit those of `scipy.stats.qmc.Sobol(d, rng=rng)`, which is asked where
        there are more coordinates than direction numbers here.

    References
    ----------
    Bratley, Fox, "Algorithm 659", ACM Transactions on Mathematical Software 14 (1988), section 2.
    Matousek, "On the L2-discrepancy for anchored boxes", Journal of Complexity 14 (1998): the
    scrambling, by a lower triangular matrix of digits and a digital shift.
    """
    if d > len(DIRECTIONS) + 1:
        from scipy.stats import qmc

        return np.asarray(qmc.Sobol(d, rng=rng).random_base2(exponent), dtype=float)
    rng = rng.spawn(1)[0]
    powers = 2 ** np.arange(BITS, dtype=np.uint32)
    shift = np.dot(rng.integers(0, 2, (d, BITS), dtype=np.uint32), powers)
    scramble = np.tril(rng.integers(0, 2, (d, BITS, BITS), dtype=np.uint32))
    scramble[:, np.arange(BITS), np.arange(BITS)] = 1

    # Digits of the direction numbers, the first one first: (d, digits, numbers).
    directions = np.stack([_direction_numbers(i) for i in range(d)])
    digits = (directions[:, None, :] >> np.arange(BITS - 1, -1, -1)[:, None]) & 1
    digits = (scramble.astype(np.int64) @ digits) & 1
    scrambled = (digits * powers[::-1, None].astype(np.int64)).sum(axis=1)

    # Each point differs from the one before it in one direction, by the Gray code.
    number = np.arange(2**exponent)
    gray = number ^ (number >> 1)
    points = np.tile(shift.astype(np.int64), (len(number), 1))
    for k in range(exponent):
        points ^= ((gray >> k) & 1)[:, None] * scrambled[:, k]
    return np.asarray(points * (1.0 / 2**BITS), dtype=float)


def _direction_numbers(coordinate: int) -> np.ndarray:
    """The direction numbers (BITS,) of a coordinate, as fractions of 2^BITS."""
    if coordinate == 0:
        numbers = BITS * [1]
    else:
        polynomial, first = DIRECTIONS[coordinate - 1]
        numbers = list(first)
        degree = len(first)
        for j in range(degree, BITS):
            new = numbers[j - degree]
            for k in range(degree):
                if (polynomial >> (degree - 1 - k)) & 1:
                    new ^= numbers[j - k - 1] << (k + 1)
            numbers.append(new)
    return np.array(numbers, dtype=np.int64) << np.arange(BITS - 1, -1, -1)
