"""A local likelihood of which some unknowns are held, as a function of the others."""

from collections.abc import Mapping

import numpy as np

from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array


class HeldUnknowns(LocalLogLikelihood):
    """A local log-likelihood with some of its m unknowns held at values of their own.

    Parameters
    ----------
    objective : LocalLogLikelihood
        Of all unknowns.
    held : mapping of str to float
        The value of each that is held, by its name.

    Attributes
    ----------
    free : (m,) bool array
        Which unknowns of the objective are left.
    """

    def __init__(self, objective: LocalLogLikelihood, held: Mapping[str, float]):
        self.objective = objective
        names = objective.unknowns.names
        self.free = np.array([name not in held for name in names])
        self.held = np.array([held.get(name, 0.0) for name in names])
        self.unknowns = ParameterSpace(tuple(p for p in objective.unknowns if p.name not in held))

    def whole(self, phi: Array) -> Array:
        """Add the unknowns that are held.

        Parameters
        ----------
        phi : (f,) array
            The free unknowns.

        Returns
        -------
        (m,) array
            All of the objective's.
        """
        out = self.held.copy()
        out[self.free] = phi
        return out

    def maximum(self, phi: Array) -> Array:
        """Find its maximum.

        Parameters
        ----------
        phi : (m,) array
            Where the search begins, all of the objective's unknowns.

        Returns
        -------
        (f,) array
            The free unknowns.
        """
        return maximize_locally(self, phi[self.free]).phi

    def _rows(self, phi: Array) -> Array:
        return self.objective.rows(self.whole(phi))

    def epsilon(self, phi: Array) -> Array:
        return self.objective.epsilon(self.whole(phi))

    def mean(self, phi: Array) -> Array:
        return self.objective.mean(self.whole(phi))

    def predict(self, values: Array) -> Array:
        return self.objective.predict(values)

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        value, scores, information = self.objective.value_score_information(self.whole(phi))
        return value, scores[:, self.free], information[np.ix_(self.free, self.free)]
