"""Two clusters of parameters, as of machines from two batches."""

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.family import Family, clip_to_open_interval, means_and_scales
from dropo.core.numerics.array_api import is_tensor
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array


class Mixture(Family):
    """A mixture of two Gaussians with the same independent scales.

    With scales of their own, the likelihood of two clusters has no maximum: it grows without bound
    where one of them shrinks onto a single group of recordings.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.

    Attributes
    ----------
    smallest_weight : float
        Least probability of either cluster.

    Notes
    -----
    xi ~ (1 - w) N(mean - w gap, diag(scale^2)) + w N(mean + (1 - w) gap, diag(scale^2)), so that
    the mean is the mean of the whole, and its covariance diag(scale^2) + w (1 - w) gap gap'. The
    unknown "weight" is w, and "gap.<parameter>" by how much the second cluster's mean is larger.

    References
    ----------
    McLachlan and Peel, Finite Mixture Models (2000), section 3.8.1, for the unbounded likelihood.
    """

    smallest_weight = 0.02

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        weight = Parameter("weight", self.smallest_weight, 1 - self.smallest_weight)
        gaps = [Parameter(f"gap.{p.name}", -p.width, p.width, p.unit) for p in space]
        self.unknowns = ParameterSpace((*means_and_scales(space), weight, *gaps))

    def weights(self, phi: Array) -> Array:
        """Give the probability of each cluster.

        Parameters
        ----------
        phi : (m,) array
            The member.

        Returns
        -------
        (2,) array
        """
        weight = float(phi[2 * len(self.space)])
        return np.array([1 - weight, weight])

    def centres(self, phi: Array) -> Array:
        """Give the mean of each cluster.

        Parameters
        ----------
        phi : (m,) array
            The member.

        Returns
        -------
        (2, d) array
            In the parameters' units.
        """
        first, second = self.weights(phi)
        away = np.array([-second, first])[:, None]
        return np.asarray(self.mean(phi) + away * self._gap(phi))

    def _gap(self, phi: Array) -> Array:
        """By how much the second cluster's mean is larger (d,)."""
        return phi[2 * len(self.space) + 1 :]

    def _draw(self, phi: Array, base: Array) -> Array:
        if is_tensor(phi):
            raise Incompatible(
                "Mixture gives no gradients: which cluster a draw belongs to jumps with the weight."
                " Use an optimizer without gradients, such as 'cma-es'."
            )
        # The first coordinate says which cluster; where it is in its share, also where there.
        first, second = self.weights(phi)
        in_second = base[:, 0] >= first
        within = base.copy()
        within[:, 0] = np.where(in_second, (base[:, 0] - first) / second, base[:, 0] / first)
        centre = self.centres(phi)[in_second.astype(int)]
        return np.asarray(centre + self.scale(phi) * NORMAL.quantile(clip_to_open_interval(within)))

    def _infeasible(self, values: Array) -> NDArray[np.bool_]:
        rows = super()._infeasible(values).any(axis=1, keepdims=True)
        return np.broadcast_to(rows, values.shape)

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,) of both clusters together."""
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,) of both clusters together."""
        return np.sqrt(np.diagonal(self._covariance(phi)))

    def correlation(self, phi: Array) -> Array:
        """Returns the correlation matrix (d, d), which comes from the clusters being apart."""
        sd = self.sd(phi)
        return np.asarray(self._covariance(phi) / np.outer(sd, sd))

    def _covariance(self, phi: Array) -> Array:
        """The covariance (d, d) of both clusters together."""
        first, second = self.weights(phi)
        gap = self._gap(phi)
        return np.asarray(np.diag(self.scale(phi) ** 2) + first * second * np.outer(gap, gap))
