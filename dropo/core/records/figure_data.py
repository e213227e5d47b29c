"""The numbers behind the figures of a diagnosis, as diagnosis.json keeps them."""

from dataclasses import asdict, dataclass
from typing import Any

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Bar:
    """An effect that was tried in a round of the search.

    Attributes
    ----------
    label : str
        The effect.
    gain, error : float or None
        The gain on held-out data and its standard error [nats], before the accepted effect is
        fitted to the end; None where it was not refitted, since its response is that of another.
    accepted : bool
        Whether it was accepted.
    told : bool
        Whether the data distinguish it from the effect that was accepted.
    """

    label: str
    gain: float | None
    error: float | None
    accepted: bool
    told: bool


@dataclass(frozen=True)
class AgainstAxis:
    """Errors of the signal in which an effect shows most, over the quantity that it depends on.

    Attributes
    ----------
    label : str
        The effect.
    axis, axis_unit : str
        The quantity and its unit.
    signal, unit : str
        The signal and its unit.
    x : tuple of float
        The quantity in each held-out window.
    before, after : tuple of float
        The error at each window's end without the effect, and with all that were accepted.
    """

    label: str
    axis: str
    axis_unit: str
    signal: str
    unit: str
    x: Numbers
    before: Numbers
    after: Numbers


@dataclass(frozen=True)
class Sizes:
    """An effect's magnitude in quarters of the data by a variable; a true cause has one magnitude.

    Attributes
    ----------
    label : str
        The effect.
    variable : str
        The variable by which the data are divided.
    at : tuple of float
        Its median in each quarter.
    size, error : tuple of float
        The magnitude in each quarter and its standard error, in units of that in all data.
    p_value : float
        Of one magnitude in all quarters, for this variable alone.
    """

    label: str
    variable: str
    at: Numbers
    size: Numbers
    error: Numbers
    p_value: float


@dataclass(frozen=True)
class Forces:
    """Random forces at each degree of freedom that would explain the residuals.

    They are drawn anew in each control step.

    Attributes
    ----------
    names, units : tuple of str
        Of the degrees of freedom.
    before, after : tuple of float
        Standard deviations without the effects, and with all that were accepted.
    there_before, there_after : bool
        Whether such forces are significant.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    before: Numbers
    after: Numbers
    there_before: bool
    there_after: bool


@dataclass(frozen=True)
class Similarity:
    """How similar the responses of the most promising effects are.

    Attributes
    ----------
    labels : tuple of str
        The effects.
    cosines : tuple of tuple of float
        |cosine| between their whitened responses: 1 where the data cannot distinguish them.
    """

    labels: tuple[str, ...]
    cosines: tuple[Numbers, ...]


@dataclass(frozen=True)
class Sums:
    """Cumulative scores of an effect's magnitude over the held-out windows, in order.

    They are scaled to a Brownian bridge, which ends where it begins. A magnitude that changes at
    one time makes a peak there; where nothing changes, one in twenty leaves +-1.36.

    Attributes
    ----------
    label : str
        The effect.
    time : tuple of float
        Fraction of the data so far.
    score : tuple of float
        The cumulative scores.
    """

    label: str
    time: Numbers
    score: Numbers


@dataclass(frozen=True)
class LawCurve:
    """The force at a joint that a law stands for, as the data have it without the law.

    Attributes
    ----------
    label : str
        The law.
    axis, axis_unit : str
        The variable that it depends on, and its unit.
    unit : str
        Of the force.
    x : tuple of float
        The mean of the variable in each part of the data.
    force, error : tuple of float
        The force there and its standard error.
    law : tuple of float
        The law's.
    """

    label: str
    axis: str
    axis_unit: str
    unit: str
    x: Numbers
    force: Numbers
    error: Numbers
    law: Numbers


@dataclass(frozen=True)
class FigureData:
    """All numbers behind the figures of a diagnosis but the motion, which `Predictions` keep.

    Attributes
    ----------
    needed : float
        The gain that confirms an effect [nats].
    rounds : tuple of tuple of Bar
        The effects that were tried in each round.
    axes : tuple of AgainstAxis
        For each accepted effect.
    sizes : tuple of Sizes
        For each accepted effect and variable.
    forces : Forces
        What is left.
    similarity : Similarity
        Of the most promising effects.
    sums : tuple of Sums
        For each accepted effect.
    laws : tuple of LawCurve
        For each accepted law.
    """

    needed: float
    rounds: tuple[tuple[Bar, ...], ...]
    axes: tuple[AgainstAxis, ...]
    sizes: tuple[Sizes, ...]
    forces: Forces
    similarity: Similarity
    sums: tuple[Sums, ...]
    laws: tuple[LawCurve, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Give plain numbers of seven digits.

        Returns
        -------
        dict
            Numbers of seven digits.
        """
        found = _rounded(asdict(self))
        assert isinstance(found, dict)
        return found

    @classmethod
    def from_json(cls, kept: dict[str, Any]) -> "FigureData":
        """Read what `to_json` gave.

        Parameters
        ----------
        kept : dict
            The entry of diagnosis.json.

        Returns
        -------
        FigureData
        """
        kinds: dict[str, Any] = {
            "axes": AgainstAxis,
            "sizes": Sizes,
            "sums": Sums,
            "laws": LawCurve,
        }
        lists = {
            name: tuple(kind(**_tuples(one)) for one in kept.get(name, ()))
            for name, kind in kinds.items()
        }
        rounds = tuple(tuple(Bar(**bar) for bar in one) for one in kept["rounds"])
        forces = Forces(**_tuples(kept["forces"]))
        alike = Similarity(**_tuples(kept["similarity"]))
        return cls(needed=kept["needed"], rounds=rounds, forces=forces, similarity=alike, **lists)


def _rounded(value: Any) -> Any:
    """Nested lists and dicts with numbers of seven digits."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


def _tuples(value: Any) -> Any:
    """Nested lists as tuples."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
