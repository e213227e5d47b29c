"""Least squares over a chain of states, each tied to the next, and a few numbers common to all."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from dropo.core.services.validation import Array


@dataclass(frozen=True, eq=False)
class BlockChain:
    """Normal equations of n states of s numbers, and of b numbers common to them.

    Attributes
    ----------
    diagonal : (n, s, s) array
        Information of each state.
    after : (n - 1, s, s) array
        Of each state with the next.
    border : (n, s, b) array
        Of each state with the common numbers.
    corner : (b, b) array
        Of the common numbers.
    right : (n, s) array
        Right side.
    right_corner : (b,) array
        Right side of the common numbers.
    """

    diagonal: Array
    after: Array
    border: Array
    corner: Array
    right: Array
    right_corner: Array

    @classmethod
    def zeros(cls, n: int, s: int, b: int) -> "BlockChain":
        """Make empty ones.

        Parameters
        ----------
        n, s, b : int
            Number of states, of each one's numbers, and of common numbers.

        Returns
        -------
        BlockChain
        """
        return cls(
            np.zeros((n, s, s)),
            np.zeros((n - 1, s, s)),
            np.zeros((n, s, b)),
            np.zeros((b, b)),
            np.zeros((n, s)),
            np.zeros(b),
        )

    def add_links(self, by_state: Array, by_common: Array, ahead: Array, weights: Array) -> None:
        """Add what ties states: next step = by_state step + by_common common + ahead.

        Parameters
        ----------
        by_state : (n - 1, s, s) array
        by_common : (n - 1, s, b) array
        ahead : (n - 1, s) array
            How far the motion from each state is ahead of the next one.
        weights : (n - 1, s) array
            One over the variances.
        """
        weighted = weights[:, :, None] * by_state
        weighted_common = weights[:, :, None] * by_common
        places = np.arange(weights.shape[1])
        self.diagonal[1:, places, places] += weights
        self.diagonal[:-1] += by_state.swapaxes(1, 2) @ weighted
        self.after[:] -= weighted.swapaxes(1, 2)
        self.border[1:] -= weighted_common
        self.border[:-1] += by_state.swapaxes(1, 2) @ weighted_common
        self.corner[:] += np.einsum("nsb,nsc->bc", by_common, weighted_common)
        self.right[1:] += weights * ahead
        self.right[:-1] -= np.einsum("nsj,ns->nj", weighted, ahead)
        self.right_corner[:] -= np.einsum("nsb,ns->b", weighted_common, ahead)

    def add_rows(self, by_state: Array, by_common: Array, residual: Array, weights: Array) -> None:
        """Add what is measured of single states: by_state step + by_common common = residual.

        Parameters
        ----------
        by_state : (n, m, s) array
        by_common : (n, m, b) array
        residual : (n, m) array
        weights : (n, m) array
            One over the variances; 0 where nothing was measured.
        """
        weighted = weights[:, :, None] * by_state
        self.diagonal[:] += by_state.swapaxes(1, 2) @ weighted
        self.border[:] += weighted.swapaxes(1, 2) @ by_common
        self.corner[:] += np.einsum("nmb,nm,nmc->bc", by_common, weights, by_common, optimize=True)
        self.right[:] += np.einsum("nms,nm->ns", weighted, residual)
        self.right_corner[:] += np.einsum("nmb,nm,nm->b", by_common, weights, residual)

    def solve(self) -> tuple[Array, Array]:
        """Solve them.

        Returns
        -------
        states : (n, s) array
        common : (b,) array
        """
        n, s, b = self.border.shape
        sides = np.concatenate([self.right.reshape(-1, 1), self.border.reshape(-1, b)], axis=1)
        solved = np.asarray(cho_solve_banded(self._factor(), sides))
        by_common = solved[:, 1:]
        border = self.border.reshape(-1, b)
        corner = self.corner - border.T @ by_common
        common = np.asarray(
            np.linalg.solve(corner, self.right_corner - border.T @ solved[:, 0]), dtype=float
        )
        return (solved[:, 0] - by_common @ common).reshape(n, s), common

    def deviations(self, places: Array) -> Array:
        """Compute the standard deviations of some states, the common numbers as they are.

        Parameters
        ----------
        places : (k,) int array
            Which states.

        Returns
        -------
        (k, s) array
        """
        n, s, _ = self.border.shape
        factor = self._factor()
        variances = np.empty((len(places), s))
        for i, place in enumerate(np.asarray(places).tolist()):
            rows = slice(place * s, (place + 1) * s)
            sides = np.zeros((n * s, s))
            sides[rows] = np.eye(s)
            variances[i] = np.diagonal(cho_solve_banded(factor, sides)[rows])
        return np.sqrt(variances)

    def _factor(self) -> tuple[Array, bool]:
        """The Cholesky factor of the chain alone, and that it is the lower one."""
        n, s, _ = self.border.shape
        banded = np.zeros((2 * s, n * s))
        for i in range(s):
            for j in range(i + 1):
                banded[i - j, j::s] = self.diagonal[:, i, j]
            for j in range(s):
                banded[s + i - j, j : (n - 1) * s : s] = self.after[:, j, i]
        return np.asarray(cholesky_banded(banded, lower=True)), True
