"""Effects that change one field of the model, at each element or at all of them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import Joint

PROBES = (-1.0, -0.1, 0.1, 1.0)
"""The changes that a screening tries, in natural sizes."""


@dataclass(frozen=True)
class FieldEntry:
    """A number of the model.

    Attributes
    ----------
    name : str
        The element that it belongs to.
    place : tuple of int
        Its place in the field.
    size : float
        The natural size of a change, in the field's unit.
    """

    name: str
    place: tuple[int, ...]
    size: float


@dataclass(frozen=True)
class ModelField:
    """A field of the model that an effect changes by adding to it; its numbers are never negative.

    Attributes
    ----------
    effect : str
        The name of the effect.
    field : str
        The MjModel array.
    quantity : str
        The name of what is changed.
    bound : float
        The largest change, in natural sizes.
    """

    effect: str
    field: str
    quantity: str
    bound: float = 10.0

    def instances(
        self, model: Any, entries: Sequence[FieldEntry], unit: str, common_variant: str
    ) -> Iterator[EffectInstance]:
        """Offer a change of each entry, and one of all of them alike.

        Parameters
        ----------
        model : MjModel
            The compiled model.
        entries : sequence of FieldEntry
            The numbers that can change.
        unit : str
            Their unit.
        common_variant : str
            The variant of the change of all entries, which is offered where there are several.

        Yields
        ------
        EffectInstance
        """
        for entry in entries:
            quantity = self._quantity(model, [entry], unit)
            yield EffectInstance(self.effect, entry.name, (quantity,), model=self.change([entry]))
        if len(entries) > 1:
            quantity = self._quantity(model, entries, unit)
            change = self.change(entries)
            yield EffectInstance(self.effect, None, (quantity,), common_variant, model=change)

    def change(self, entries: Sequence[FieldEntry]) -> Callable[[Any, Array], None]:
        """Make the `model` hook that adds the first magnitude to the entries.

        Parameters
        ----------
        entries : sequence of FieldEntry
            The numbers of the model that change alike.

        Returns
        -------
        callable
            Takes the model, which it changes, and the magnitudes (q,).
        """
        return partial(_add, self.field, tuple(entry.place for entry in entries))

    def _quantity(self, model: Any, entries: Sequence[FieldEntry], unit: str) -> Quantity:
        """What is added to the entries, so that the smallest of them does not become negative."""
        base = min(float(getattr(model, self.field)[entry.place]) for entry in entries)
        size = min(entry.size for entry in entries)
        low = -min(base, self.bound * size)
        probes = tuple(probe * size for probe in PROBES if probe * size >= low)
        return Quantity(self.quantity, unit, low, self.bound * size, probes, base=base)


def by_kind(joints: Sequence[Joint]) -> list[tuple[str, list[Joint]]]:
    """Separate hinges and slides, since a sum over metres and radians has no meaning.

    Parameters
    ----------
    joints : sequence of Joint
        Hinges and slides.

    Returns
    -------
    list of (str, list of Joint)
        "hinges" and "slides" with the joints of that kind; a kind without joints is left out.
    """
    hinges = [joint for joint in joints if joint.kind == "hinge"]
    slides = [joint for joint in joints if joint.kind == "slide"]
    return [(name, same) for name, same in (("hinges", hinges), ("slides", slides)) if same]


def _add(field: str, places: Sequence[tuple[int, ...]], model: Any, magnitudes: Array) -> None:
    """Adds the first magnitude to some places of a field."""
    for place in places:
        getattr(model, field)[place] += magnitudes[0]
