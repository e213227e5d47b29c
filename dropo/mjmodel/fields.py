"""Any number of an MjModel or its mjOption as a parameter."""

import re
from dataclasses import KW_ONLY, dataclass
from typing import Any

import mujoco
import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.core.services.validation import known, nearest
from dropo.mjmodel.names import element_names

# The kind of element that a field's row belongs to, by the field's prefix; `dof_` rows are found by
# their joint's name.
PREFIXES = {
    "body": "body",
    "jnt": "joint",
    "dof": "joint",
    "geom": "geom",
    "site": "site",
    "cam": "camera",
    "light": "light",
    "mesh": "mesh",
    "hfield": "hfield",
    "pair": "pair",
    "eq": "equality",
    "tendon": "tendon",
    "actuator": "actuator",
    "sensor": "sensor",
    "mat": "material",
}
SERVO = ("actuator_kp", "actuator_kv")
"""The gains of a position or velocity servo's loop, by name: MuJoCo keeps each in two places of
gainprm and biasprm.
"""
MOVES_FRAMES = (
    "body_ipos",
    "body_iquat",
)  # mj_setConst refuses these unless the body was compiled as not simple


@dataclass(frozen=True)
class FieldParameter(Parameter):
    """A parameter that stands for a number of the model.

    field: an MjModel array ("body_mass") or an mjOption entry ("gravity"); element: its body,
    joint, geom, ... by name, None where the field has no elements; index: the place within the
    element's row; relative: the value is a factor on the model's own number (on the whole row,
    without an index); derived: mj_setConst follows (the thesis leaves it).
    """

    _: KW_ONLY
    field: str = ""
    element: str | None = None
    index: int | None = None
    relative: bool = False
    derived: bool = True


class Binding:
    """A FieldParameter resolved against a model: sets the numbers in any copy of it."""

    def __init__(self, parameter: FieldParameter, model: mujoco.MjModel):
        self.parameter = parameter
        self._servo = _servo_places(parameter, model) if parameter.field in SERVO else []
        if self._servo:
            self._nominal = np.array(self.read(model), dtype=float)
            return
        self._in_option = parameter.field not in model_fields(model)
        if self._in_option and parameter.field not in option_fields(model):
            valid = [*model_fields(model), *option_fields(model)]
            raise UnknownName(
                f"No field of MjModel or mjOption called {parameter.field!r}. "
                f"{nearest(parameter.field, valid)}"
            )
        self._where = _entries(parameter, model, self._array(model))
        self._nominal = np.array(self.read(model), dtype=float)

    def nominal(self) -> float:
        """The parameter's value in the model as loaded."""
        return 1.0 if self.parameter.relative else float(self._nominal.flat[0])

    def set(self, model: mujoco.MjModel, value: float) -> None:
        """Writes the parameter's value into a copy of the model."""
        new = self._nominal * value if self.parameter.relative else value
        if self._servo:
            for name, place, sign in self._servo:
                getattr(model, name)[place] = sign * float(new)
            return
        array = self._array(model)
        if isinstance(array, np.ndarray):
            array[self._where] = new
        else:
            setattr(model.opt, self.parameter.field, float(new))

    def _array(self, model: mujoco.MjModel) -> Any:
        return getattr(model.opt if self._in_option else model, self.parameter.field)

    def read(self, model: mujoco.MjModel) -> Any:
        """The numbers that it stands for, in a copy of the model."""
        if self._servo:
            name, place, sign = self._servo[0]
            return sign * getattr(model, name)[place]
        array = self._array(model)
        return array[self._where] if isinstance(array, np.ndarray) else array


def _servo_places(
    parameter: FieldParameter, model: mujoco.MjModel
) -> list[tuple[str, tuple[int, int], float]]:
    """The arrays, places and signs of a servo's gain: of a position servo kp (and kv, its damping),
    of a velocity servo kv.
    """
    rows = _rows(parameter, model)
    i = 0 if rows is None else rows[0]
    gain = model.actuator_gainprm[i]
    bias = model.actuator_biasprm[i]
    position = bias[1] == -gain[0] != 0
    velocity = bias[1] == 0 and bias[2] == -gain[0] != 0
    if parameter.index is not None or not (
        position or (velocity and parameter.field == "actuator_kv")
    ):
        raise BadArgument(
            f"The field {parameter.field!r} of parameter {parameter.name!r} is a gain of a "
            "position servo, or kv of a velocity servo,"
            f" and has no index: {parameter.element!r} is none."
        )
    if parameter.field == "actuator_kp":
        return [("actuator_gainprm", (i, 0), 1.0), ("actuator_biasprm", (i, 1), -1.0)]
    return [
        ("actuator_biasprm", (i, 2), -1.0),
        *([("actuator_gainprm", (i, 0), 1.0)] if velocity else []),
    ]


def _float_like(value: Any) -> bool:
    return isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)


def model_fields(model: mujoco.MjModel) -> list[str]:
    """The names of the model's float64 arrays, and of the gains of servos."""
    return [
        *SERVO,
        *(
            name
            for name in dir(model)
            if not name.startswith("_")
            and isinstance(getattr(model, name), np.ndarray)
            and _float_like(getattr(model, name))
        ),
    ]


def option_fields(model: mujoco.MjModel) -> list[str]:
    """The names of mjOption's float entries."""
    return [
        name
        for name in dir(model.opt)
        if not name.startswith("_") and _float_like(getattr(model.opt, name))
    ]


def _entries(parameter: FieldParameter, model: mujoco.MjModel, array: Any) -> Any:
    """The index of the parameter's numbers in the field's array."""
    owner = f"parameter {parameter.name!r}"
    rows = _rows(parameter, model)
    if rows is None:
        shape = np.shape(array)
        if parameter.element is not None:
            raise BadArgument(
                f"The field {parameter.field!r} of {owner} has no named elements, and the "
                f"name {parameter.element!r} was given."
            )
    else:
        shape = (
            np.shape(array[rows])[1:]
            if isinstance(rows, int) is False and len(rows) == 1
            else np.shape(array[rows])
        )
    size = int(np.prod(shape))
    if parameter.index is None:
        if size > 1 and not parameter.relative:
            raise BadArgument(
                f"The field {parameter.field!r} of {owner} has {size} numbers: give the "
                f"index, 0 to {size - 1}."
            )
        return (slice(None) if shape else ()) if rows is None else np.array(rows)
    if not 0 <= parameter.index < max(size, 1):
        raise BadArgument(
            f"The index of {owner} must be 0 to {size - 1}, the field {parameter.field!r} "
            f"has {size} numbers there. Got {parameter.index}."
        )
    if rows is None:
        return np.unravel_index(parameter.index, shape) if shape else ()
    grid = np.argwhere(
        np.isin(np.arange(len(array)), rows)[(...,) + (None,) * (array.ndim - 1)]
        & np.ones(array.shape, dtype=bool)
    )
    return tuple(int(i) for i in grid[parameter.index])


def _rows(parameter: FieldParameter, model: mujoco.MjModel) -> list[int] | None:
    """The rows of the field that belong to the element; None for fields without elements."""
    prefix = parameter.field.split("_")[0]
    kind = PREFIXES.get(prefix) if "_" in parameter.field else None
    if kind is None:
        return None
    names = element_names(model, kind)
    if parameter.element is None:
        raise BadArgument(
            f"The field {parameter.field!r} of parameter {parameter.name!r} needs the name "
            f"of a {kind}. {nearest('', names)}"
        )
    i = names[known(kind, parameter.element, names)]
    if prefix != "dof":
        return [i]
    start = int(model.jnt_dofadr[i])
    return list(range(start, start + (6, 3, 1, 1)[int(model.jnt_type[i])]))


ITEM = re.compile(r"^(?P<field>\w+)(?:\[(?P<slice>-?\d*(?::-?\d*)?)\]|\.(?P<name>[^\[\]]+))?$")


def item_columns(
    text: str, sizes: dict[str, int], addresses: dict[str, dict[str, tuple[int, int]]]
) -> tuple[str, list[int]]:
    """An observation or action item, such as "qpos[1:]" or "qpos.thigh_joint", as (field, places in
    it).

    sizes: the length of each field; addresses: for each field, the start and number of places of
    its named elements.
    """
    match = ITEM.match(text.replace(" ", ""))
    if match is None:
        raise BadArgument(
            f"The item {text!r} must be a field, with a slice or an element's name, such "
            "as 'qpos[1:]' or 'qpos.thigh_joint'."
        )
    field = known("field", match["field"], sizes)
    if match["name"]:
        start, count = addresses[field][
            known(f"element of {field}", match["name"], addresses[field])
        ]
        return field, list(range(start, start + count))
    places = list(range(sizes[field]))
    if match["slice"] is None:
        return field, places
    if ":" not in match["slice"]:
        if not -len(places) <= int(match["slice"]) < len(places):
            raise BadArgument(
                f"The item {text!r} is outside of {field}, which has {len(places)} numbers."
            )
        return field, [places[int(match["slice"])]]
    begin, end = (int(part) if part else None for part in match["slice"].split(":"))
    chosen = places[slice(begin, end)]
    if not chosen or (end is not None and end > len(places)):
        raise BadArgument(
            f"The item {text!r} is outside of {field}, which has {len(places)} numbers."
        )
    return field, chosen
