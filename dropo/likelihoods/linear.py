"""The Gaussian likelihood of a simulator that is linear around the estimate.

It takes 2 d + 1 simulations of each segment, and so suits many parameters.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array
from dropo.likelihoods.support.linear_rows import LinearRows, along


@dataclass(frozen=True)
class Linear(LocalLikelihood):
    """A Gaussian for each row, with the moments of a linear model of the simulator.

    Attributes
    ----------
    step : float
        Half width of the differences, as a fraction of the width around the centre.
    memory : MemorySettings
        How much the slopes of all rows may take, beyond which they are kept in a file.

    Notes
    -----
    y ~ N(f(c) + J (mean - c), J S J' + diag(epsilon)), with S the covariance of the member and J by
    central differences at the centre c. Parameters of a logarithmic family are taken as their
    logarithms. Nothing stands for what the linear model leaves: with a small epsilon and a wide
    member, 'emulated' is the exact one.
    """

    step: float = 0.5
    memory: MemorySettings = MEMORY

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
        """Return the log-likelihood of members with means near the centre (d,)."""
        step = self.step * width
        axial = along(simulator, segments, family, centre, step, self.memory, curved=False)
        return LinearRows(axial, simulator, segments, family, epsilon, centre, width, self.memory)
