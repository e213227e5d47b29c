"""What every sampler must keep to."""

import numpy as np

from dropo.core.contracts.sampler import Density, Sampler
from dropo.core.records.draws import Draws
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array
from dropo.testing.optimizers import no_global_stream

SPACE = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.0, 10.0)))
MEAN = np.array([0.8, 6.0])
COVARIANCE = np.array(
    [[0.04, 0.096], [0.096, 0.64]]
)  # standard deviations 0.2 and 0.8, correlation 0.6; bounds 5 and more away
TOLERANCE = 4.5  # standard errors: 7e-6 false alarms a number


class Gaussian:
    """log N(MEAN, COVARIANCE), without its constant, with its gradient."""

    precision = np.linalg.inv(COVARIANCE)

    def __call__(self, points: Array) -> Array:
        return self.value_score_information(points)[0]

    def value_score_information(self, points: Array) -> tuple[Array, Array]:
        """(W, 2) -> (W,), (W, 2)."""
        solved = (points - MEAN) @ self.precision
        return -0.5 * ((points - MEAN) * solved).sum(axis=1), -solved


class Flat:
    """A constant: uniform on the box."""

    def __call__(self, points: Array) -> Array:
        return np.zeros(len(points))

    def value_score_information(self, points: Array) -> tuple[Array, Array]:
        """(W, 2) -> (W,), (W, 2)."""
        return np.zeros(len(points)), np.zeros(points.shape)


gaussian = Gaussian()
flat = Flat()


def check_sampler(sampler: Sampler) -> None:
    """Raises AssertionError, saying what is wrong, unless the sampler keeps to the contract.

    It must be set to take enough draws for its own diagnostics: R-hat below 1.05 on a Gaussian of
    two dimensions.
    """
    name = type(sampler).__name__
    draws = _draw(sampler, gaussian)
    _check_records(draws, name)
    _check_randomness(sampler, draws, name)
    r_hat = draws.split_r_hat().max()
    assert r_hat < 1.05, f"{name} does not converge on a Gaussian: R-hat is {r_hat:.3f}"
    _check_moments(draws, MEAN, np.sqrt(np.diagonal(COVARIANCE)), name, "a Gaussian")
    _check_correlation(draws, 0.6, name)
    width = SPACE.high - SPACE.low
    _check_moments(
        _draw(sampler, flat),
        SPACE.low + width / 2,
        width / np.sqrt(12),
        name,
        "a uniform law on the box",
        kurtosis=1.8,
    )


def _draw(sampler: Sampler, density: Density, seed: int = 0) -> Draws:
    return sampler.sample(
        density, SPACE, rng=np.random.default_rng(seed), start=[0.45, 0.55], spread=0.05
    )


def _check_records(draws: Draws, name: str) -> None:
    inside = (draws.chain >= SPACE.low).all() and (draws.chain <= SPACE.high).all()
    assert inside, f"{name} leaves the box"
    at = gaussian(draws.flat()).reshape(draws.log_density.shape)
    assert np.allclose(at, draws.log_density, atol=1e-8), (
        f"the log densities of {name} are not those at its draws"
    )


def _check_randomness(sampler: Sampler, draws: Draws, name: str) -> None:
    with no_global_stream(name):
        again = _draw(sampler, gaussian)
    assert np.array_equal(again.chain, draws.chain), (
        f"{name} is not deterministic: the same rng gave other draws"
    )
    assert not np.array_equal(_draw(sampler, gaussian, seed=1).chain, draws.chain), (
        f"{name} does not use its rng"
    )


def _check_moments(
    draws: Draws, mean: Array, sd: Array, name: str, distribution: str, kurtosis: float = 3.0
) -> None:
    values = draws.flat()
    size = draws.effective_sample_size()
    off = np.abs(values.mean(axis=0) - mean) * np.sqrt(size) / sd
    assert (off < TOLERANCE).all(), (
        f"{name}: the mean of draws from {distribution} is {values.mean(axis=0)}, not "
        f"{mean}: {off} standard errors"
    )
    squares = Draws((draws.chain - mean) ** 2, draws.log_density, draws.names)
    error = sd**2 * np.sqrt(
        (kurtosis - 1) / squares.effective_sample_size()
    )  # var((x - mean)^2) = (kurtosis - 1) sd^4
    found = squares.flat().mean(axis=0)
    off = np.abs(found - sd**2) / error
    assert (off < TOLERANCE).all(), (
        f"{name}: the variance of draws from {distribution} is {found}, not {sd**2}: {off} "
        "standard errors"
    )


def _check_correlation(draws: Draws, correlation: float, name: str) -> None:
    products = np.prod(
        (draws.chain - MEAN) / np.sqrt(np.diagonal(COVARIANCE)), axis=2, keepdims=True
    )  # (S, W, 1)
    seen = Draws(products, draws.log_density, ("a b",))
    error = np.sqrt((1 + correlation**2) / seen.effective_sample_size()[0])  # var(xy) = 1 + rho^2
    found = float(seen.flat().mean())
    off = abs(found - correlation) / error
    assert off < TOLERANCE, (
        f"{name}: the correlation of draws from a Gaussian is {found:.3f}, not "
        f"{correlation}: {off:.1f} standard errors"
    )
