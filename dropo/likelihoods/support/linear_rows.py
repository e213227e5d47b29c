"""Rows whose predictions are linear in the parameters, or in their logarithms."""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings, row_blocks
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.likelihoods.support.axial import Axial, along_parameters
from dropo.likelihoods.support.gaussian_rows import (
    GaussianRows,
    MomentJacobian,
    Parts,
    parts_of_columns,
)
from dropo.likelihoods.support.member_moments import coordinates, moments_of, slopes_of_moments


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
        self, member: Any, slopes: Any, rows: slice, whiten: Array, z: Array, noise: MomentJacobian
    ) -> Parts:
        by_mean, entries = slopes
        slope = whiten @ self.axial.slope[rows]
        a, b = entries.pairs(slope)
        return parts_of_columns(
            z, MomentJacobian(slope, by_mean, a, b, entries.weights).beside(noise)
        )


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
