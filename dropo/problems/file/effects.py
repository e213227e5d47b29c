"""The key `effects` of a problem file: what MJCF has no element for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, instances_of
from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_content import FileContent, describe_options, describe_value
from dropo.core.services.registry import HINT, names
from dropo.core.services.validation import Array
from dropo.effects.law import law_instance
from dropo.problems.file.schema import EffectEntry, ProblemFile

LAW = "law"
"""The effect that a formula makes."""
EITHER = "either sizes, or fit with bounds for every quantity"


def read_effects(
    file: FileContent[ProblemFile], robot: EffectContext
) -> tuple[list[EffectInstance], list[tuple[EffectInstance, Array]]]:
    """Find the effects that a problem file names.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    robot : EffectContext
        What the effects may belong to.

    Returns
    -------
    free, fixed
        The effects to be fitted, within the bounds given, and the others with their sizes.

    Raises
    ------
    BadFile
        If there is no such effect, place, variant or quantity, or bounds are not possible.
    """
    free: list[EffectInstance] = []
    fixed: list[tuple[EffectInstance, Array]] = []
    for i, entry in enumerate(file.content.effects):
        key = f"effects[{i}]"
        instance = _find_effect(file, key, entry, robot)
        if (entry.sizes is None) == (entry.fit is None):
            got = "neither" if entry.fit is None else "both"
            raise file.refusal(f"{key}.sizes", EITHER, got)
        if entry.fit is not None:
            free.append(_bound(file, f"{key}.fit", entry.fit, instance))
        elif entry.sizes is not None:
            fixed.append((instance, _read_sizes(file, f"{key}.sizes", entry.sizes, instance)))
    return free, fixed


def make_effect_entry(instance: EffectInstance, sizes: Array | None = None) -> EffectEntry:
    """Make the entry that `read_effects` reads as an effect.

    Parameters
    ----------
    instance : EffectInstance
        The effect at its place.
    sizes : Array or None
        Its sizes; by default it is to be fitted within the bounds of its quantities.

    Returns
    -------
    EffectEntry
        An entry of `effects`.
    """
    content: dict[str, object] = {"effect": instance.effect, "target": instance.target}
    if instance.variant:
        content["variant"] = instance.variant
    if instance.formula:
        content["formula"] = instance.formula
    if sizes is None:
        content["fit"] = {q.name: [float(q.low), float(q.high)] for q in instance.quantities}
    else:
        pairs = zip(instance.quantities, sizes, strict=True)
        content["sizes"] = {q.name: float(size) for q, size in pairs}
    return EffectEntry.model_validate(content)


def _find_effect(
    file: FileContent[ProblemFile], key: str, entry: EffectEntry, robot: EffectContext
) -> EffectInstance:
    """The effect of that name and variant at its place."""
    name = entry.effect
    valid = names("effects")
    if name not in valid:
        expected = describe_options("an effect", name, valid)
        raise BadFile(file.path, f"{key}.effect", expected, describe_value(name), HINT)
    if (name == LAW) != bool(entry.formula):
        expected = "a formula" if name == LAW else f"no formula, which the effect {LAW} has"
        raise file.refusal(f"{key}.formula", expected, describe_value(entry.formula or None))
    if entry.formula:
        return _find_law(file, key, entry, robot)
    with file.at(f"{key}.effect"):
        every = instances_of(robot, name)
    alike = [instance for instance in every if instance.variant == entry.variant]
    if not alike:
        variants = sorted({instance.variant for instance in every})
        got = describe_value(entry.variant or None)
        raise file.refusal(f"{key}.variant", f"one of {variants}", got)
    places = {instance.target or "": instance for instance in alike}
    target = file.require_known(f"{key}.target", entry.target or "", places, f"a place of {name}")
    return places[target]


def _find_law(
    file: FileContent[ProblemFile], key: str, entry: EffectEntry, robot: EffectContext
) -> EffectInstance:
    """The effect of a formula, whose constants are the names of sizes or bounds."""
    if entry.sizes is not None:
        typical = dict(entry.sizes)
    else:
        typical = {name: max(map(abs, pair)) for name, pair in (entry.fit or {}).items()}
    with file.at(f"{key}.formula"):
        return law_instance(
            robot,
            entry.target,
            entry.formula,
            entry.variant,
            constants=list(typical),
            typical=typical,
        )


def _require_quantities(
    file: FileContent[ProblemFile], key: str, given: Sequence[str], instance: EffectInstance
) -> None:
    """Refuse names that are no quantities of an effect."""
    quantities = [quantity.name for quantity in instance.quantities]
    for name in given:
        if name not in quantities:
            expected = describe_options("a known key", name, quantities)
            raise file.refusal(f"{key}.{name}", expected, describe_value(name))


def _read_sizes(
    file: FileContent[ProblemFile], key: str, sizes: dict[str, float], instance: EffectInstance
) -> Array:
    """The sizes of all quantities of an effect, in their order."""
    _require_quantities(file, key, list(sizes), instance)
    for quantity in instance.quantities:
        if quantity.name not in sizes:
            raise file.refusal(f"{key}.{quantity.name}", "a number", describe_value(None))
    return np.array([sizes[quantity.name] for quantity in instance.quantities])


def _bound(
    file: FileContent[ProblemFile],
    key: str,
    bounds: dict[str, list[float]],
    instance: EffectInstance,
) -> EffectInstance:
    """The effect with the bounds given for all of its quantities."""
    _require_quantities(file, key, list(bounds), instance)
    quantities: list[Quantity] = []
    for quantity in instance.quantities:
        pair = bounds.get(quantity.name)
        if pair is None or not quantity.low <= pair[0] < pair[1] <= quantity.high:
            expected = f"[low, high] between {quantity.low:g} and {quantity.high:g} {quantity.unit}"
            got = "nothing" if pair is None else f"[{pair[0]:g}, {pair[1]:g}]"
            raise file.refusal(f"{key}.{quantity.name}", expected.rstrip(), got)
        quantities.append(replace(quantity, low=pair[0], high=pair[1]))
    return replace(instance, quantities=tuple(quantities))
