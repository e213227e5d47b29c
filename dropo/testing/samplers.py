"""Checks that every sampler must pass."""

import numpy as np

from dropo.core.contracts.sampler import Density, Sampler
from dropo.core.records.draws import Draws
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array
from dropo.testing.optimizers import no_global_stream

SPACE = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.0, 10.0)))
"""The box of both test densities."""
MEAN = np.array([0.8, 6.0])
"""Mean of the Gaussian test density; the bounds are 5 standard deviations and more away."""
SD = np.array([0.2, 0.8])
"""Standard deviations of the Gaussian test density."""
CORRELATION = 0.6
"""Correlation of the Gaussian test density."""
COVARIANCE = np.array([[0.04, 0.096], [0.096, 0.64]])
"""Covariance of the Gaussian test density."""
MAX_Z = 4.5
"""Standard errors between a moment and its estimate: 7e-6 false alarms a number."""


class Gaussian:
    """The log density of N(MEAN, COVARIANCE) without its constant, and its gradient."""

    precision = np.linalg.inv(COVARIANCE)

    def __call__(self, points: Array) -> Array:
        return self.value_score_information(points)[0]

    def value_score_information(self, points: Array) -> tuple[Array, Array]:
        """Compute log densities and their gradients.

        Parameters
        ----------
        points : (W, 2) array
            Where.

        Returns
        -------
        values : (W,) array
            Log densities less a constant.
        scores : (W, 2) array
            Gradients.
        """
        solved = (points - MEAN) @ self.precision
        return -0.5 * ((points - MEAN) * solved).sum(axis=1), -solved


class Flat:
    """A constant log density: the uniform distribution on the box."""

    def __call__(self, points: Array) -> Array:
        return np.zeros(len(points))

    def value_score_information(self, points: Array) -> tuple[Array, Array]:
        """Compute log densities and their gradients, which are 0.

        Parameters
        ----------
        points : (W, 2) array
            Where.

        Returns
        -------
        values : (W,) array
            Log densities less a constant.
        scores : (W, 2) array
            Gradients.
        """
        return np.zeros(len(points)), np.zeros(points.shape)


gaussian = Gaussian()
flat = Flat()


def check_sampler(sampler: Sampler, *, max_r_hat: float = 1.05, max_z: float = MAX_Z) -> None:
    """Check that a sampler keeps to the contract of `Sampler`.

    Parameters
    ----------
    sampler : Sampler
        A sampler that is set to take enough draws for its own diagnostics.
    max_r_hat : float
        Largest R-hat of its draws from a Gaussian of two dimensions.
    max_z : float
        Largest difference of a moment from its estimate, in standard errors.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which.
    """
    name = type(sampler).__name__
    draws = _draw(sampler, gaussian)
    _check_records(draws, name)
    _check_randomness(sampler, draws, name)
    r_hat = draws.split_r_hat().max()
    assert r_hat < max_r_hat, f"{name} does not converge on a Gaussian: R-hat is {r_hat:.3f}"
    _check_mean(draws, MEAN, SD, f"{name}: the mean of draws from a Gaussian", max_z)
    _check_variance(draws, MEAN, SD, f"{name}: the variance of draws from a Gaussian", max_z)
    _check_correlation(draws, name, max_z)
    width = SPACE.high - SPACE.low
    draws = _draw(sampler, flat)
    mean = SPACE.low + width / 2
    sd = width / np.sqrt(12)
    source = "draws from a uniform distribution on the box"
    _check_mean(draws, mean, sd, f"{name}: the mean of {source}", max_z)
    _check_variance(draws, mean, sd, f"{name}: the variance of {source}", max_z, kurtosis=1.8)


def _draw(sampler: Sampler, density: Density, seed: int = 0) -> Draws:
    """Returns draws from a density, from the same start and spread."""
    rng = np.random.default_rng(seed)
    return sampler.sample(density, SPACE, rng=rng, start=[0.45, 0.55], spread=0.05)


def _check_records(draws: Draws, name: str) -> None:
    """Draws lie in the box, and their log densities belong to them."""
    inside = (draws.chain >= SPACE.low).all() and (draws.chain <= SPACE.high).all()
    assert inside, f"{name} leaves the box"
    recomputed = gaussian(draws.flat()).reshape(draws.log_density.shape)
    assert np.allclose(recomputed, draws.log_density, atol=1e-8), (
        f"the log densities of {name} are not those at its draws"
    )


def _check_randomness(sampler: Sampler, draws: Draws, name: str) -> None:
    """The same rng gives the same draws, another rng others; the global stream is not touched."""
    with no_global_stream(name):
        again = _draw(sampler, gaussian)
    assert np.array_equal(again.chain, draws.chain), (
        f"{name} is not deterministic: the same rng gave other draws"
    )
    assert not np.array_equal(_draw(sampler, gaussian, seed=1).chain, draws.chain), (
        f"{name} does not use its rng"
    )


def _check_mean(draws: Draws, mean: Array, sd: Array, what: str, max_z: float) -> None:
    """The mean (2,) is that of the draws, whose standard deviation is `sd` (2,)."""
    estimate = draws.flat().mean(axis=0)
    z = np.abs(estimate - mean) * np.sqrt(draws.effective_sample_size()) / sd
    assert (z < max_z).all(), f"{what} is {estimate}, not {mean}: {z} standard errors"


def _check_variance(
    draws: Draws, mean: Array, sd: Array, what: str, max_z: float, kurtosis: float = 3.0
) -> None:
    """The variance sd^2 (2,) is that of the draws around their known mean (2,)."""
    squares = Draws((draws.chain - mean) ** 2, draws.log_density, draws.names)
    # the variance of (x - mean)^2 is (kurtosis - 1) sd^4
    error = sd**2 * np.sqrt((kurtosis - 1) / squares.effective_sample_size())
    estimate = squares.flat().mean(axis=0)
    z = np.abs(estimate - sd**2) / error
    assert (z < max_z).all(), f"{what} is {estimate}, not {sd**2}: {z} standard errors"


def _check_correlation(draws: Draws, name: str, max_z: float) -> None:
    """The correlation of draws from the Gaussian is right."""
    standardised = (draws.chain - MEAN) / SD
    products = np.prod(standardised, axis=2, keepdims=True)  # (S, W, 1)
    series = Draws(products, draws.log_density, ("a b",))
    # the variance of a product of standard normals with correlation rho is 1 + rho^2
    error = np.sqrt((1 + CORRELATION**2) / series.effective_sample_size()[0])
    estimate = float(series.flat().mean())
    z = abs(estimate - CORRELATION) / error
    assert z < max_z, (
        f"{name}: the correlation of draws from a Gaussian is {estimate:.3f}, not "
        f"{CORRELATION}: {z:.1f} standard errors"
    )
