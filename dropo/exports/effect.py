"""The target `effect`: the laws that a diagnosis found as an effect of one's own, in a plug-in."""

import re
from collections.abc import Sequence

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.errors import Incompatible
from dropo.exports.support.subject import Subject, Written

FILE = '''"""A law found in data, as an effect: at every place that has its variables.

    dropo diagnose PROBLEM --plugin {file}

{comment}
"""

from dataclasses import replace

from dropo.core.services.errors import InvalidInput
from dropo.core.services.registry import register
from dropo.effects.law import law_instance, places

FORMULA = {formula!r}
VARIANT = {variant!r}
SIZES = {sizes!r}


def {name}(robot):
    """The law {formula}."""
    for place in places(robot, VARIANT):
        try:
            law = law_instance(robot, place, FORMULA, VARIANT, typical=SIZES)
        except InvalidInput:  # a variable of the formula is missing there
            continue
        yield replace(law, effect={name!r}, formula="", variant="")


register("effects", {name!r}, {name})
'''


def effect(subject: Subject) -> Written:
    """Write a plug-in file for each law of an extended model.

    Parameters
    ----------
    subject : Subject

    Returns
    -------
    Written
        With the names of the effects that are left out, which the registry has.

    Raises
    ------
    Incompatible
        If the model has no law.
    """
    laws = [(one, sizes) for one, sizes in subject.around if one.formula]
    if not laws:
        raise Incompatible(
            f"{subject.name!r} has no law. The target 'effect' writes what `dropo diagnose` found "
            "as a formula."
        )
    files: dict[str, str | bytes] = {}
    for instance, sizes in laws:
        name = _name(instance)
        while f"{name}.py" in files:
            name = f"{name}_too"
        files[f"{name}.py"] = _written(name, instance, sizes.tolist())
    others = [one.label for one, _ in subject.around if not one.formula]
    left_out = tuple(f"{label} is left out: an effect of the registry." for label in others)
    return Written(files, left_out)


def _name(instance: EffectInstance) -> str:
    """The name of a law's file and effect, by the place of the law."""
    words = re.findall(r"[a-z0-9]+", str(instance.target).lower())
    return "_".join(["law", *words])


def _written(name: str, instance: EffectInstance, sizes: Sequence[float]) -> str:
    """The text of a plug-in file."""
    by_name = dict(zip([quantity.name for quantity in instance.quantities], sizes, strict=True))
    said = [f"{q.name} = {by_name[q.name]:.6g} {q.unit}" for q in instance.quantities]
    return FILE.format(
        file=f"{name}.py",
        comment=f"Found at {instance.target}: {', '.join(said)}.",
        name=name,
        formula=instance.formula,
        variant=instance.variant,
        sizes=by_name,
    )
