"""The key `effects` of a problem file: what the machine has and MJCF has no element for, with its sizes or to be fitted."""

from dataclasses import replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import Atom, Robot
from dropo.core.services.registry import find, names
from dropo.core.services.strict_yaml import Entries
from dropo.core.services.validation import Array

KEYS = ("effect", "target", "variant", "sizes", "fit")


def read_effects(entries: Entries, robot: Robot) -> tuple[list[Atom], list[tuple[Atom, Array]]]:
    """The atoms that a problem file names: those to be fitted, within the bounds given, and the others with their sizes."""
    value = entries.content.get("effects", [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise entries.bad("effects", "a list of mappings with effect, target, and sizes or fit")
    free, fixed = list[Atom](), list[tuple[Atom, Array]]()
    for i, item in enumerate(value):
        entry = Entries(entries.path, item, KEYS, f"effects[{i}].")
        atom = _atom(entry, robot)
        if ("sizes" in entry) == ("fit" in entry):
            raise entry.bad("sizes", "either sizes, or fit with bounds for every quantity", "both" if "fit" in entry else "neither")
        if "fit" in entry:
            free.append(_bounded(atom, entry))
        else:
            level = entry.level("sizes", [q.name for q in atom.quantities], "a mapping from quantities to sizes")
            fixed.append((atom, np.array([level.number(q.name) for q in atom.quantities])))
    return free, fixed


def _bounded(atom: Atom, entry: Entries) -> Atom:
    """The atom with the bounds of `fit`."""
    level = entry.level("fit", [q.name for q in atom.quantities], "a mapping from quantities to [low, high]")
    found = []
    for q in atom.quantities:
        bounds = level.content.get(q.name)
        expected = f"[low, high] between {q.low:g} and {q.high:g} {q.unit}".rstrip()
        pair = bounds if isinstance(bounds, list) and len(bounds) == 2 and all(type(x) in (int, float) for x in bounds) else (0.0, 0.0)
        if not q.low <= pair[0] < pair[1] <= q.high:
            raise level.bad(q.name, expected)
        found.append(replace(q, low=float(pair[0]), high=float(pair[1])))
    return replace(atom, quantities=tuple(found))


def _atom(entry: Entries, robot: Robot) -> Atom:
    name = entry.known("effect", entry.content.get("effect"), names("effects"), "an effect")
    target, variant = entry.content.get("target"), entry.content.get("variant", "")
    every = [atom for atom in find("effects", name)(robot) if atom.variant == variant]
    if not every:
        raise entry.bad("variant", f"one of {sorted({a.variant for a in find('effects', name)(robot)})}")
    places = {str(atom.target) if atom.target is not None else "": atom for atom in every}
    return places[entry.known("target", "" if target is None else target, places, f"a place of {name}")]


def effect_entry(atom: Atom, sizes: Array | None = None) -> dict[str, Any]:
    """What `read_effects` reads, with sizes, or without them to be fitted."""
    entry: dict[str, Any] = {"effect": atom.effect, "target": atom.target}
    if atom.variant:
        entry["variant"] = atom.variant
    if sizes is None:
        return {**entry, "fit": {q.name: [float(q.low), float(q.high)] for q in atom.quantities}}
    return {**entry, "sizes": {q.name: float(size) for q, size in zip(atom.quantities, sizes, strict=True)}}
