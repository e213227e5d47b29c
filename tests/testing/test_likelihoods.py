"""`check_likelihood` meets likelihoods broken on purpose."""

from dataclasses import dataclass

import numpy as np
import pytest

from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.testing import check_likelihood


class WrongConstant(MonteCarlo):
    """The normalising constant is 0.1 nat off."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return super()._log_density(predictions, targets, epsilon, noise) + 0.1


class NoEpsilon(MonteCarlo):
    """Ignores the noise variance where the covariance allows it."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return super()._log_density(predictions, targets, np.full_like(epsilon, 1e-9), noise)


class PooledCovariance(MonteCarlo):
    """Scales spreads by that of all rows, so that one row changes the others."""

    def _log_density(self, predictions, targets, epsilon, noise):
        spread = predictions.std(axis=(0, 1))
        centre = predictions.mean(axis=0)
        return super()._log_density(
            centre + spread * (predictions - centre), targets, epsilon, noise
        )


class Sorted(MonteCarlo):
    """Gives the densities in another order."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return np.sort(super()._log_density(predictions, targets, epsilon, noise))


class OwnNoise(MonteCarlo):
    """Draws fresh noise at each call."""

    def _log_density(self, predictions, targets, epsilon, noise):
        fresh = np.random.default_rng().normal(size=predictions.shape)
        return super()._log_density(predictions + 0.1 * fresh, targets, epsilon, noise)


class NotCentred(MonteCarlo):
    """Second moments about zero instead of the mean."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return super()._log_density(
            np.concatenate([predictions, -predictions]), targets, epsilon, noise
        )


class Weighted(MonteCarlo):
    """Leaves the first draw out."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return super()._log_density(predictions[1:], targets, epsilon, noise)


class Summed(MonteCarlo):
    """Sums the rows by itself."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return super()._log_density(predictions, targets, epsilon, noise).sum()


class Spoilt(MonteCarlo):
    """Gives up on all rows where one simulation failed."""

    def log_density(self, predictions, targets, epsilon, noise=None):
        rows = super().log_density(predictions, targets, epsilon, noise)
        return rows if np.isfinite(rows).all() else np.full_like(rows, -np.inf)


class Forgiving(MonteCarlo):
    """Gives failed rows a number."""

    def log_density(self, predictions, targets, epsilon, noise=None):
        return np.maximum(super().log_density(predictions, targets, epsilon, noise), -1e6)


class Infinite(MonteCarlo):
    """Takes equal predictions for certainty."""

    def _log_density(self, predictions, targets, epsilon, noise):
        return np.nan_to_num(super()._log_density(predictions, targets, epsilon, noise), nan=np.inf)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (
            WrongConstant,
            r"exp\(WrongConstant.log_density\) integrates to 1.105 over targets of p = 1",
        ),
        (NoEpsilon, "a larger epsilon does not widen the density of NoEpsilon"),
        (PooledCovariance, "a failed simulation changes other rows of PooledCovariance"),
        (Sorted, "the rows of Sorted.log_density depend on their order"),
        (OwnNoise, "OwnNoise.log_density is not deterministic"),
        (NotCentred, "NotCentred.log_density changes when predictions and targets move together"),
        (Weighted, "Weighted.log_density depends on the order of the draws"),
        (Spoilt, "a failed simulation changes other rows of Spoilt"),
        (
            Forgiving,
            "a failed simulation must give -inf in its row; Forgiving.log_density gives -1000000",
        ),
        (Infinite, "Infinite.log_density gives inf for equal predictions"),
    ],
)
def test_broken_densities_are_caught(broken: type[SampledLikelihood], words):
    """Each defect gets the message that names it."""
    with pytest.raises(AssertionError, match=words):
        check_likelihood(broken())


class _Bound(LogLikelihood):
    """A bound log-likelihood with one thing wrong."""

    def __init__(self, inner, fault, rng):
        self.inner = inner
        self.unknowns = inner.unknowns
        self.fault = fault
        self.rng = rng
        self.has_gradients = fault == "gradient"
        self.jitter = np.random.default_rng().normal() if fault == "seed" else 0.0

    def _rows(self, phi):
        rows = self.inner.rows(phi) + self.jitter
        return {"shape": rows[:-1], "noise": rows + self.rng.random(), "sign": -rows}.get(
            self.fault, rows
        )

    def gradient(self, phi):
        return np.ones_like(phi)

    def epsilon(self, phi):
        return self.inner.epsilon(phi) * (4.0 if self.fault == "epsilon" else 1.0)

    def mean(self, phi):
        mean = self.inner.mean(phi)
        return {"mean": mean + 3.0, "mean shape": mean[:, 0]}.get(self.fault, mean)


@dataclass(frozen=True)
class Faulty:
    """Binds to a `_Bound`."""

    fault: str

    def bind(self, simulator, segments, family, epsilon, rng):
        if self.fault == "learn" and isinstance(epsilon, Noise):
            epsilon = epsilon.variance
        return _Bound(
            MonteCarlo(50).bind(simulator, segments, family, epsilon, rng), self.fault, rng
        )


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("shape", r"rows has shape \(39,\), not \(40,\)"),
        ("noise", "the log-likelihood is not deterministic"),
        ("seed", "bound twice with the same rng"),
        ("sign", "the member that generated the data has"),
        ("gradient", "the gradient is .* differences give"),
        ("epsilon", "epsilon is .* but 0.05 was given"),
        ("mean", "mean is .* away from data that the member generated"),
        ("mean shape", r"mean has shape \(40,\), not \(40, 2\)"),
        ("learn", "a learned epsilon adds no unknown"),
    ],
)
def test_broken_bindings_are_caught(fault, words):
    """Likelihoods that are not made from samples are checked as bound to a small problem."""
    with pytest.raises(AssertionError, match=words):
        check_likelihood(Faulty(fault))


def test_a_valid_binding_passes():
    """The control: without a fault the same wrapper is silent."""
    check_likelihood(Faulty("none"))
