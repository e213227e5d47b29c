"""Likelihoods of groups of rows that share one draw of the parameters."""

from abc import abstractmethod
from dataclasses import dataclass

from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array


@dataclass(frozen=True, eq=False)
class Groups:
    """What the data say of each of G groups. label: (G,) its number in the data; rows: (G,) its
    compared rows; mean: (G, d) its parameters' mode under the population; precision: (G, d, d)
    the information of its own rows on them.
    """

    label: Ints
    rows: Ints
    mean: Array
    precision: Array

    def __len__(self) -> int:
        return len(self.label)


class GroupedLogLikelihood(LocalLogLikelihood):
    """Its rows are the G groups: independent of each other, each with one draw of the parameters,
    integrated out.
    """

    @abstractmethod
    def groups(self, phi: Array) -> Groups:
        """The groups under the population that phi (m,) names."""
