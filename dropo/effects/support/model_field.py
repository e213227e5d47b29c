"""Effects that change one field of the model, at each element or at all of them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import Joint

PROBES = (-1.0, -0.1, 0.1, 1.0)  # in natural sizes


@dataclass(frozen=True)
class Entry:
    """A number of the model: the element's name, its place in the field, and the natural size of a
    change.
    """

    name: str
    place: tuple[int, ...]
    size: float


@dataclass(frozen=True)
class Field:
    """A field of the model, in which an effect changes a quantity of that unit, by at most `reach`
    natural sizes.
    """

    effect: str
    field: str
    quantity: str
    reach: float = 10.0

    def instances(
        self, model: Any, entries: Sequence[Entry], unit: str, together: str
    ) -> Iterator[EffectInstance]:
        """One atom for each entry, and one for all of them alike, whose variant is called
        `together`.
        """
        for entry in entries:
            yield EffectInstance(
                self.effect,
                entry.name,
                (self._number(model, [entry], unit),),
                model=self.change([entry]),
            )
        if len(entries) > 1:
            yield EffectInstance(
                self.effect,
                None,
                (self._number(model, entries, unit),),
                together,
                model=self.change(entries),
            )

    def change(self, entries: Sequence[Entry]) -> Callable[[Any, Array], None]:
        """A model hook that adds sizes[0] to the entries."""
        return partial(_add, self.field, tuple(entry.place for entry in entries))

    def _number(self, model: Any, entries: Sequence[Entry], unit: str) -> Quantity:
        base = min(float(getattr(model, self.field)[entry.place]) for entry in entries)
        size = min(entry.size for entry in entries)
        low = -min(base, self.reach * size)  # none of these fields can become negative
        probes = tuple(share * size for share in PROBES if share * size >= low)
        return Quantity(self.quantity, unit, low, self.reach * size, probes, base=base)


def by_kind(joints: Sequence[Joint]) -> list[tuple[str, list[Joint]]]:
    """Hinges and slides apart, since a sum over metres and radians means nothing."""
    hinges = [joint for joint in joints if joint.kind == "hinge"]
    slides = [joint for joint in joints if joint.kind == "slide"]
    return [(name, same) for name, same in (("hinges", hinges), ("slides", slides)) if same]


def _add(field: str, places: Sequence[tuple[int, ...]], model: Any, magnitudes: Array) -> None:
    for place in places:
        getattr(model, field)[place] += magnitudes[0]
