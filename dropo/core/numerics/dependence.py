"""The variance of a sum over rows that depend on each other."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.kept_rows import row_blocks
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class LongRunSettings:
    """How the covariance of a sum along time is estimated.

    Attributes
    ----------
    power : float
        Orders of autoregressions are at most the number of rows to this power (den Haan and Levin
        1997).
    largest : float
        The largest partial autocorrelation, and the largest sum of an autoregression's
        coefficients (Andrews and Monahan 1992).
    """

    power: float = 1 / 3
    largest: float = 0.97


SETTINGS = LongRunSettings()


@dataclass(frozen=True, eq=False)
class Units:
    """Independent units of R rows.

    Attributes
    ----------
    label : (R,) array of int
        The unit of each row: 0, 1, ...
    serial : bool
        Whether there are too few units to compare with each other, so that the dependence is
        estimated along time within each.
    order : (R,) array of int
        The rows by unit, then time.
    kind : str
        What a unit is, for messages.
    """

    label: NDArray[np.int64]
    serial: bool
    order: NDArray[np.int64]
    kind: str

    @property
    def count(self) -> int:
        """The number G of units."""
        return int(self.label.max()) + 1


def independent(rows: int) -> Units:
    """Make every row a unit of its own.

    Parameters
    ----------
    rows : int
        Number R of rows.

    Returns
    -------
    Units
        R units, whose sums are the rows themselves.
    """
    return Units(np.arange(rows), False, np.arange(rows), "rows")


def unit_sums(values: Array, units: Units) -> Array:
    """Sum the rows of each unit.

    Parameters
    ----------
    values : (R, m) array
        The rows.
    units : Units
        G units.

    Returns
    -------
    (G, m) array
    """
    sums = np.zeros((units.count, values.shape[1]))
    np.add.at(sums, units.label, values)
    return sums


def variance_of_sum(
    values: Array, units: Units, settings: LongRunSettings = SETTINGS
) -> tuple[Array, Array]:
    """Estimate the covariance of the sum over rows of mean 0.

    Parameters
    ----------
    values : (R, m) array
        The rows.
    units : Units
        Which of them depend on each other.
    settings : LongRunSettings
        How the covariance is estimated along time.

    Returns
    -------
    covariance : (m, m) array
        G / (G - 1) sum_g u_g u_g' over the sums u_g of G units; where these are too few, the
        long-run covariance along time.
    degrees : (m,) array
        Degrees of freedom of its diagonal, G - 1 over units.
    """
    if units.serial:
        return long_run(values[units.order], units.label[units.order], settings)
    sums = unit_sums(values, units)
    count = units.count
    return sums.T @ sums * count / max(count - 1, 1), np.full(values.shape[1], max(count - 1, 1.0))


def long_run(
    values: Array, series: NDArray[np.int64], settings: LongRunSettings = SETTINGS
) -> tuple[Array, Array]:
    """Estimate the covariance of the sum of serially dependent rows.

    Each column is taken for an autoregression of its own, whose order Akaike's criterion chooses.

    Parameters
    ----------
    values : (R, m) array
        The rows, in the order of time.
    series : (R,) array of int
        The series of each row; rows of different series are independent.
    settings : LongRunSettings
        How large autoregressions may be.

    Returns
    -------
    covariance : (m, m) array
        The long-run covariance: that of the innovations, each over 1 less its autoregression's
        coefficients.
    degrees : (m,) array
        Degrees of freedom of its diagonal, from the variances of the innovations' variance and of
        the coefficients' sum.

    References
    ----------
    den Haan and Levin, "A practitioner's guide to robust covariance matrix estimation", Handbook of
    Statistics 15 (1997), section 4 (VARHAC); Andrews and Monahan, Econometrica 60 (1992), 953.
    """
    rows, m = values.shape
    products, counts = _products_along(values, series, round(rows**settings.power))
    if len(products) < 2:
        return values.T @ values, np.full(m, max(rows - 1.0, 1.0))
    found = [
        _autoregression(one / counts, rows, settings.largest) if one[0] > 0 else _Autoregression()
        for one in products.T
    ]
    order = max(len(one.coefficients) for one in found)
    white = np.zeros((rows, m))
    after = _rows_after(series, order)
    for own in _blocks_of(after, m):
        for column, one in enumerate(found):
            white[own, column] = values[own, column]
            for lag, coefficient in enumerate(one.coefficients, start=1):
                white[own, column] -= coefficient * values[own - lag, column]
    together = white.T @ white
    size = np.sqrt(np.diagonal(together))
    size[size == 0] = 1.0
    wanted = np.sqrt([rows * one.long_run for one in found])
    relative = np.array([one.relative_variance for one in found])
    return together * np.outer(wanted / size, wanted / size), np.maximum(2 / relative, 1.0)


@dataclass(frozen=True, eq=False)
class _Autoregression:
    """Coefficients (k,), the variance of innovations, that of a row's share of the sum, and the
    relative variance of the latter's estimate.
    """

    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    innovation: float = 0.0
    long_run: float = 0.0
    relative_variance: float = 1.0


def _autoregression(covariances: Array, rows: int, largest: float) -> _Autoregression:
    """The autoregression of autocovariances (1 + most,), by the recursion of Levinson and Durbin.

    largest: partial autocorrelation, and sum of coefficients.
    """
    coefficients = np.zeros(0)
    innovation = float(covariances[0])
    best = coefficients, innovation
    least = rows * np.log(innovation)
    for order in range(1, len(covariances)):
        lagged = covariances[1:order][::-1]
        partial = float(covariances[order] - coefficients @ lagged) / innovation
        partial += (1 + 3 * partial) / rows if order == 1 else 0.0  # its bias (Kendall 1954)
        partial = float(np.clip(partial, -largest, largest))
        coefficients = np.append(coefficients - partial * coefficients[::-1], partial)
        innovation *= 1 - partial**2
        criterion = rows * np.log(innovation) + 2 * order
        if criterion < least:
            least = criterion
            best = coefficients, innovation
    coefficients, innovation = best
    rest = 1 - min(float(coefficients.sum()), largest)
    relative = 2 / rows
    order = len(coefficients)
    if order:
        lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
        told = np.linalg.pinv(covariances[lags], hermitian=True).sum()
        relative += 4 * innovation * max(float(told), 0.0) / (rest**2 * rows)
    return _Autoregression(coefficients, innovation, innovation / rest**2, relative)


def _products_along(
    values: Array, series: NDArray[np.int64], most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Sums (1 + k, m) of products of rows with those a lag before, and how many (1 + k,) there are.

    k: the largest lag up to `most` of which there are some.
    """
    m = values.shape[1]
    sums = []
    counts = []
    for lag in range(most + 1):
        later = _rows_after(series, lag)
        if len(later) < 2:
            break
        total = np.zeros(m)
        for own in _blocks_of(later, m):
            total += np.sum(values[own] * values[own - lag], axis=0)
        sums.append(total)
        counts.append(len(later))
    return np.array(sums), np.array(counts)


def _rows_after(series: NDArray[np.int64], lag: int) -> NDArray[np.int64]:
    """Rows that have so many before them in their series."""
    return np.flatnonzero(series[lag:] == series[: len(series) - lag]) + lag


def _blocks_of(rows: NDArray[np.int64], m: int) -> list[NDArray[np.int64]]:
    """Numbers of rows of m columns, in blocks."""
    return [rows[block] for block in row_blocks(len(rows), 32 * m)]
