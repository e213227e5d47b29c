"""All numbers of a model, by the names of their fields; those of mjOption begin with "opt."."""

from typing import Any

import mujoco
import numpy as np

from dropo.core.services.validation import Array
from dropo.mjmodel.fields import OPTION


def array_of(model: mujoco.MjModel, key: str) -> Any:
    """Read a field of a model by its name.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    key : str
        A field; an entry of mjOption with "opt." before it.

    Returns
    -------
    array or number
    """
    owner = model.opt if key.startswith(OPTION) else model
    return np.asarray(getattr(owner, key.removeprefix(OPTION)))


def set_number(model: mujoco.MjModel, field: str, place: tuple[int, ...], number: float) -> None:
    """Set a number of a model or of its options.

    Parameters
    ----------
    model : MjModel
        Changed in place.
    field : str
        Its name; an entry of mjOption with "opt." before it.
    place : tuple of int
        Where in the array.
    number : float
        What is written.
    """
    owner = model.opt if field.startswith("opt.") else model
    name = field.removeprefix("opt.")
    if isinstance(getattr(owner, name), np.ndarray):
        getattr(owner, name)[tuple(place)] = number
    else:
        setattr(owner, name, float(number))


def derive_constants(model: mujoco.MjModel) -> None:
    """Compute anew the constants that MuJoCo derives from a model's numbers.

    Parameters
    ----------
    model : MjModel
        Changed in place.
    """
    mujoco.mj_setConst(model, mujoco.MjData(model))


def changed_numbers(plain: mujoco.MjModel, whole: mujoco.MjModel) -> dict[str, Array]:
    """Collect the fields of a model that another one of the same structure has otherwise.

    Parameters
    ----------
    plain, whole : MjModel
        The models; the numbers are the second one's.

    Returns
    -------
    dict of str to array
        By name, those of mjOption with "opt." before it.
    """
    found: dict[str, Array] = {}
    for prefix, old, new in (("", plain, whole), (OPTION, plain.opt, whole.opt)):
        for name in dir(new):
            value: Any = None if name.startswith("_") else getattr(new, name)
            numbers = isinstance(value, np.ndarray) or (prefix and isinstance(value, int | float))
            if not numbers or np.shape(getattr(old, name)) != np.shape(value):
                continue
            if not np.array_equal(getattr(old, name), value, equal_nan=_is_float(value)):
                found[f"{prefix}{name}"] = np.array(value)
    return found


def _is_float(value: Any) -> bool:
    """Whether numbers can be NaN."""
    return bool(np.issubdtype(np.asarray(value).dtype, np.floating))
