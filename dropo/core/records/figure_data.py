"""What the pictures of a diagnosis are drawn from, in plain numbers: kept in diagnosis.json."""

from dataclasses import asdict, dataclass
from typing import Any

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Bar:
    """An effect that was tried in a round of the search: nats gained on data held out, with their
    standard error, before the accepted one is fitted to the end; None where it was not refitted,
    since its response is that of the effect named. told: whether the data can tell it from the
    effect that was accepted.
    """

    label: str
    gain: float | None
    error: float | None
    accepted: bool
    told: bool


@dataclass(frozen=True)
class AgainstAxis:
    """The errors of the signal in which an effect shows most, over what the effect acts on. x: its
    value in each window held out; before, after: the error at the window's end without the
    effect, and with all that was accepted.
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
    """An effect's size estimated anew in quarters of the data by a variable, as multiples of the
    whole's; a true cause has one size. at: the variable's median in each part; error: standard
    errors; p_value: of one size in all of them, this variable alone.
    """

    label: str
    variable: str
    at: Numbers
    size: Numbers
    error: Numbers
    p_value: float


@dataclass(frozen=True)
class Forces:
    """Standard deviations of random forces at each degree of freedom, anew in each control step,
    that would explain what is left.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    before: Numbers
    after: Numbers
    there_before: bool
    there_after: bool


@dataclass(frozen=True)
class Similarity:
    """|cosine| between the whitened responses of the effects that promised most: 1 where the data
    cannot tell them apart.
    """

    labels: tuple[str, ...]
    cosines: tuple[Numbers, ...]


@dataclass(frozen=True)
class Sums:
    """The scores of an effect's size summed over the windows held out, in order, as a bridge that
    ends where it begins: a size that changes at a moment makes a peak there. time: the share of
    the data so far; beyond +-1.36 once in twenty where nothing changes.
    """

    label: str
    time: Numbers
    score: Numbers


@dataclass(frozen=True)
class FigureData:
    """Everything but the motion itself, which `Predictions` keep. needed: the nats that confirm an
    effect.
    """

    needed: float
    rounds: tuple[tuple[Bar, ...], ...]
    axes: tuple[AgainstAxis, ...]
    sizes: tuple[Sizes, ...]
    forces: Forces
    similarity: Similarity
    sums: tuple[Sums, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, of seven digits."""
        found = _rounded(asdict(self))
        assert isinstance(found, dict)
        return found

    @classmethod
    def from_json(cls, kept: dict[str, Any]) -> "FigureData":
        """What `to_json` gave."""
        kinds: dict[str, Any] = {"axes": AgainstAxis, "sizes": Sizes, "sums": Sums}
        lists = {
            name: tuple(kind(**_tuples(entry)) for entry in kept[name])
            for name, kind in kinds.items()
        }
        rounds = tuple(tuple(Bar(**bar) for bar in one) for one in kept["rounds"])
        forces = Forces(**_tuples(kept["forces"]))
        alike = Similarity(**_tuples(kept["similarity"]))
        return cls(needed=kept["needed"], rounds=rounds, forces=forces, similarity=alike, **lists)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
