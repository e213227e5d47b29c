"""The key `effects` of a problem file: what the machine has and MJCF has no element for, with its sizes."""

from typing import Any

import numpy as np

from dropo.core.catalogue import find, names
from dropo.core.checks import Array
from dropo.core.effect import Atom, Robot
from dropo.data.entries import Entries

KEYS = ("effect", "target", "variant", "sizes")


def read_effects(entries: Entries, robot: Robot) -> list[tuple[Atom, Array]]:
    """The atoms that a problem file names, with their sizes."""
    value = entries.content.get("effects", [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise entries.bad("effects", "a list of mappings with effect, target and sizes")
    return [_effect(Entries(entries.path, item, KEYS, f"effects[{i}]."), robot) for i, item in enumerate(value)]


def _effect(entry: Entries, robot: Robot) -> tuple[Atom, Array]:
    name = entry.known("effect", entry.content.get("effect"), names("effects"), "an effect")
    target, variant = entry.content.get("target"), entry.content.get("variant", "")
    every = [atom for atom in find("effects", name)(robot) if atom.variant == variant]
    if not every:
        raise entry.bad("variant", f"one of {sorted({a.variant for a in find('effects', name)(robot)})}")
    places = {str(atom.target) if atom.target is not None else "": atom for atom in every}
    atom = places[entry.known("target", "" if target is None else target, places, f"a place of {name}")]
    level = entry.level("sizes", [q.name for q in atom.quantities], "a mapping from quantities to sizes")
    return atom, np.array([level.number(q.name) for q in atom.quantities])


def effect_entry(atom: Atom, sizes: Array) -> dict[str, Any]:
    """What `read_effects` reads."""
    entry: dict[str, Any] = {"effect": atom.effect, "target": atom.target}
    if atom.variant:
        entry["variant"] = atom.variant
    return {**entry, "sizes": {q.name: float(size) for q, size in zip(atom.quantities, sizes, strict=True)}}
