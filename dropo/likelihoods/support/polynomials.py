"""A simulator's predictions as polynomials of the parameters, fitted on a shared design."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from dropo.core.contracts.simulator import Simulator, describe_failures
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.diverged_simulations import ranges, settled
from dropo.core.numerics.kept_rows import FileRows, KeptRows, MemorySettings, keep_rows, row_blocks
from dropo.core.numerics.sobol import sobol_points
from dropo.core.numerics.standard_distributions import NORMAL, StandardDistribution
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.segment_blocks import segment_blocks
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.core.services.validation import Array, require


@dataclass(frozen=True)
class DesignSettings:
    """What decides the polynomials and the design on which they are fitted.

    Attributes
    ----------
    points_per_term : float
        A design has so many points for each polynomial.
    spare_points : int
        It has so many points more, whatever the number of polynomials.
    rough_order : int
        Highest order of a first, rough fit.
    rough_line : float
        Rough fits are linear below this width, as a fraction of the search interval.
    order_limits : tuple of float
        Order 1 is taken below the first width, as a fraction of the search interval, order 2 below
        the second, and so on.
    full_quadratic : int
        Up to so many parameters all pairs are crossed; beyond, only their powers are kept.
    singular : float
        A design is singular if a diagonal entry of its R is below this fraction of the largest.
    """

    points_per_term: float = 1.7
    spare_points: int = 6
    rough_order: int = 2
    rough_line: float = 0.01
    order_limits: tuple[float, ...] = (0.002, 0.013, 0.033)
    full_quadratic: int = 10
    singular: float = 1e-10

    def design_size(self, terms: int) -> int:
        """Return how many points a design has.

        Parameters
        ----------
        terms : int
            Number M of polynomials.

        Returns
        -------
        int
            points_per_term M, rounded up, and the spare ones.
        """
        return int(np.ceil(self.points_per_term * terms)) + self.spare_points


DESIGN = DesignSettings()


def orders_for(
    width: Array,
    space: ParameterSpace,
    order: int | None,
    rough: bool,
    settings: DesignSettings = DESIGN,
) -> NDArray[np.int64]:
    """Choose the order of the polynomials in each parameter.

    Parameters
    ----------
    width : (d,) array
        Of the design.
    space : ParameterSpace
        The order grows with the width as a fraction of these search intervals.
    order : int or None
        One for all, in place of that.
    rough : bool
        Whether low orders are enough.
    settings : DesignSettings

    Returns
    -------
    (d,) array of int
    """
    fraction = width / (space.high - space.low)
    if order:
        chosen = np.full(len(fraction), order, dtype=np.int64)
    else:
        below = np.searchsorted(settings.order_limits, fraction, side="right")
        chosen = 1 + below.astype(np.int64)
    highest = np.where(fraction < settings.rough_line, 1, settings.rough_order)
    return np.minimum(chosen, highest) if rough else chosen


def index_set(orders: NDArray[np.int64], settings: DesignSettings = DESIGN) -> NDArray[np.int64]:
    """List the exponents of the polynomials.

    Parameters
    ----------
    orders : (d,) array of int
        In each parameter.
    settings : DesignSettings

    Returns
    -------
    (M, d) array of int
        All j with sum_i j_i / orders_i <= 1, and the pairs (1, 1) of orders above 1; by degree, the
        constant first. With many parameters, powers of one parameter alone.
    """
    d = len(orders)
    if d > settings.full_quadratic:
        powers = [np.zeros((1, d), dtype=np.int64)]
        for degree in range(1, int(orders.max()) + 1):
            own = degree * np.eye(d, dtype=np.int64)
            powers.append(own[orders >= degree])
        return np.concatenate(powers)

    found = []
    for j in product(*(range(order + 1) for order in orders)):
        exponents = np.array(j)
        pair = exponents.sum() == 2 and exponents.max() == 1 and orders[exponents > 0].min() > 1
        if (exponents / orders).sum() <= 1 + 1e-9 or pair:
            found.append(j)
    found.sort(key=lambda j: (sum(j), tuple(-x for x in j)))
    return np.array(found, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Emulator:
    """Polynomials in the simulator's place, for every row and signal.

    f(x) ~ sum_j C_j psi_j((x - centre) / width), with psi products of orthonormal Hermite
    polynomials.

    Attributes
    ----------
    centre, width : (d,) or (K, d) array
        In the emulator's coordinates, which are logarithms if `logarithmic`; one for each of the K
        vectors of parameters that it is asked for, where groups have emulators of their own.
    indices : (M, d) array of int
        Exponents.
    coefficients : (M, R, p) array, or (R, M, p) in a file
        Read with `of_rows`.
    residual : (R, p, p) array
        Covariance of the residuals; in a file likewise.
    logarithmic : bool
    failed : int
        Design points that diverged or exploded.
    constant : (R, p) array or None
        Coefficients of the constant that stand for the first ones.
    """

    centre: Array
    width: Array
    indices: NDArray[np.int64]
    coefficients: KeptRows
    residual: KeptRows
    logarithmic: bool
    failed: int
    constant: Array | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """The rows R and the signals p."""
        return self.residual.shape[0], self.residual.shape[1]

    def of_rows(self, rows: slice | Ints) -> Array:
        """Return the coefficients of some rows, from memory or from their file.

        Parameters
        ----------
        rows : slice or array of int
            The r rows.

        Returns
        -------
        (M, r, p) array
            With the own constants where there are such.
        """
        if isinstance(self.coefficients, FileRows):
            found = np.moveaxis(self.coefficients[rows], 1, 0)
        else:
            found = self.coefficients[:, rows]
        if self.constant is not None:
            found = found.copy()
            found[0] = self.constant[rows]
        return found

    def basis(self, values: Array) -> Array:
        """Evaluate the polynomials.

        Parameters
        ----------
        values : (K, d) array
            Parameter vectors in their units, array or tensor.

        Returns
        -------
        (K, M) array
            As `values`, array or tensor.
        """
        x = namespace(values).log(values) if self.logarithmic else values
        return products((x - constant(self.centre, x)) / constant(self.width, x), self.indices)

    def basis_and_slopes(self, values: Array) -> Array:
        """Evaluate the polynomials with their slopes by each parameter.

        Parameters
        ----------
        values : (K, d) array
            In the emulator's coordinates.

        Returns
        -------
        (K, 1 + d, M) array
            The polynomials, then d / d parameter of them.
        """
        u = (values - self.centre) / self.width
        unit = np.eye(u.shape[1], dtype=np.int64)
        single = NORMAL.orthonormal(u, max(1, int(self.indices.max())))
        found = [_multiplied(single, self.indices)]
        for i in range(u.shape[1]):
            # d He_n / du = sqrt(n) He_(n-1), orthonormal.
            factor = np.sqrt(np.maximum(self.indices[:, i], 0)) / self.width[..., i, None]
            lower = np.maximum(self.indices - unit[i], 0)
            found.append(factor * _multiplied(single, lower))
        return np.stack(found, axis=1)

    def predict(self, values: Array, rows: slice | Ints | None = None) -> Array:
        """Emulate predictions.

        Parameters
        ----------
        values : (K, d) array
            Parameter vectors, in their units.
        rows : slice or array of int, optional
            The rows; by default all.

        Returns
        -------
        (K, R, p) array
            In the signals' units.
        """
        basis = self.basis(values)
        if rows is not None:
            return np.einsum("km,mrp->krp", basis, self.of_rows(rows), optimize=True)
        count, p = self.shape
        out = np.empty((len(basis), count, p))
        for block in row_blocks(count, 8 * p * sum(basis.shape)):
            own = self.of_rows(block)
            out[:, block] = np.einsum("km,mrp->krp", basis, own, optimize=True)
        return out


def products(
    u: Array, indices: NDArray[np.int64], distribution: StandardDistribution = NORMAL
) -> Array:
    """Multiply orthonormal polynomials of a standard distribution.

    Parameters
    ----------
    u : (K, d) array or tensor
    indices : (M, d) array of int
        Exponents.
    distribution : StandardDistribution

    Returns
    -------
    (K, M) array or tensor
    """
    return _multiplied(distribution.orthonormal(u, max(1, int(indices.max()))), indices)


def _multiplied(single: Array, indices: NDArray[np.int64]) -> Array:
    """Products (K, M) of the polynomials (K, d, degree + 1) of each parameter."""
    out = single[:, 0, indices[:, 0]]
    for i in range(1, single.shape[1]):
        out = out * single[:, i, indices[:, i]]
    return out


def build(
    simulator: Simulator,
    segments: Segments,
    centre: Array,
    width: Array,
    orders: NDArray[np.int64],
    rng: np.random.Generator,
    *,
    logarithmic: bool = False,
    settings: DesignSettings = DESIGN,
    memory: MemorySettings | None = None,
) -> Emulator:
    """Simulate a scrambled Sobol design around a centre, and regress every row's signals on it.

    A design point that diverges or explodes in one segment is left out of all. Predictions are held
    for a block of segments at a time; the blocks before the one in which a point first diverged are
    simulated again without it.

    Parameters
    ----------
    simulator : Simulator
    segments : Segments
    centre, width : (d,) array
        Of the design, in the emulator's coordinates.
    orders : (d,) array of int
    rng : numpy.random.Generator
        Scrambles the design.
    logarithmic : bool
        Whether the coordinates are the parameters' logarithms.
    settings : DesignSettings
    memory : MemorySettings, optional
        What of it the emulator may take, beyond which it is kept in a file; by default all is kept
        in memory.

    Returns
    -------
    Emulator

    Raises
    ------
    BadArgument
        If a width is not positive, or the design is singular.
    SimulationFailed
        If too many points diverge.
    """
    positive = bool((width > 0).all())
    rule = "positive for every parameter"
    require(positive, "width", rule, width.tolist(), "an emulator")
    indices = index_set(orders, settings)
    terms = len(indices)
    count = settings.design_size(terms)
    design = design_points(simulator, centre, width, count, rng, logarithmic)
    x = np.log(design) if logarithmic else design
    basis = products((x - centre) / width, indices)

    rows = len(segments.rows[0])
    p = len(simulator.signals)
    coefficients, residual = _room(terms, rows, p, memory)
    targets = simulator.targets(segments)
    span = ranges(targets)
    good = np.ones(count, dtype=bool)
    blocks = list(segment_blocks(segments, 8 * count * p))
    used = [0] * len(blocks)  # design points behind each block's regression
    # A second pass over the blocks that were simulated with points which failed later.
    for k in [*range(len(blocks)), *range(len(blocks))]:
        if used[k] == good.sum():
            continue
        part, own, _ = blocks[k]
        predictions = simulator.predict(design[good], part)  # (N, r, p)
        whole = settled(predictions, targets[own], span)
        if whole.sum() < terms + settings.spare_points:
            failed = np.where(whole[:, None, None], predictions, np.nan)
            sentence = describe_failures(failed, design[good], simulator.space, first=own.start)
            raise SimulationFailed(f"{sentence} The design around the estimate cannot be used.")
        good[good] = whole
        found, residual[own] = _regress(
            basis[good], predictions[whole], indices, simulator.space, settings
        )
        if isinstance(coefficients, FileRows):
            coefficients[own] = np.moveaxis(found, 0, 1)
        else:
            coefficients[:, own] = found
        used[k] = int(good.sum())
    return Emulator(centre, width, indices, coefficients, residual, logarithmic, int((~good).sum()))


def _room(
    terms: int, rows: int, p: int, memory: MemorySettings | None
) -> tuple[KeptRows, KeptRows]:
    """Room for coefficients and residuals (R, p, p), as `Emulator` has them."""
    shapes: list[tuple[int, ...]] = [(rows, terms, p), (rows, p, p)]
    coefficients, residual = keep_rows(shapes, 0.0 if memory is None else memory.kept, memory)
    if isinstance(coefficients, FileRows):
        return coefficients, residual
    return coefficients.reshape(terms, rows, p), residual


def _regress(
    basis: Array,
    predictions: Array,
    indices: NDArray[np.int64],
    space: ParameterSpace,
    settings: DesignSettings,
) -> tuple[Array, Array]:
    """Coefficients (M, r, p) and residual covariance (r, p, p) of predictions (N, r, p)."""
    q, r = np.linalg.qr(basis)
    size = np.abs(np.diagonal(r))
    if size.min() < settings.singular * size.max():
        name = space.names[int(indices[size.argmin()].argmax())]
        raise BadArgument(
            "The design around the estimate is singular: its points do not vary enough in"
            f" {name!r} to tell {len(indices)} polynomials apart. Move the mean away from the"
            f" bounds of {name!r}, or take a lower order."
        )
    flat = predictions.reshape(len(predictions), -1)
    projected = q.T @ flat
    shape = predictions.shape[1:]
    coefficients = np.linalg.solve(r, projected).reshape(len(indices), *shape)
    residuals = (flat - q @ projected).reshape(-1, *shape)
    return coefficients, _residual_covariance(residuals, len(indices))


def design_points(
    simulator: Simulator,
    centre: Array,
    width: Array,
    count: int,
    rng: np.random.Generator,
    logarithmic: bool,
) -> Array:
    """Place quasi-random normal points around a centre.

    Parameters
    ----------
    simulator : Simulator
        Points that are physically impossible are mirrored at the bound, so that they stay apart.
    centre, width : (d,) array
        In the emulator's coordinates.
    count : int
        N.
    rng : numpy.random.Generator
        Scrambles the Sobol set.
    logarithmic : bool
        Whether the coordinates are the parameters' logarithms.

    Returns
    -------
    (N, d) array
        Parameters.
    """
    sobol = sobol_points(len(centre), int(np.ceil(np.log2(count))), rng)[:count]
    x = centre + width * ndtri(np.clip(sobol, 1e-12, 1 - 1e-12))
    values = np.exp(x) if logarithmic else x
    space = simulator.space
    values = np.where(values < space.lower, 2 * space.lower - values, values)
    values = np.where(values > space.upper, 2 * space.upper - values, values)
    return space.feasible(values)


def _residual_covariance(residuals: Array, terms: int) -> Array:
    """(R, p, p) from residuals (N, R, p), with a factor that makes its inverse unbiased.

    The factor is that of Hartlap, Simon, Schneider (2007), where the inverse has a mean.
    """
    n, _, p = residuals.shape
    free = n - terms
    rows = residuals.swapaxes(0, 1)  # (R, N, p)
    covariance = rows.swapaxes(1, 2) @ rows / free
    return covariance * (free / (free - p - 1) if free > p + 1 else free)
