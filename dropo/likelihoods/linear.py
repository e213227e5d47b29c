"""The Gaussian likelihood of a simulator that is linear around the estimate.

It takes 2 d + 1 simulations of each segment, and so suits many parameters.
"""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings, row_blocks
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import Axial, along_parameters
from dropo.likelihoods.support.gaussian_rows import Columns, GaussianRows, Parts, parts_of_columns


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


class LinearRows(GaussianRows):
    """Rows of f(x) = value + slope (x - c), with x the parameters or their logarithms.

    Parameters
    ----------
    axial : Axial
        Values and slopes.
    simulator, segments, family, epsilon, centre, width, memory
        As those of `GaussianRows`.
    """

    def __init__(
        self,
        axial: Axial,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        centre: Array,
        width: Array,
        memory: MemorySettings = MEMORY,
    ):
        d = len(centre)
        p = len(simulator.signals)
        columns = 2 * max(d, len(family.unknowns) - d) + 3 * p
        row_floats = 3 * columns**2 + 3 * columns * p
        super().__init__(simulator, segments, family, epsilon, centre, width, row_floats, memory)
        self.axial = axial
        self.centre = coordinates(family, centre)

    def predict(self, values: Array) -> Array:
        """Return the linear model's predictions (K, R, p) at values (K, d)."""
        count, p = self.targets.shape
        out = np.empty((len(values), count, p))
        for rows in row_blocks(count, 8 * p * sum(values.shape)):
            out[:, rows] = self.predict_rows(values, rows)
        return out

    def predict_rows(self, values: Array, rows: slice | Ints) -> Array:
        """Return the linear model's predictions (K, r, p) of some rows."""
        away = coordinates(self.family, values) - self.centre
        return self.axial.value[rows] + np.moveaxis(self.axial.slope[rows] @ away.T, -1, 0)

    def anchored(self, value: Array, predictions: Array) -> "LinearRows":
        """Return the likelihood with all predictions shifted to be right at a value."""
        shift = predictions - self.predict(value[None])[0]
        out = copy.copy(self)
        out.axial = replace(self.axial, value=self.axial.value + shift)
        return out

    def _member(self, own: Any) -> Any:
        """The member's mean from the centre (d,) and covariance (d, d)."""
        mean, covariance = moments_of(self.family, own)
        return mean - constant(self.centre, mean), covariance

    def _spread(self, member: Any, rows: slice) -> tuple[Any, Any]:
        away, covariance = member
        value = constant(self.axial.value[rows], away)
        slope = constant(self.axial.slope[rows], away)
        return value + slope @ away, slope @ covariance @ namespace(slope).matrix_transpose(slope)

    def _member_slopes(self, own: Array) -> tuple[Array, "Entries"]:
        mean, covariance = slopes_of_moments(self.family, own)
        return mean, Entries.of(covariance)

    def _parts(
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: Columns
    ) -> Parts:
        by_mean, entries = slopes
        slope = whiten @ self.axial.slope[rows]
        a, b = entries.pairs(slope)
        return parts_of_columns(z, Columns(slope, by_mean, a, b, entries.weights).beside(noise))


@dataclass(frozen=True, eq=False)
class Entries:
    """The l entries of a member's covariance that depend on its n unknowns.

    Attributes
    ----------
    first, second : (l,) array
        Row and column of each, first <= second.
    slopes : (n, l) array
        d entry / d unknown.
    weights : (n, l) array
        The same, twice for an entry beside the diagonal, which stands for its mirror image too.
    """

    first: Ints
    second: Ints
    slopes: Array
    weights: Array

    @staticmethod
    def of(slopes: Array) -> "Entries":
        """Collect the entries that depend on any unknown.

        Parameters
        ----------
        slopes : (n, d, d) array
            d S / d unknown of the covariance S, symmetric.

        Returns
        -------
        Entries
            Those on and above the diagonal that are not 0.
        """
        upper = np.triu(np.abs(slopes).max(axis=0, initial=0.0))
        rows, columns = np.nonzero(upper)
        first = rows.astype(np.int64)
        second = columns.astype(np.int64)
        own = slopes[:, first, second]
        return Entries(first, second, own, own * np.where(first == second, 1, 2))

    def pairs(self, columns: Array) -> tuple[Array, Array]:
        """Return the columns (r, p, l) of each entry's row and of its column.

        Parameters
        ----------
        columns : (r, p, d) array

        Returns
        -------
        (r, p, l) array, (r, p, l) array
            One object if all entries are on the diagonal.
        """
        a = columns[:, :, self.first]
        if np.array_equal(self.first, self.second):
            return a, a
        return a, columns[:, :, self.second]


def along(
    simulator: Simulator,
    segments: Segments,
    family: Family,
    centre: Array,
    step: Array,
    memory: MemorySettings | None = None,
    *,
    curved: bool = True,
) -> Axial:
    """Differentiate a simulator along the coordinates in which a family is taken.

    Parameters
    ----------
    simulator : Simulator
    segments : Segments
    family : Family
    centre : (d,) array
        Parameters.
    step : (d,) array
        In the parameters' units.
    memory : MemorySettings, optional
        As of `along_parameters`.
    curved : bool
        Whether curvatures are kept.

    Returns
    -------
    Axial

    Raises
    ------
    SimulationFailed
        If a simulation diverges.
    """
    own_step = step / centre if family.logarithmic else step
    return along_parameters(
        simulator,
        segments,
        coordinates(family, centre),
        own_step,
        logarithmic=family.logarithmic,
        curved=curved,
        memory=memory,
    )


def coordinates(family: Family, values: Array) -> Array:
    """Return parameters in the coordinates in which a family is taken.

    Parameters
    ----------
    family : Family
        It may be in logarithms.
    values : array
        Parameters, in their units.

    Returns
    -------
    array
        The values, or their logarithms if the family is logarithmic.
    """
    return np.log(values) if family.logarithmic else values


def moments_of(family: Family, own: Any) -> tuple[Any, Any]:
    """Find the moments of a member, or of its logarithms if the family is logarithmic.

    Parameters
    ----------
    family : Family
    own : (n,) array or tensor
        The family's unknowns.

    Returns
    -------
    mean : (d,) array or tensor
    covariance : (d, d) array or tensor
    """
    xp = namespace(own)
    mean = family.mean(own)
    sd = family.sd(own)
    covariance = constant(family.correlation(own), own) * sd[:, None] * sd[None, :]
    if not family.logarithmic:
        return mean, covariance
    # Exact for multivariate log-normals.
    covariance = xp.log1p(covariance / (mean[:, None] * mean[None, :]))
    return xp.log(mean) - 0.5 * xp.linalg.diagonal(covariance), covariance


def slopes_of_moments(family: Family, own: Array) -> tuple[Array, Array]:
    """Differentiate `moments_of` in each of the family's unknowns, by central differences.

    Parameters
    ----------
    family : Family
    own : (n,) array

    Returns
    -------
    of_mean : (n, d) array
    of_covariance : (n, d, d) array
    """
    box = family.unknowns.high - family.unknowns.low
    steps = 1e-6 * np.maximum(np.abs(own), 1e-6 * box) * np.eye(len(own))
    of_mean = []
    of_covariance = []
    for step in steps:
        mean_above, covariance_above = moments_of(family, own + step)
        mean_below, covariance_below = moments_of(family, own - step)
        width = 2 * step.sum()
        of_mean.append((mean_above - mean_below) / width)
        of_covariance.append((covariance_above - covariance_below) / width)
    return np.stack(of_mean), np.stack(of_covariance)
