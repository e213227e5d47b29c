"""What to type into the model's MJCF so that it has what was found."""

from collections.abc import Mapping, Sequence

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.tables import number
from dropo.diagnosis.parts import effect_in_words
from dropo.mjmodel.files.changes import changed_elements
from dropo.simulators.mujoco.model_xml import format_model, is_in_model
from dropo.simulators.mujoco.simulator import MujocoSimulator

SHOWN = 24
"""Lines to type that are printed."""


def to_type(came: Problem, found: Problem, declared: Mapping[str, float]) -> tuple[str, ...]:
    """List the elements of the MJCF that change, and what MJCF has no element for.

    Parameters
    ----------
    came : Problem
        With the model as it came.
    found : Problem
        With the model that was found.
    declared : mapping of str to float
        The declared parameters as fitted.

    Returns
    -------
    tuple of str
        A line each: an element with its new attributes and, as a comment, where it is and what it
        was. None where the simulator's model is no MJCF, or MuJoCo refuses it.
    """
    before, after = came.simulator, found.simulator
    if not isinstance(before, MujocoSimulator) or not isinstance(after, MujocoSimulator):
        return ()
    values = np.array(after.nominal, dtype=float)
    for i, name in enumerate(found.space.names):
        values[i] = declared.get(name, values[i])
    try:
        lines = list(changed_elements(format_model(before), format_model(after, values)))
    except (BadArgument, Incompatible):
        return ()
    comments = lines[::2]
    elements = lines[1::2]
    typed = [f"{new}  {where}" for where, new in zip(comments, elements, strict=True)]
    for instance, sizes in after.fixed:
        if is_in_model(instance):
            continue
        shown = [
            f"{quantity.name} {number(size, 4)} {quantity.unit}".removesuffix(" 1")
            for quantity, size in zip(instance.quantities, sizes.tolist(), strict=True)
        ]
        place = effect_in_words(instance.effect, instance.target, instance.variant)
        typed.append(f"no element of MJCF: {place}, {', '.join(shown)}")
    return tuple(typed)


def typed_lines(lines: Sequence[str]) -> list[str]:
    """Print what to type.

    Parameters
    ----------
    lines : sequence of str
        Of `to_type`.

    Returns
    -------
    list of str
        The first of them under a heading; none where there is nothing to type.
    """
    if not lines:
        return []
    shown = ["Type into the model:", *(f"  {line}" for line in lines[:SHOWN])]
    rest = len(lines) - SHOWN
    if rest > 0:
        shown.append(f"  ... and {rest} lines more, in extended/model.xml")
    return shown
