"""Likelihoods from a local model of the simulator, sound near where it was built."""

from abc import abstractmethod

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import Likelihood, LogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array


class LocalLogLikelihood(LogLikelihood):
    """Sound near where it was built alone; `unknowns` are bounded by that region."""

    @abstractmethod
    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """The value, the scores of the rows (R, m), or of the groups where they share draws, and
        the Fisher information (m, m).
        """

    @abstractmethod
    def predict(self, values: Array) -> Array:
        """What the local model has in the simulator's place: (K, d) -> (K, R, p)."""


class LocalLikelihood(Likelihood):
    """A likelihood from a local model of the simulator: an estimator builds it again where it finds
    the maximum.
    """

    @abstractmethod
    def linearize_at(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        rng: np.random.Generator,
        *,
        rough: bool = False,
    ) -> LocalLogLikelihood:
        """The log-likelihood of members with means near centre (d,) and scales up to about width
        (d,); cheaper where `rough`.
        """

    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LocalLogLikelihood:
        space = simulator.space
        return self.linearize_at(
            simulator,
            segments,
            family,
            epsilon,
            (space.low + space.high) / 2,
            (space.high - space.low) / 6,
            rng,
        )
