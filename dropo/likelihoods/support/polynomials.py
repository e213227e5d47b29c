"""A simulator's predictions as polynomials of the parameters, fitted on a shared design."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from dropo.core.contracts.simulator import Simulator, describe_failures
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.diverged_simulations import ranges, settled
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.core.services.validation import Array, require
from dropo.likelihoods.support.blocks import segment_blocks

# design points for M polynomials: 1.7 M + 6
POINTS = 1.7
SPARE = 6
ROUGH = 2  # the highest order for a first look
ORDERS = (
    (0.002, 1),
    (0.013, 2),
    (0.033, 3),
    (np.inf, 4),
)  # polynomial order by width / search interval
SINGULAR = 1e-10  # the least share of the largest diagonal entry of the design's R
FULL_QUADRATIC = (
    10  # up to so many parameters all pairs are crossed; beyond, only their squares are kept
)


def orders_for(
    width: Array, space: ParameterSpace, order: int | None, rough: bool
) -> NDArray[np.int64]:
    """(d,) polynomial orders: the one given, else by the design's width as a share of the search
    interval; at most 2 where rough.
    """
    share = width / (space.high - space.low)
    chosen = [order or next(o for limit, o in ORDERS if s < limit) for s in share]
    return np.minimum(np.array(chosen, dtype=np.int64), ROUGH if rough else max(chosen))


def index_set(orders: NDArray[np.int64]) -> NDArray[np.int64]:
    """(M, d) exponents j with sum_i j_i / orders_i <= 1, and the pairs (1, 1) of orders above 1; by
    degree, the constant first.
    """
    d = len(orders)
    if d > FULL_QUADRATIC:
        own = [np.eye(d, dtype=np.int64) * k for k in range(1, int(orders.max()) + 1)]
        chosen = [row for k, block in enumerate(own, 1) for row in block[orders >= k]]
        return np.array([np.zeros(d, dtype=np.int64), *chosen])
    found = []
    for j in product(*(range(q + 1) for q in orders)):
        exponents = np.array(j)
        pair = exponents.sum() == 2 and exponents.max() == 1 and orders[exponents > 0].min() > 1
        if (exponents / orders).sum() <= 1 + 1e-9 or pair:
            found.append(j)
    return np.array(sorted(found, key=lambda j: (sum(j), tuple(-x for x in j))), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Emulator:
    """f(x) ~ sum_j C_j psi_j((x - centre) / width), psi products of orthonormal Hermite
    polynomials.

    centre, width: (d,) in the emulator's coordinates (logarithms where `logarithmic`); indices: (M,
    d);
    coefficients: (M, R, p); residual: (R, p, p) the residuals' covariance; failed: design points
    that diverged or exploded.
    """

    centre: Array
    width: Array
    indices: NDArray[np.int64]
    coefficients: Array
    residual: Array
    logarithmic: bool
    failed: int

    def basis(self, values: Array) -> Array:
        """The polynomials (K, M) at parameter vectors (K, d), array or tensor."""
        x = namespace(values).log(values) if self.logarithmic else values
        return products((x - constant(self.centre, x)) / constant(self.width, x), self.indices)

    def slopes(self, values: Array) -> Array:
        """D basis / d value (K, M, d) at parameter vectors (K, d), where the coordinates are the
        values themselves.
        """
        u = (values - self.centre) / self.width
        out = []
        for i in range(u.shape[1]):
            lower = self.indices - np.eye(u.shape[1], dtype=np.int64)[i]
            factor = (
                np.sqrt(np.maximum(self.indices[:, i], 0)) / self.width[i]
            )  # d He_n / du = sqrt(n) He_(n-1), orthonormal
            out.append(factor * products(u, np.maximum(lower, 0)))
        return np.stack(out, axis=-1)

    def predict(self, values: Array) -> Array:
        """Emulated predictions (K, R, p) at (K, d)."""
        return np.einsum("km,mrp->krp", self.basis(values), self.coefficients, optimize=True)


def products(u: Array, indices: NDArray[np.int64], distribution=NORMAL) -> Array:  # type: ignore[no-untyped-def]
    """Products of the law's orthonormal polynomials: u (K, d), array or tensor, indices (M, d) ->
    (K, M).
    """
    single = distribution.orthonormal(u, max(1, int(indices.max())))  # (K, d, degree + 1)
    out = single[:, 0, indices[:, 0]]
    for i in range(1, u.shape[1]):
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
) -> Emulator:
    """Simulates a scrambled Sobol design around the centre and regresses every row's signals on it.

    A design point that diverges or explodes in one segment is left out of all. Predictions are held
    for a block of segments at a time;
    the blocks before the one in which a point first diverged are simulated again without it.
    """
    require(
        bool((width > 0).all()),
        "width",
        "positive for every parameter",
        width.tolist(),
        "an emulator",
    )
    indices = index_set(orders)
    count = int(np.ceil(POINTS * len(indices))) + SPARE
    design = design_points(simulator, centre, width, count, rng, logarithmic)
    x = np.log(design) if logarithmic else design
    basis = products((x - centre) / width, indices)
    rows = len(segments.rows[0])
    p = len(simulator.signals)
    coefficients = np.empty((len(indices), rows, p))
    residual = np.empty((rows, p, p))
    blocks = list(segment_blocks(segments, 8 * count * p))
    good = np.ones(count, dtype=bool)
    used = [0] * len(blocks)  # design points behind each block's regression
    targets = simulator.targets(segments)
    reach = ranges(targets)
    for k in [*range(len(blocks)), *range(len(blocks))]:
        if used[k] == good.sum():
            continue
        part, own, _ = blocks[k]
        predictions = simulator.predict(design[good], part)  # (N, r, p)
        whole = settled(predictions, targets[own], reach)
        if whole.sum() < len(indices) + SPARE:
            failed = np.where(whole[:, None, None], predictions, np.nan)
            sentence = describe_failures(failed, design[good], simulator.space, first=own.start)
            raise SimulationFailed(f"{sentence} The design around the estimate cannot be used.")
        good[good] = whole
        coefficients[:, own], residual[own] = _regress(
            basis[good], predictions[whole], indices, simulator.space
        )
        used[k] = int(good.sum())
    return Emulator(centre, width, indices, coefficients, residual, logarithmic, int((~good).sum()))


def _regress(
    basis: Array, predictions: Array, indices: NDArray[np.int64], space: ParameterSpace
) -> tuple[Array, Array]:
    """Coefficients (M, r, p) and the residuals' covariance (r, p, p) of predictions (N, r, p) on a
    basis (N, M).
    """
    q, r = np.linalg.qr(basis)
    size = np.abs(np.diagonal(r))
    if size.min() < SINGULAR * size.max():
        name = space.names[int(indices[size.argmin()].argmax())]
        raise BadArgument(
            "The design around the estimate is singular: its points do not vary enough in "
            f"{name!r} to tell {len(indices)} polynomials"
            f" apart. Move the mean away from the bounds of {name!r}, or take a lower order."
        )
    flat = predictions.reshape(len(predictions), -1)
    projected = q.T @ flat
    shape = predictions.shape[1:]
    coefficients = np.linalg.solve(r, projected).reshape(len(indices), *shape)
    return coefficients, _residual_covariance(
        (flat - q @ projected).reshape(-1, *shape), len(indices)
    )


def design_points(
    simulator: Simulator,
    centre: Array,
    width: Array,
    count: int,
    rng: np.random.Generator,
    logarithmic: bool,
) -> Array:
    """(N, d) quasi-random normal points around the centre; where physically impossible, mirrored at
    the bound, so that they stay apart.
    """
    sobol = qmc.Sobol(len(centre), rng=rng).random_base2(int(np.ceil(np.log2(count))))[:count]
    x = centre + width * ndtri(np.clip(sobol, 1e-12, 1 - 1e-12))
    values = np.exp(x) if logarithmic else x
    space = simulator.space
    values = np.where(values < space.lower, 2 * space.lower - values, values)
    values = np.where(values > space.upper, 2 * space.upper - values, values)
    return space.feasible(values)


def _residual_covariance(left: Array, terms: int) -> Array:
    """(R, p, p) from residuals (N, R, p), with Hartlap, Simon, Schneider's (2007) factor where the
    inverse has a mean.
    """
    n, _, p = left.shape
    free = n - terms
    rows = left.swapaxes(0, 1)  # (R, N, p)
    covariance = rows.swapaxes(1, 2) @ rows / free
    return covariance * (free / (free - p - 1) if free > p + 1 else free)
