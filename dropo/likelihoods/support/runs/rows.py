"""The log-likelihood of the parameters, and of their spread from group to group of runs."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.numerics.array_api import is_tensor
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.support.member_moments import coordinates, moments_of, slopes_of_moments
from dropo.likelihoods.support.runs.condensed import Condensed
from dropo.likelihoods.support.runs.linearization import LinearizedInstants
from dropo.likelihoods.support.runs.noise_levels import NoiseDistribution, whiten


class RunRows(LocalLogLikelihood):
    """Rows of runs that are quadratic in the parameters, with starts eliminated.

    Each group of runs has one draw of the parameters from N(mean, S), which is integrated out:
    with H the group's information, u its score at the mean,
    log p = l(mean) + u' P u / 2 - log|I + H S| / 2 with P = S (I + H S)^-1.

    Parameters
    ----------
    family : Family
    condensed : Condensed
        Around the centre.
    columns : LinearizedInstants
        T instants, of which a run's first counts to the row behind it.
    group : (P,) array of int
        The group of each piece: 0, 1, ...
    centre : (d,) or (G, d) array
        Parameters, those of all groups or of each.
    noise : NoiseDistribution
        Of the noise.
    whitened : (R, m) array, optional
        Whitened residuals, where the noise was given.

    Attributes
    ----------
    unexplained : tuple of (R, m) and (R, m, d) array, or None
        What is new in the residuals of each row, with slopes along the best starts, where noise has
        a memory.
    """

    errors_from_model = True
    unexplained: tuple[Array, Array] | None = None

    def __init__(
        self,
        family: Family,
        condensed: Condensed,
        columns: LinearizedInstants,
        group: Ints,
        centre: Array,
        noise: NoiseDistribution,
        whitened: Array | None = None,
    ):
        self.family = family
        self.unknowns = family.unknowns
        groups = int(group.max()) + 1
        centre = np.broadcast_to(centre, (groups, centre.shape[-1]))
        self.centre = coordinates(family, centre)  # (G, d)
        self.columns = columns
        self.noise = noise
        self.whitened = whitened
        # In the coordinates of the family: logarithms, or the parameters as they are.
        unit = centre if family.logarithmic else np.ones_like(centre)
        count = int(columns.row.max()) + 1
        self.row_scores = _by_row(condensed.scores * unit[group[columns.piece]], columns, count)
        self.row_values = _by_row(condensed.values[:, None], columns, count)[:, 0]
        self.group_of_row = np.empty(count, dtype=np.int64)
        self.group_of_row[columns.row] = group[columns.piece]
        self.scores = np.zeros(centre.shape)
        np.add.at(self.scores, self.group_of_row, self.row_scores)
        self.information = np.zeros((*centre.shape, centre.shape[1]))
        units = unit[group]
        own = condensed.information * units[:, :, None] * units[:, None]
        np.add.at(self.information, group, own)
        self.rows_of_group = np.bincount(self.group_of_row, minlength=groups)
        self.slopes, self.predicted = profiled(columns, columns.matrix, condensed)
        self.slopes = self.slopes * unit[self.group_of_row][:, None]

    def _rows(self, phi: Array) -> Array:
        if is_tensor(phi):
            raise Incompatible(
                "The likelihood 'trajectory' takes no tensors. Use 'emulated', or leave the"
                " optimizer out."
            )
        value = self._of_groups(phi)[0] / self.rows_of_group
        return np.asarray(self.row_values + value[self.group_of_row])

    def epsilon(self, phi: Array) -> Array:
        """Return the noise variances (m,) of the measured signals."""
        return self.noise.variance

    def weighed(self, phi: Array, rows: Ints, values: Array) -> Array:
        """Return values (r, m, k) without memory and size, less where a Student t's tail is."""
        instants = np.flatnonzero(~self.columns.first)[rows]
        matrix = np.zeros((*self.columns.valid.shape, values.shape[2]))
        matrix[instants] = values
        found = whiten(replace(self.columns, matrix=matrix), self.noise)
        residual = whiten(self.columns, self.noise)[:, :, -1]
        weights = np.sqrt(self.noise.weights(residual**2))
        return np.asarray((found * weights[:, :, None])[instants])

    def mean(self, phi: Array) -> Array:
        """Return the prediction (R, m) at each group's mode, from the best starts."""
        away = (self.modes(phi) - self.centre)[self.group_of_row]
        return self.predicted + (self.slopes @ away[:, :, None])[:, :, 0]

    def predict(self, values: Array) -> Array:
        """Return predictions (K, R, m) at values (K, d), each from the best starts."""
        away = coordinates(self.family, values)[:, None] - self.centre  # (K, G, d)
        moved = self.slopes @ away[:, self.group_of_row, :, None]
        return np.asarray(self.predicted + moved[..., 0])

    def modes(self, phi: Array) -> Array:
        """Estimate the groups' own parameters given all data.

        Parameters
        ----------
        phi : (m,) array
            As of `__call__`.

        Returns
        -------
        (G, d) array
            Modes, in the family's coordinates.
        """
        mean, spread = moments_of(self.family, phi[: len(self.family.unknowns)])
        v = self._of_groups(phi)[1]
        return np.asarray(mean + v @ spread)

    def _of_groups(self, phi: Array) -> tuple[Array, Array, Array]:
        """Values (G,) beside those of the centre, scores of the mean (G, d), (I + H S)^-1."""
        mean, spread = moments_of(self.family, phi[: len(self.family.unknowns)])
        away = mean - self.centre  # (G, d)
        h = self.information
        along = (h @ away[:, :, None])[:, :, 0]
        u = self.scores - along
        inner = np.linalg.inv(np.eye(len(mean)) + h @ spread)  # (G, d, d)
        gain = spread @ inner
        value = np.sum((self.scores - 0.5 * along) * away, axis=1)
        value += 0.5 * np.einsum("gd,gde,ge->g", u, gain, u)
        value += 0.5 * np.linalg.slogdet(inner)[1]
        return value, (inner @ u[:, :, None])[:, :, 0], inner

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """Evaluate the log-likelihood, the scores of its rows, and its information."""
        own = phi[: len(self.family.unknowns)]
        of_mean, of_spread = slopes_of_moments(self.family, own)
        value, v, inner = self._of_groups(phi)
        precision = inner @ self.information  # of a group's numbers about the mean
        precision = 0.5 * (precision + precision.swapaxes(1, 2))

        # Scores: of means row by row, of spreads evenly over a group's rows.
        mean = moments_of(self.family, own)[0]
        share = 1 / self.rows_of_group[self.group_of_row]
        moved = (self.information @ (mean - self.centre)[:, :, None])[:, :, 0]
        plain = self.row_scores - moved[self.group_of_row] * share[:, None]
        rows = (inner[self.group_of_row] @ plain[:, :, None])[:, :, 0]
        scatter = v[:, :, None] * v[:, None] - precision
        by_spread = 0.5 * np.einsum("gde,nde->gn", scatter, of_spread)
        scores = rows @ of_mean.T + by_spread[self.group_of_row] * share[:, None]

        turned = np.einsum("gab,nbc->gnac", precision, of_spread)
        information = of_mean @ precision.sum(axis=0) @ of_mean.T
        information = information + 0.5 * np.einsum("gnab,gkba->nk", turned, turned)
        return float(self.row_values.sum() + value.sum()), scores, information


def _by_row(values: Array, columns: LinearizedInstants, count: int) -> Array:
    """(R, k) sums of instants (T, k) by the row that they count to."""
    out = np.zeros((count, values.shape[1]))
    np.add.at(out, columns.row, values)
    return out


def profiled(
    columns: LinearizedInstants, matrix: Array, condensed: Condensed
) -> tuple[Array, Array]:
    """Follow the best starts.

    Parameters
    ----------
    columns : LinearizedInstants
    matrix : (T, m, s + d + 1) array
        Theirs, or whitened.
    condensed : Condensed

    Returns
    -------
    slopes : (R, m, d) array
        Of the predictions in the parameters, with the starts that go with them.
    predicted : (R, m) array
        Predicted less measured.
    """
    s = columns.states
    behind = np.flatnonzero(~columns.first)
    own = matrix[behind]
    follow = condensed.start_by_value[columns.piece[behind]]  # (R, s, d)
    return own[:, :, s:-1] + own[:, :, :s] @ follow, -own[:, :, -1]
