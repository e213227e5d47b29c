"""The key `effects` of a problem file: what the machine has and MJCF has no element for, with its
sizes or to be fitted.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.core.services.registry import find, names
from dropo.core.services.strict_yaml import Entries
from dropo.core.services.validation import Array

KEYS = ("effect", "target", "variant", "sizes", "fit")


def read_effects(
    entries: Entries, robot: EffectContext
) -> tuple[list[EffectInstance], list[tuple[EffectInstance, Array]]]:
    """The atoms that a problem file names: those to be fitted, within the bounds given, and the
    others with their sizes.
    """
    value = entries.content.get("effects", [])
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise entries.bad("effects", "a list of mappings with effect, target, and sizes or fit")
    free = list[EffectInstance]()
    fixed = list[tuple[EffectInstance, Array]]()
    for i, item in enumerate(value):
        entry = Entries(entries.path, item, KEYS, f"effects[{i}].")
        instance = _atom(entry, robot)
        if ("sizes" in entry) == ("fit" in entry):
            raise entry.bad(
                "sizes",
                "either sizes, or fit with bounds for every quantity",
                "both" if "fit" in entry else "neither",
            )
        if "fit" in entry:
            free.append(_bounded(instance, entry))
        else:
            level = entry.level(
                "sizes", [q.name for q in instance.quantities], "a mapping from quantities to sizes"
            )
            fixed.append((instance, np.array([level.number(q.name) for q in instance.quantities])))
    return free, fixed


def _bounded(instance: EffectInstance, entry: Entries) -> EffectInstance:
    """The atom with the bounds of `fit`."""
    level = entry.level(
        "fit", [q.name for q in instance.quantities], "a mapping from quantities to [low, high]"
    )
    found = []
    for q in instance.quantities:
        bounds = level.content.get(q.name)
        expected = f"[low, high] between {q.low:g} and {q.high:g} {q.unit}".rstrip()
        pair = (
            bounds
            if isinstance(bounds, list)
            and len(bounds) == 2
            and all(type(x) in (int, float) for x in bounds)
            else (0.0, 0.0)
        )
        if not q.low <= pair[0] < pair[1] <= q.high:
            raise level.bad(q.name, expected)
        found.append(replace(q, low=float(pair[0]), high=float(pair[1])))
    return replace(instance, quantities=tuple(found))


def _atom(entry: Entries, robot: EffectContext) -> EffectInstance:
    name = entry.known("effect", entry.content.get("effect"), names("effects"), "an effect")
    target = entry.content.get("target")
    variant = entry.content.get("variant", "")
    every = [instance for instance in find("effects", name)(robot) if instance.variant == variant]
    if not every:
        raise entry.bad(
            "variant", f"one of {sorted({a.variant for a in find('effects', name)(robot)})}"
        )
    places = {
        str(instance.target) if instance.target is not None else "": instance for instance in every
    }
    return places[
        entry.known("target", "" if target is None else target, places, f"a place of {name}")
    ]


def effect_entry(instance: EffectInstance, sizes: Array | None = None) -> dict[str, Any]:
    """What `read_effects` reads, with sizes, or without them to be fitted."""
    entry: dict[str, Any] = {"effect": instance.effect, "target": instance.target}
    if instance.variant:
        entry["variant"] = instance.variant
    if sizes is None:
        return {
            **entry,
            "fit": {q.name: [float(q.low), float(q.high)] for q in instance.quantities},
        }
    return {
        **entry,
        "sizes": {q.name: float(size) for q, size in zip(instance.quantities, sizes, strict=True)},
    }
