"""The log-likelihood of the parameters, and of their spread from group to group of runs."""

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.numerics.array_api import is_tensor
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.likelihoods.linear import coordinates, moments_of, slopes_of_moments
from dropo.likelihoods.support.runs.condensed import Condensed
from dropo.likelihoods.support.runs.linearization import Columns


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
    columns : Columns
        T instants, of which a run's first counts to the row behind it.
    group : (P,) array of int
        The group of each piece: 0, 1, ...
    centre : (d,) array
        Parameters.
    epsilon : (m,) array
        Noise variances, for `epsilon`.
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
        columns: Columns,
        group: Ints,
        centre: Array,
        epsilon: Array,
        whitened: Array | None = None,
    ):
        self.family = family
        self.unknowns = family.unknowns
        self.centre = coordinates(family, centre)
        self._epsilon = epsilon
        self.whitened = whitened
        # In the coordinates of the family: logarithms, or the parameters as they are.
        unit = centre if family.logarithmic else np.ones_like(centre)
        count = int(columns.row.max()) + 1
        self.row_scores = _by_row(condensed.scores * unit, columns, count)
        self.row_values = _by_row(condensed.values[:, None], columns, count)[:, 0]
        self.group_of_row = np.empty(count, dtype=np.int64)
        self.group_of_row[columns.row] = group[columns.piece]
        groups = int(group.max()) + 1
        self.scores = np.zeros((groups, len(centre)))
        np.add.at(self.scores, self.group_of_row, self.row_scores)
        self.information = np.zeros((groups, len(centre), len(centre)))
        np.add.at(self.information, group, condensed.information * np.outer(unit, unit))
        self.rows_of_group = np.bincount(self.group_of_row, minlength=groups)
        self.slopes, self.predicted = profiled(columns, columns.matrix, condensed)
        self.slopes = self.slopes * unit

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
        return self._epsilon

    def mean(self, phi: Array) -> Array:
        """Return the prediction (R, m) at the mean, from the best starts."""
        own = self.family.mean(phi[: len(self.family.unknowns)])
        return self.predict(own[None])[0]

    def predict(self, values: Array) -> Array:
        """Return predictions (K, R, m) at values (K, d), each from the best starts."""
        away = coordinates(self.family, values) - self.centre
        return self.predicted + np.moveaxis(self.slopes @ away.T, -1, 0)

    def _of_groups(self, phi: Array) -> tuple[Array, Array, Array]:
        """Values (G,) beside those of the centre, scores of the mean (G, d), (I + H S)^-1."""
        mean, spread = moments_of(self.family, phi[: len(self.family.unknowns)])
        away = mean - self.centre
        h = self.information
        u = self.scores - h @ away
        inner = np.linalg.inv(np.eye(len(away)) + h @ spread)  # (G, d, d)
        gain = spread @ inner
        value = self.scores @ away - 0.5 * (h @ away) @ away
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
        moved = self.information @ (mean - self.centre)
        plain = self.row_scores - moved[self.group_of_row] * share[:, None]
        rows = (inner[self.group_of_row] @ plain[:, :, None])[:, :, 0]
        scatter = v[:, :, None] * v[:, None] - precision
        by_spread = 0.5 * np.einsum("gde,nde->gn", scatter, of_spread)
        scores = rows @ of_mean.T + by_spread[self.group_of_row] * share[:, None]

        turned = np.einsum("gab,nbc->gnac", precision, of_spread)
        information = of_mean @ precision.sum(axis=0) @ of_mean.T
        information = information + 0.5 * np.einsum("gnab,gkba->nk", turned, turned)
        return float(self.row_values.sum() + value.sum()), scores, information


def _by_row(values: Array, columns: Columns, count: int) -> Array:
    """(R, k) sums of instants (T, k) by the row that they count to."""
    out = np.zeros((count, values.shape[1]))
    np.add.at(out, columns.row, values)
    return out


def profiled(columns: Columns, matrix: Array, condensed: Condensed) -> tuple[Array, Array]:
    """Follow the best starts.

    Parameters
    ----------
    columns : Columns
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
