"""Any number of an MjModel or its mjOption as a parameter."""

import re
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import mujoco
import numpy as np

from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.core.services.validation import known, nearest, require
from dropo.mjmodel.names import element_names

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
"""The kind of element that the rows of a field belong to, by the field's prefix; a `dof_` row is
found by the name of its joint.
"""
SERVO = ("actuator_kp", "actuator_kv")
"""The gains of a position or velocity servo, which MuJoCo keeps in both gainprm and biasprm."""
MOVES_FRAMES = ("body_ipos", "body_iquat")
"""Fields that mj_setConst refuses unless the body was compiled with simple="false"."""


OPTION = "opt."
"""What the names of numbers in mjOption begin with, where they stand beside those of MjModel."""
NEVER_NEGATIVE = (
    "body_mass",
    "body_inertia",
    "dof_armature",
    "dof_frictionloss",
    "tendon_frictionloss",
    "geom_friction",
    "pair_friction",
    "density",
    "viscosity",
)
"""Fields whose numbers have no meaning below 0."""


@dataclass(frozen=True)
class FieldParameter(Parameter):
    """A parameter that stands for a number of the model.

    Attributes
    ----------
    field : str
        An MjModel array ("body_mass") or an mjOption entry ("gravity").
    element : str, tuple of str, or None
        The body, joint, geom, ... by name, or several that share the value; None where the field
        has no elements.
    index : int or None
        The place within the element's row.
    relative : bool
        Whether the value is a factor on the model's own number; without an index, on the whole row.
    derived : bool
        Whether constants derived from the model follow (mj_setConst). The thesis leaves them.

    Raises
    ------
    BadArgument
        As a `Parameter` does, and if `low` is below 0 where the field is never.
    """

    _: KW_ONLY
    field: str = ""
    element: str | tuple[str, ...] | None = None
    index: int | None = None
    relative: bool = False
    derived: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = f"0 or more, since a {self.field} is never negative"
        allowed = self.low >= 0 or self.field not in NEVER_NEGATIVE
        require(allowed, "low", rule, self.low, f"Parameter {self.name!r}")


class Binding:
    """A FieldParameter bound to a model: writes its value into any copy of the model.

    Parameters
    ----------
    parameter : FieldParameter
        What stands for the number.
    model : MjModel
        The model with the parameter's nominal value.

    Raises
    ------
    UnknownName
        If the model has no such field or element.
    BadArgument
        If the field needs an element or index that is not given, or has none that is given.
    """

    def __init__(self, parameter: FieldParameter, model: mujoco.MjModel):
        self.parameter = parameter
        named = parameter.element
        elements = named if isinstance(named, tuple) else (named,)
        self._places = [_BoundParameter(replace(parameter, element=one), model) for one in elements]

    def nominal(self) -> float:
        """Give the parameter's value in the model that it was bound to.

        Returns
        -------
        float
            Of several places the mean.
        """
        return float(np.mean([place.nominal() for place in self._places]))

    def set(self, model: mujoco.MjModel, value: float) -> None:
        """Write a value of the parameter into a copy of the model.

        Parameters
        ----------
        model : MjModel
            The copy, which is changed in place.
        value : float
            The value, in the parameter's unit.
        """
        for place in self._places:
            place.set(model, value)

    def entries(self, model: mujoco.MjModel) -> list[tuple[str, tuple[int, ...], float]]:
        """List the numbers that it sets: field, place, and the number where the parameter is 1.

        Parameters
        ----------
        model : MjModel
            A copy of the model.

        Returns
        -------
        list of (str, tuple of int, float)
            Names of entries of mjOption begin with "opt."; the place of a single number is empty.
        """
        return [entry for place in self._places for entry in place.entries(model)]

    def read(self, model: mujoco.MjModel) -> Any:
        """Read the numbers for which the parameter stands.

        Parameters
        ----------
        model : MjModel
            A copy of the model that it is bound to.

        Returns
        -------
        float or array
            Those of the first place, where it stands for several.
        """
        return self._places[0].read(model)


class _BoundParameter:
    """A parameter of one element, or of a field without elements, bound to a model."""

    def __init__(self, parameter: FieldParameter, model: mujoco.MjModel):
        self.parameter = parameter
        self._servo = _servo_places(parameter, model) if parameter.field in SERVO else []
        if not self._servo:
            self._in_option = not _is_array(getattr(model, parameter.field, None))
            in_option = _is_float(getattr(model.opt, parameter.field, None))
            if self._in_option and (parameter.field.startswith("_") or not in_option):
                valid = [*model_fields(model), *option_fields(model)]
                raise UnknownName(
                    f"No field of MjModel or mjOption called {parameter.field!r}. "
                    f"{nearest(parameter.field, valid)}"
                )
            self._places = _places(parameter, model, self._array(model))
        self._nominal = np.array(self.read(model), dtype=float)

    def nominal(self) -> float:
        """The parameter's value in the model that it was bound to."""
        return 1.0 if self.parameter.relative else float(self._nominal.flat[0])

    def set(self, model: mujoco.MjModel, value: float) -> None:
        """Write a value of the parameter into a copy of the model."""
        new = self._nominal * value if self.parameter.relative else value
        if self._servo:
            for name, place, sign in self._servo:
                getattr(model, name)[place] = sign * float(new)
            return
        array = self._array(model)
        if isinstance(array, np.ndarray):
            array[self._places] = new
        else:
            setattr(model.opt, self.parameter.field, float(new))

    def entries(self, model: mujoco.MjModel) -> list[tuple[str, tuple[int, ...], float]]:
        """The numbers that it sets."""
        if self._servo:
            share = float(self._nominal) if self.parameter.relative else 1.0
            return [(name, place, sign * share) for name, place, sign in self._servo]
        numbers = self._array(model)
        prefix = OPTION if self._in_option else ""
        name = f"{prefix}{self.parameter.field}"
        chosen = np.zeros(np.shape(numbers), dtype=bool)
        chosen[self._places] = True
        found: list[tuple[str, tuple[int, ...], float]] = []
        nominal = np.zeros(np.shape(numbers))
        nominal[self._places] = self._nominal
        for place in np.argwhere(chosen):
            at = tuple(map(int, place))
            found.append((name, at, float(nominal[at]) if self.parameter.relative else 1.0))
        return found

    def _array(self, model: mujoco.MjModel) -> Any:
        """The whole field in a copy of the model."""
        return getattr(model.opt if self._in_option else model, self.parameter.field)

    def read(self, model: mujoco.MjModel) -> Any:
        """Read the numbers for which the parameter stands from a copy of the model."""
        if self._servo:
            name, place, sign = self._servo[0]
            return sign * getattr(model, name)[place]
        array = self._array(model)
        return array[self._places] if isinstance(array, np.ndarray) else array


def _servo_places(
    parameter: FieldParameter, model: mujoco.MjModel
) -> list[tuple[str, tuple[int, int], float]]:
    """Array, place and sign of each number that holds a servo's gain.

    A position servo has kp, and kv for its damping; a velocity servo has kv.
    """
    rows = _rows(parameter, model)
    i = 0 if rows is None else rows[0]
    gain = model.actuator_gainprm[i]
    bias = model.actuator_biasprm[i]
    is_position = bias[1] == -gain[0] != 0
    is_velocity = bias[1] == 0 and bias[2] == -gain[0] != 0
    has_gain = is_position or (is_velocity and parameter.field == "actuator_kv")
    if parameter.index is not None or not has_gain:
        raise BadArgument(
            f"The field {parameter.field!r} of parameter {parameter.name!r} is a gain of a "
            "position servo, or kv of a velocity servo, and has no index: "
            f"{parameter.element!r} is none."
        )
    if parameter.field == "actuator_kp":
        return [("actuator_gainprm", (i, 0), 1.0), ("actuator_biasprm", (i, 1), -1.0)]
    places = [("actuator_biasprm", (i, 2), -1.0)]
    if is_velocity:
        places.append(("actuator_gainprm", (i, 0), 1.0))
    return places


def owner_of(model: mujoco.MjModel, field: str, row: int) -> tuple[str, str] | None:
    """Name the element to which a row of a field belongs.

    Parameters
    ----------
    model : MjModel
        The model.
    field : str
        An MjModel array.
    row : int
        Its row.

    Returns
    -------
    (str, str) or None
        Its kind and the name that the MJCF gives it; None for fields without elements, and for
        elements without a name of their own.
    """
    prefix = field.split("_")[0]
    kind = PREFIXES.get(prefix) if "_" in field else None
    if kind is None:
        return None
    i = int(model.dof_jntid[row]) if prefix == "dof" else row
    name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), i)
    return (kind, name) if name else None


def first_row(model: mujoco.MjModel, field: str, row: int) -> int:
    """Find the first row of the element to which a row of a field belongs.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    field : str
        A field of the model, such as "dof_damping".
    row : int
        A row of that field.

    Returns
    -------
    int
        Of a field of degrees of freedom the first of their joint; else the row itself.
    """
    return int(model.jnt_dofadr[model.dof_jntid[row]]) if field.startswith("dof_") else row


def _is_float(value: Any) -> bool:
    """Whether the value is a float or an array of them."""
    return isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)


def _is_array(value: Any) -> bool:
    """Whether the value is an array of floats."""
    return isinstance(value, np.ndarray) and _is_float(value)


def model_fields(model: mujoco.MjModel) -> list[str]:
    """List the fields of a model that a parameter can name.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of str
        The names of the gains of servos, then of the model's float64 arrays.
    """
    names = list(SERVO)
    for name in dir(model):
        if not name.startswith("_") and _is_array(getattr(model, name)):
            names.append(name)
    return names


def option_fields(model: mujoco.MjModel) -> list[str]:
    """List the entries of mjOption that a parameter can name.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of str
        The names of its floats and arrays of floats, without "opt." before them.
    """
    names = [name for name in dir(model.opt) if not name.startswith("_")]
    return [name for name in names if _is_float(getattr(model.opt, name))]


def _places(parameter: FieldParameter, model: mujoco.MjModel, array: Any) -> Any:
    """The index of the parameter's numbers in the field's array."""
    owner = f"parameter {parameter.name!r}"
    rows = _rows(parameter, model)
    if rows is None and parameter.element is not None:
        raise BadArgument(
            f"The field {parameter.field!r} of {owner} has no named elements, and the "
            f"name {parameter.element!r} was given."
        )
    # the numbers among which the index chooses
    if rows is None:
        shape = np.shape(array)
    elif len(rows) == 1:
        shape = np.shape(array[rows])[1:]
    else:
        shape = np.shape(array[rows])
    size = int(np.prod(shape))
    if parameter.index is None:
        if size > 1 and not parameter.relative:
            raise BadArgument(
                f"The field {parameter.field!r} of {owner} has {size} numbers: give the "
                f"index, 0 to {size - 1}."
            )
        if rows is None:
            return slice(None) if shape else ()
        return np.array(rows)
    if not 0 <= parameter.index < max(size, 1):
        raise BadArgument(
            f"The index of {owner} must be 0 to {size - 1}, the field {parameter.field!r} "
            f"has {size} numbers there. Got {parameter.index}."
        )
    if rows is None:
        return np.unravel_index(parameter.index, shape) if shape else ()
    within = np.unravel_index(parameter.index, np.shape(array[rows]))
    return (rows[int(within[0])], *(int(i) for i in within[1:]))


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
    i = names[known(kind, str(parameter.element), names)]
    if prefix != "dof":
        return [i]
    start = int(model.jnt_dofadr[i])
    count = (6, 3, 1, 1)[int(model.jnt_type[i])]  # by kind: free, ball, slide, hinge
    return list(range(start, start + count))


ITEM = re.compile(r"^(?P<field>\w+)(?:\[(?P<slice>-?\d*(?::-?\d*)?)\]|\.(?P<name>[^\[\]]+))?$")


def item_columns(
    text: str, sizes: dict[str, int], addresses: dict[str, dict[str, tuple[int, int]]]
) -> tuple[str, list[int]]:
    """Read an observation or action item, such as "qpos[1:]" or "qpos.thigh_joint".

    Parameters
    ----------
    text : str
        The item.
    sizes : dict
        The length of each field.
    addresses : dict
        For each field, the start and the number of places of its named elements.

    Returns
    -------
    field : str
        The field's name.
    places : list of int
        The places in the field, in order.

    Raises
    ------
    BadArgument
        If the item cannot be read, or is outside of its field.
    UnknownName
        If there is no such field or element; with the nearest valid name.
    """
    match = ITEM.match(text.replace(" ", ""))
    if match is None:
        raise BadArgument(
            f"The item {text!r} must be a field, with a slice or an element's name, such "
            "as 'qpos[1:]' or 'qpos.thigh_joint'."
        )
    field = known("field", match["field"], sizes)
    if match["name"]:
        name = known(f"element of {field}", match["name"], addresses[field])
        start, count = addresses[field][name]
        return field, list(range(start, start + count))
    places = list(range(sizes[field]))
    if match["slice"] is None:
        return field, places
    return field, _slice(text, field, match["slice"], places)


def _slice(text: str, field: str, inside: str, places: list[int]) -> list[int]:
    """The places that a slice such as "1:" or "-1" chooses; outside of the field it is refused."""
    outside = BadArgument(
        f"The item {text!r} is outside of {field}, which has {len(places)} numbers."
    )
    if ":" not in inside:
        if not -len(places) <= int(inside) < len(places):
            raise outside
        return [places[int(inside)]]
    begin, end = (int(part) if part else None for part in inside.split(":"))
    chosen = places[slice(begin, end)]
    if not chosen or (end is not None and end > len(places)):
        raise outside
    return chosen
