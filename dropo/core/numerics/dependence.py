"""The variance of a sum over rows that depend on each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.kept_rows import row_blocks
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class LongRunSettings:
    """How the covariance of a sum along time is estimated.

    Attributes
    ----------
    largest_autoregression : float
        Prewhitening takes out no larger first-order autoregression than this (Andrews and Monahan
        1992).
    """

    largest_autoregression: float = 0.97


SETTINGS = LongRunSettings()


@dataclass(frozen=True)
class ResidualSettings:
    """How far the autocovariances of residuals are followed.

    Attributes
    ----------
    power : float
        Orders of autoregressions are at most the number of rows to this power (den Haan and Levin
        1997).
    largest : float
        The largest partial autocorrelation.
    small : float
        Autocorrelations that are smaller count no more ...
    most : int
        ... nor those this many rows apart.
    """

    power: float = 1 / 3
    largest: float = 0.97
    small: float = 1e-3
    most: int = 500


RESIDUALS = ResidualSettings()


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

    Each column is prewhitened by its own first-order autoregression r, its residuals are smoothed
    by the quadratic spectral kernel with Andrews' automatic bandwidth S, and the autoregression is
    put back.

    Parameters
    ----------
    values : (R, m) array
        The rows, in the order of time.
    series : (R,) array of int
        The series of each row; rows of different series are independent.
    settings : LongRunSettings
        How much of their dependence is taken out beforehand.

    Returns
    -------
    covariance : (m, m) array
        The long-run covariance.
    degrees : (m,) array
        Degrees of freedom of its diagonal, 2 / (2 S / R + 4 (1 + r) / ((1 - r) R)), from the
        variances of a kernel estimate and of the autoregression.

    References
    ----------
    Andrews, Econometrica 59 (1991), 817, eq. 6.2 and 6.4; Andrews and Monahan, Econometrica 60
    (1992), 953.
    """
    rows, m = values.shape
    follows = _rows_after(series, 1)
    if len(follows) < 2:
        return values.T @ values, np.full(m, max(rows - 1.0, 1.0))
    largest = settings.largest_autoregression
    rho = np.clip(_autoregression(values, follows), -largest, largest)
    # The first row of a series has no row before it: it is scaled to the same variance.
    white = values.copy()
    for own in _blocks_of(follows, m):
        white[own] -= rho * values[own - 1]
    first = np.setdiff1d(np.arange(rows), follows)
    white[first] *= np.sqrt(1 - rho**2)
    width = _bandwidth(white, follows, rows, largest)
    smooth = white.T @ white
    for lag in range(1, min(int(np.ceil(6 * width)), rows - 1) + 1):
        later = _rows_after(series, lag)
        product = np.zeros((m, m))
        for own in _blocks_of(later, m):
            product += white[own].T @ white[own - lag]
        smooth += _quadratic_spectral(lag / width) * (product + product.T)
    recolour = 1 / (1 - rho)
    relative = 2 * width / rows + 4 * (1 + rho) / ((1 - rho) * rows)
    return smooth * np.outer(recolour, recolour), np.maximum(2 / relative, 1.0)


def _autoregression(values: Array, follows: NDArray[np.int64]) -> Array:
    """First-order coefficients (m,), corrected for their bias -(1 + 3 r) / R (Kendall 1954)."""
    products, size = _lag_one(values, follows)
    rho = products / np.where(size > 0, size, 1.0)
    return rho + (1 + 3 * rho) / len(follows)


def _lag_one(values: Array, follows: NDArray[np.int64]) -> tuple[Array, Array]:
    """Sums (m,) of the products of rows with the row before them, and of these rows' squares."""
    m = values.shape[1]
    products = np.zeros(m)
    squares = np.zeros(m)
    for own in _blocks_of(follows, m):
        before = values[own - 1]
        products += np.sum(values[own] * before, axis=0)
        squares += np.sum(before**2, axis=0)
    return products, squares


def _rows_after(series: NDArray[np.int64], lag: int) -> NDArray[np.int64]:
    """Rows that have so many before them in their series."""
    return np.flatnonzero(series[lag:] == series[: len(series) - lag]) + lag


def _blocks_of(rows: NDArray[np.int64], m: int) -> list[NDArray[np.int64]]:
    """Numbers of rows of m columns, in blocks."""
    return [rows[block] for block in row_blocks(len(rows), 32 * m)]


def _bandwidth(white: Array, follows: NDArray[np.int64], rows: int, largest: float) -> float:
    """Andrews' plug-in bandwidth 1.3221 (alpha R)^(1/5), alpha from limited autoregressions."""
    products, size = _lag_one(white, follows)
    good = size > 0
    if not good.any():
        return 1.0
    rho = np.clip(products[good] / size[good], -largest, largest)
    return max(1.0, 1.3221 * float(np.mean(4 * rho**2 / (1 - rho) ** 4) * rows) ** 0.2)


def _quadratic_spectral(x: float) -> float:
    """The quadratic spectral kernel (Andrews 1991, eq. 2.7)."""
    z = 6 * np.pi * x / 5
    return float(25 / (12 * np.pi**2 * x**2) * (np.sin(z) / z - np.cos(z)))


def variance_by_residuals(
    jacobian: Array,
    residuals: Array,
    weights: Array,
    units: Units,
    settings: ResidualSettings = RESIDUALS,
) -> Array:
    """Estimate the covariance of the sum over rows of J' W r, from how residuals r go on in time.

    The autocovariances of each signal's residuals, as of an autoregression whose order Schwarz's
    criterion chooses, times the products of Jacobians that are so far apart. These are known: so it
    holds whatever their signs do, and varies less than what the sums' own rows say. It takes
    residuals for independent of the Jacobians, and those of other signals for independent.

    Parameters
    ----------
    jacobian : (R, p, d) array
        J of each row.
    residuals : (R, p) array
    weights : (p,) array
        The diagonal of W.
    units : Units
        Rows of different units are independent.
    settings : ResidualSettings
        How far autocovariances are followed.

    Returns
    -------
    (d, d) array

    References
    ----------
    den Haan and Levin, "A practitioner's guide to robust covariance matrix estimation", Handbook of
    Statistics 15 (1997), section 4: autoregressions, here of residuals.
    """
    series = units.label[units.order]
    _, p, d = jacobian.shape
    longest = int(np.bincount(series).max())
    total = np.zeros((d, d))
    for signal in range(p):
        along = residuals[units.order, signal]
        covariances = _autocovariances(along, series, longest, settings)
        for lag, size in enumerate(weights[signal] ** 2 * covariances):
            later = _rows_after(series, lag)
            product = np.zeros((d, d))
            for own in _blocks_of(later, d):
                now = jacobian[units.order[own], signal]
                product += now.T @ jacobian[units.order[own - lag], signal]
            total += size * (product + product.T) / (1 + (lag == 0))
    return total


def _autocovariances(
    values: Array, series: NDArray[np.int64], longest: int, settings: ResidualSettings
) -> Array:
    """(k,) autocovariances of an autoregression, as far as they are not small."""
    rows = len(values)
    products = [float(values @ values) / rows]
    for lag in range(1, min(round(rows**settings.power), longest - 1) + 1):
        later = _rows_after(series, lag)
        products.append(float(values[later] @ values[later - lag]) / rows)
    if not products[0] > 0:
        return np.zeros(1)
    coefficients = np.zeros(0)
    innovation = products[0]
    best = coefficients
    least = rows * np.log(innovation)
    for order in range(1, len(products)):
        lagged = np.array(products[1:order][::-1])
        partial = (products[order] - float(coefficients @ lagged)) / innovation
        partial += (1 + 3 * partial) / rows if order == 1 else 0.0  # its bias (Kendall 1954)
        partial = float(np.clip(partial, -settings.largest, settings.largest))
        coefficients = np.append(coefficients - partial * coefficients[::-1], partial)
        innovation *= 1 - partial**2
        criterion = rows * np.log(innovation) + order * np.log(rows)
        if criterion < least:
            least = criterion
            best = coefficients
    found = products[: 1 + len(best)]
    order = len(best)
    while order and len(found) < min(longest, settings.most):
        found.append(float(best @ np.array(found[: -order - 1 : -1])))
        if np.abs(found[-order:]).max() < settings.small * found[0]:
            break
    return np.array(found)
