"""Checks that every likelihood must pass."""

from collections.abc import Callable

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import Likelihood, LogLikelihood
from dropo.core.contracts.noise import Epsilon, Noise
from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Segments, Signal, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array

EPSILON = 0.05
"""Noise variance of the test problem."""
DRAWS = 50
"""Number of predictions in a sample."""


_Density = Callable[[Array, Array, Array], Array]
"""Log densities (R,) of predictions (K, R, p), targets (R, p) and noise (K, R, p)."""


def check_likelihood(likelihood: Likelihood) -> None:
    """Check that a likelihood keeps to the contract of `Likelihood`.

    It is bound to a small linear problem; the density of a `SampledLikelihood` is checked by itself
    too.

    Parameters
    ----------
    likelihood : Likelihood
        The likelihood.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which.
    """
    if isinstance(likelihood, SampledLikelihood):
        _check_rows(likelihood)
        _check_epsilon(likelihood)
        _check_normalised(likelihood, 1, points=2001, span=12.0)
        _check_normalised(likelihood, 2, points=121, span=7.0)
    _check_bound(likelihood)
    _check_learned(likelihood)
    _check_failures(likelihood)


class Line(Simulator):
    """A linear simulator of two signals x and y, with one parameter each.

    Parameters
    ----------
    broken : float
        Segments whose x starts at this value or above fail.

    Notes
    -----
    o_{t+1} = o_t + a_t xi, entry by entry.
    """

    has_gradients = False

    def __init__(self, broken: float = np.inf):
        self.space = ParameterSpace((Parameter("slope", 0.5, 4.0), Parameter("tilt", 0.5, 4.0)))
        self.signals = (Signal("x"), Signal("y"))
        self.broken = broken

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        starts = segments.starts if offsets is None else segments.starts + offsets
        starts = np.where(starts[..., :1] >= self.broken, np.nan, starts)
        starts = np.broadcast_to(starts, (len(values), *starts.shape[-2:]))  # (K, N, 2)
        path = np.cumsum(segments.actions, axis=1) * values[:, None, None]  # (K, N, L, 2)
        segment, step = segments.rows
        predictions: Array = (starts[:, :, None] + path)[:, segment, step]
        return predictions


def line_data(
    rng: np.random.Generator, *, mean: float = 2.0, sd: float = 0.3, rows: int = 40
) -> Trajectories:
    """Return transitions of `Line`, each with its own draw of both parameters.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all random numbers.
    mean, sd : float
        Both parameters are drawn from N(mean, sd^2).
    rows : int
        Number of transitions.

    Returns
    -------
    Trajectories
        One transition each, with noise of variance `EPSILON`.
    """
    start = rng.uniform(-1, 1, (rows, 2))
    action = rng.uniform(1, 2, (rows, 2))
    values = rng.normal(mean, sd, (rows, 2))
    errors = np.sqrt(EPSILON) * rng.standard_normal((rows, 2))
    following = start + action * values + errors
    return Trajectories(start, action, following, np.ones(rows, dtype=bool))


def _samples(p: int, rows: int) -> tuple[Array, Array, Array]:
    """Returns correlated predictions (K, R, p), targets (R, p) and noise (K, R, p)."""
    rng = np.random.default_rng(0)
    mix = np.eye(p) + 0.5 * np.tri(p, k=-1)
    predictions = rng.normal(size=(rows, p)) + rng.standard_normal((DRAWS, rows, p)) @ mix.T
    return predictions, predictions[0] + 0.3, rng.standard_normal((DRAWS, rows, p))


def _check_rows(likelihood: SampledLikelihood) -> None:
    """The density has one finite number a row, is deterministic and keeps its symmetries."""
    name = type(likelihood).__name__
    predictions, targets, noise = _samples(2, 7)
    epsilon = np.full(2, EPSILON)

    def density(predictions: Array, targets: Array, noise: Array) -> Array:
        return likelihood.log_density(predictions, targets, epsilon, noise)

    originals = (predictions.copy(), targets.copy(), noise.copy())
    expected = density(predictions, targets, noise)
    assert expected.shape == (7,), f"{name}.log_density gives shape {expected.shape}, not (7,)"
    finite = np.isfinite(expected).all()
    assert finite, f"{name}.log_density gives {expected} on ordinary predictions"
    unchanged = all(map(np.array_equal, originals, (predictions, targets, noise)))
    assert unchanged, f"{name}.log_density changes its arguments"
    assert np.array_equal(expected, density(predictions, targets, noise)), (
        f"{name}.log_density is not deterministic"
    )
    _check_symmetries(density, expected, name)
    _check_failed_row(density, expected, name)


def _check_symmetries(density: _Density, expected: Array, name: str) -> None:
    """The order of rows and draws, and a shift of everything, do not change the density."""
    predictions, targets, noise = _samples(2, 7)
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    found = density(predictions[:, order], targets[order], noise[:, order])
    assert np.allclose(expected[order], found, rtol=1e-9), (
        f"the rows of {name}.log_density depend on their order"
    )
    draws = np.random.default_rng(1).permutation(DRAWS)
    found = density(predictions[draws], targets, noise[draws])
    assert np.allclose(expected, found, rtol=1e-9), (
        f"{name}.log_density depends on the order of the draws"
    )
    found = density(predictions + 5.0, targets + 5.0, noise)
    assert np.allclose(expected, found, rtol=1e-7), (
        f"{name}.log_density changes when predictions and targets move together"
    )


def _check_failed_row(density: _Density, expected: Array, name: str) -> None:
    """A failed simulation gives -inf in its own row alone."""
    predictions, targets, noise = _samples(2, 7)
    predictions[3, 4] = np.nan
    found = density(predictions, targets, noise)
    assert found[4] == -np.inf, (
        f"a failed simulation must give -inf in its row; {name}.log_density gives {found[4]}"
    )
    others = np.allclose(np.delete(expected, 4), np.delete(found, 4), rtol=1e-9)
    assert others, f"a failed simulation changes other rows of {name}.log_density"


def _check_epsilon(likelihood: SampledLikelihood) -> None:
    """A larger epsilon widens the density; without any, equal predictions give no number."""
    name = type(likelihood).__name__
    predictions, targets, noise = _samples(2, 7)
    far = predictions.mean(axis=0) + 5.0
    narrow = likelihood.log_density(predictions, far, np.full(2, EPSILON), noise)
    wide = likelihood.log_density(predictions, far, np.full(2, 4.0), noise)
    assert (wide > narrow).all(), f"a larger epsilon does not widen the density of {name}"
    same = np.broadcast_to(targets, predictions.shape)
    try:
        value = likelihood.log_density(same, targets, np.zeros(2), noise)
    except BadArgument:
        return
    assert np.isfinite(value).all(), (
        f"{name}.log_density gives {value[0]} for equal predictions without epsilon: its "
        "_log_density must give NaN there"
    )


def _check_normalised(likelihood: SampledLikelihood, p: int, *, points: int, span: float) -> None:
    """The density integrates to 1 over targets of p signals."""
    predictions, _, noise = _samples(p, 1)
    # a grid over the targets that is dense in the middle and extends far into the tails
    u = np.linspace(-span, span, points)
    nodes = np.sinh(u)
    weights = np.cosh(u) * (u[1] - u[0])
    mesh = np.stack(np.meshgrid(*[nodes] * p, indexing="ij"), axis=-1).reshape(-1, p)
    factors = np.stack(np.meshgrid(*[weights] * p, indexing="ij"), axis=-1)
    weight = np.prod(factors, axis=-1).ravel()
    targets = predictions.mean(axis=(0, 1)) + mesh
    shape = (DRAWS, len(mesh), p)
    logs = likelihood.log_density(
        np.broadcast_to(predictions, shape),
        targets,
        np.full(p, EPSILON),
        np.broadcast_to(noise, shape),
    )
    total = float(np.exp(logs) @ weight)
    name = type(likelihood).__name__
    assert abs(total - 1) < 2e-3, (
        f"exp({name}.log_density) integrates to {total:.4g} over targets of p = {p}, not to 1"
    )


def _bind(
    likelihood: Likelihood, epsilon: Epsilon = EPSILON, broken: float = np.inf
) -> tuple[LogLikelihood, Family, Segments]:
    """Returns the likelihood bound to the test problem, with its family and segments."""
    simulator = Line(broken)
    segments = line_data(np.random.default_rng(3)).segments()
    family: Family = find("families", "truncated_gaussian")(simulator.space)
    bound = likelihood.bind(simulator, segments, family, epsilon, np.random.default_rng(4))
    return bound, family, segments


def _member(bound: LogLikelihood, family: Family, mean: float) -> Array:
    """Returns phi of the member with the given mean of both parameters."""
    phi = bound.unknowns.from_unit(np.full(len(bound.unknowns), 0.5))
    phi[: len(family.unknowns)] = family.phi([mean, mean], [0.34, 0.34])
    return phi


def _check_bound(likelihood: Likelihood) -> None:
    """The bound log-likelihood is deterministic, and its parts fit together and to the data."""
    name = type(likelihood).__name__
    bound, family, segments = _bind(likelihood)
    assert bound.unknowns.names[: len(family.unknowns)] == family.unknowns.names, (
        f"the unknowns of {name} do not begin with the family's"
    )
    phi = _member(bound, family, 2.0)
    rows = bound.rows(phi)
    shape = segments.targets.shape
    assert rows.shape == shape[:1], f"{name}: rows has shape {rows.shape}, not {shape[:1]}"
    assert np.array_equal(rows, bound.rows(phi)), (
        f"{name}: the log-likelihood is not deterministic: the same phi gave other rows"
    )
    assert np.isclose(bound(phi), rows.sum()), (
        f"{name}: the log-likelihood is {bound(phi)}, the sum of its rows {rows.sum()}"
    )
    assert np.array_equal(rows, _bind(likelihood)[0].rows(phi)), (
        f"{name}: bound twice with the same rng, the log-likelihoods differ"
    )
    assert bound.mean(phi).shape == shape, (
        f"{name}: mean has shape {bound.mean(phi).shape}, not {shape}"
    )
    error = float(np.abs(bound.mean(phi) - segments.targets).mean())
    assert error < 1.0, (
        f"{name}: mean is {error:.3g} away from data that the member generated, whose "
        "spread is about 0.5"
    )
    assert np.allclose(bound.epsilon(phi), np.full(2, EPSILON)), (
        f"{name}: epsilon is {bound.epsilon(phi)}, but {EPSILON} was given"
    )
    wrong = bound(_member(bound, family, 3.0))
    assert bound(phi) > wrong, (
        f"{name}: the member that generated the data has {bound(phi):.5g} nat, one 3 sd "
        f"away {wrong:.5g}"
    )
    if bound.has_gradients:
        _check_gradient(bound, phi, name)


def _check_gradient(bound: LogLikelihood, phi: Array, name: str) -> None:
    """The gradient agrees with central differences."""
    gradient = bound.gradient(phi)
    assert gradient.shape == phi.shape, (
        f"{name}: the gradient has shape {gradient.shape}, not {phi.shape}"
    )
    steps = np.diag(1e-5 * np.abs(phi))
    differences = [(bound(phi + step) - bound(phi - step)) / (2 * step.sum()) for step in steps]
    expected = np.array(differences)
    agrees = np.allclose(gradient, expected, rtol=1e-3, atol=1e-4 * float(np.abs(expected).max()))
    assert agrees, f"{name}: the gradient is {gradient}, differences give {expected}"


def _check_learned(likelihood: Likelihood) -> None:
    """A learned epsilon has an unknown that it follows, and on which the density depends."""
    name = type(likelihood).__name__
    try:
        bound, family, _ = _bind(likelihood, Noise(np.full(2, EPSILON), "factor"))
    except Incompatible:
        return
    assert len(bound.unknowns) > len(family.unknowns), f"{name}: a learned epsilon adds no unknown"
    noise = slice(len(family.unknowns), None)
    high = _member(bound, family, 2.0)
    low = high.copy()
    low[noise] = bound.unknowns.from_unit(np.full(len(bound.unknowns), 0.4))[noise]
    assert (bound.epsilon(low) < bound.epsilon(high)).all(), (
        f"{name}: the learned epsilon does not follow its unknown"
    )
    assert bound(low) != bound(high), (
        f"{name}: the log-likelihood does not depend on the learned epsilon"
    )


def _check_failures(likelihood: Likelihood) -> None:
    """Failed simulations give -inf in their own rows and in the sum, or an error."""
    name = type(likelihood).__name__
    whole, family, segments = _bind(likelihood)
    threshold = np.sort(segments.starts[:, 0])[-3]  # three segments fail
    failing = segments.starts[:, 0] >= threshold
    try:
        bound = _bind(likelihood, broken=float(threshold))[0]
        phi = _member(bound, family, 2.0)
        rows = bound.rows(phi)
    except SimulationFailed:
        return
    assert (rows[failing] == -np.inf).all(), (
        f"{name}: rows with failed simulations must be -inf; they are {rows[failing]}"
    )
    assert np.allclose(rows[~failing], whole.rows(phi)[~failing], rtol=1e-9), (
        f"{name}: failed simulations change other rows"
    )
    assert bound(phi) == -np.inf, (
        f"{name}: the log-likelihood must be -inf where a simulation failed; it is {bound(phi)}"
    )
