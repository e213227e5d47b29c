"""What methods other than maximum likelihood record of their own search."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, Self

from dropo.core.records.fits.fit_parts import FitPart
from dropo.core.services.validation import Array


@dataclass(frozen=True, eq=False)
class SearchRecord(FitPart):
    """What a method records of its search.

    Attributes
    ----------
    target_transitions : int or None
        Control steps made on the target; None for methods that ask for none.
    entries : mapping of str to str
        Its attributes that fit.json keeps, with their keys there.
    arrays : mapping of str to str
        Its attributes that fit.npz keeps, with their names there.
    """

    _: KW_ONLY
    target_transitions: int | None = None
    entries: ClassVar[Mapping[str, str]] = {}
    arrays: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls) -> None:
        cls.keys = ("target_transitions", *cls.entries.values())
        cls.array_names = tuple(cls.arrays.values())

    def to_json(self) -> dict[str, Any]:
        asked = self.target_transitions
        found = {} if asked is None else {"target_transitions": asked}
        return found | {key: getattr(self, name) for name, key in self.entries.items()}

    def to_arrays(self) -> dict[str, Array]:
        return {key: getattr(self, name) for name, key in self.arrays.items()}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        found = {name: content[key] for name, key in cls.entries.items()}
        found |= {name: arrays[key] for name, key in cls.arrays.items()}
        return cls(**found, target_transitions=content.get("target_transitions"))


@dataclass(frozen=True, eq=False)
class IntervalHistory(SearchRecord):
    """Intervals of the parameters, one after another or drawn at random.

    Attributes
    ----------
    bounds : (n, 2, d) array
        Lower and upper ends of each, in the parameters' units.
    """

    bounds: Array
    arrays: ClassVar[Mapping[str, str]] = {"bounds": "bounds"}


@dataclass(frozen=True, eq=False)
class GaussianHistory(SearchRecord):
    """Gaussians of the parameters, one after another.

    Attributes
    ----------
    means : (n, d) array
        In the parameters' units.
    covariances : (n, d, d) array
        In their squared units.
    """

    means: Array
    covariances: Array
    arrays: ClassVar[Mapping[str, str]] = {"means": "means", "covariances": "covariances"}


@dataclass(frozen=True, eq=False)
class ReturnSearch(SearchRecord):
    """A search for the distribution that trains the best policy.

    Attributes
    ----------
    distributions : (n, m) array
        The members phi of the family that were tried.
    returns, expected : (n,) array
        The return of each on the target, and its posterior mean.
    best : float
        The largest posterior mean.
    """

    distributions: Array
    returns: Array
    expected: Array
    best: float
    entries: ClassVar[Mapping[str, str]] = {"best": "return"}
    arrays: ClassVar[Mapping[str, str]] = {
        "distributions": "laws",
        "returns": "returns",
        "expected": "expected",
    }


@dataclass(frozen=True, eq=False)
class ParticlePosterior(SearchRecord):
    """A posterior of particles.

    Attributes
    ----------
    draws : (K, d) array
        The particles drawn again by weight.
    particles : (K, d) array
        The last ones.
    weights : (K,) array
        Their weights, which sum to 1.
    powers : (n,) array
        To which the likelihood counted, one after another.
    effective_sample_size : float
        Of the weights.
    """

    draws: Array
    particles: Array
    weights: Array
    powers: Array
    effective_sample_size: float
    entries: ClassVar[Mapping[str, str]] = {"effective_sample_size": "effective_sample_size"}
    arrays: ClassVar[Mapping[str, str]] = {
        "draws": "draws",
        "particles": "particles",
        "weights": "weights",
        "powers": "powers",
    }


@dataclass(frozen=True, eq=False)
class NeuralPosterior(SearchRecord):
    """A posterior by a neural density.

    Attributes
    ----------
    draws : (K, d) array
        Of the posterior.
    boxes : (n, 2, d) array
        From which parameters were simulated, one inside another.
    density, summary : str
        The names of the density and of the summary of a simulation.
    """

    draws: Array
    boxes: Array
    density: str
    summary: str
    entries: ClassVar[Mapping[str, str]] = {"density": "density", "summary": "summary"}
    arrays: ClassVar[Mapping[str, str]] = {"draws": "draws", "boxes": "boxes"}


@dataclass(frozen=True, eq=False)
class DistanceSearch(SearchRecord):
    """A search for the smallest sum of squared distances between simulation and measurement.

    Attributes
    ----------
    squared_distance : float
        The smallest one.
    """

    squared_distance: float
    entries: ClassVar[Mapping[str, str]] = {"squared_distance": "squared_distance"}


SEARCH_RECORDS: Mapping[str, type[SearchRecord]] = {
    "adr": IntervalHistory,
    "bayrn": ReturnSearch,
    "droid": DistanceSearch,
    "epopt": ParticlePosterior,
    "npe": NeuralPosterior,
    "simopt": GaussianHistory,
    "uniform-randomization": IntervalHistory,
}
"""The record that each method makes, by the method's name."""
