"""The contract of likelihoods: the log density of measured segments under a member of a family."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.family import Family
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, is_tensor
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, check_shape, float_array


class LogLikelihood(ABC):
    """The log-likelihood of phi (m,) = the family's unknowns, then the likelihood's own: sums the R
    compared rows.
    """

    unknowns: ParameterSpace
    has_gradients = False

    def __call__(self, phi: ArrayLike) -> float:
        """Log L(phi) = sum of the rows [nats] (thesis, eq. 5.6); -inf where a simulation failed; a
        tensor () of a tensor.
        """
        rows = self.rows(phi)
        if is_tensor(rows):
            return rows.sum()
        return float(rows.sum()) if np.isfinite(rows).all() else -np.inf

    def rows(self, phi: ArrayLike) -> Array:
        """(R,) log density of each compared row [nats]; -inf where one of its simulations failed.

        A torch tensor phi gives a tensor, with its autograd history, where likelihood and family
        are of closed form in phi.
        """
        if not is_tensor(phi):
            return self._rows(float_array("phi", phi, (len(self.unknowns),), type(self).__name__))
        tensor = constant(phi, phi)
        check_shape("phi", tensor, (len(self.unknowns),), type(self).__name__)
        return self._rows(tensor)

    def gradient(self, phi: ArrayLike) -> Array:
        """(m,) d log L / d phi, where `has_gradients`."""
        raise Incompatible(
            f"{type(self).__name__} gives no gradients. Use an optimizer without, such as "
            "'cma-es' or 'nlopt-sbplx'."
        )

    @abstractmethod
    def _rows(self, phi: Array) -> Array:
        """(m,) -> (R,), arrays or tensors."""

    @abstractmethod
    def epsilon(self, phi: Array) -> Array:
        """(p,) the noise variance of each signal."""

    @abstractmethod
    def mean(self, phi: Array) -> Array:
        """(R, p) the mean prediction under phi, for the mean squared error."""


class Likelihood(ABC):
    """Settings of a likelihood; `bind` makes it a function of phi for given data."""

    @abstractmethod
    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LogLikelihood:
        """The log-likelihood of the segments. epsilon: the noise variance, one or (p,) [signal
        unit^2], or a Noise.
        """
