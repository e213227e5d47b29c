"""Parameters with their names, bounds and units, and the box that they span."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.numerics.array_api import constant, namespace
from dropo.core.services.validation import Array, float_array, known, require


@dataclass(frozen=True)
class Parameter:
    """One number to be fitted.

    Attributes
    ----------
    name : str
        What it is called in tables and files.
    low, high : float
        The search interval, in `unit`.
    unit : str
        For tables; empty if it has none.
    lower, upper : float
        What is physically possible, which a draw never leaves, in `unit`. By default `lower` is a
        tenth of `low` where that is positive, 0 where that is 0, and no limit otherwise; `upper`
        is no limit.
    scale : {"linear", "log"}
        How a search steps in the interval.

    Raises
    ------
    BadArgument
        If the name is empty, the interval is empty or not finite, the physical bounds are inside
        it, or the scale is another word or "log" with `low` not positive.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    _: KW_ONLY
    lower: float = math.nan
    upper: float = math.inf
    scale: Literal["linear", "log"] = "linear"

    def __post_init__(self) -> None:
        caller = f"Parameter {self.name!r}"
        named = bool(self.name) and isinstance(self.name, str)
        require(named, "name", "a word", self.name, "Parameter")
        finite = math.isfinite(self.low) and math.isfinite(self.high)
        require(finite, "low, high", "finite", (self.low, self.high), caller)
        require(self.low < self.high, "low", f"below high = {self.high:g}", self.low, caller)
        require(self.scale in ("linear", "log"), "scale", "'linear' or 'log'", self.scale, caller)
        allowed = self.scale == "linear" or self.low > 0
        require(allowed, "low", "positive on a log scale", self.low, caller)
        if math.isnan(self.lower):
            object.__setattr__(self, "lower", _default_lower(self.low))
        require(self.lower <= self.low, "lower", f"at most low = {self.low:g}", self.lower, caller)
        rule = f"at least high = {self.high:g}"
        require(self.upper >= self.high, "upper", rule, self.upper, caller)

    @property
    def width(self) -> float:
        """Width of the search interval, in the parameter's unit."""
        return self.high - self.low

    @property
    def place(self) -> dict[str, Any]:
        """Where in a model the parameter is: the fields of its own class; empty for a bare one."""
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in Parameter.__dataclass_fields__
        }


def _default_lower(low: float) -> float:
    """The physical lower bound where none is given."""
    if low > 0:
        return low / 10
    return 0.0 if low == 0 else -math.inf


SHOWN = 6
"""Parameters that the text of a space shows."""


@dataclass(frozen=True)
class ParameterSpace(Sequence[Parameter]):
    """An ordered set of d parameters with different names, and the box of their intervals.

    Vectors (d,) of values have this order.

    Attributes
    ----------
    parameters : tuple of Parameter
        The parameters.

    Raises
    ------
    BadArgument
        If two parameters have the same name.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        twice = {name for name in self.names if self.names.count(name) > 1}
        require(not twice, "names", "different from each other", sorted(twice), "ParameterSpace")

    def __repr__(self) -> str:
        """Names with intervals and units, the first few of many."""
        shown = [
            f"{own.name} [{own.low:g}, {own.high:g}]{' ' * bool(own.unit)}{own.unit}"
            for own in self.parameters[:SHOWN]
        ]
        if len(self) > SHOWN:
            shown.append(f"... {len(self)} in all")
        return f"ParameterSpace({', '.join(shown)})"

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, key):  # type: ignore[no-untyped-def]
        """Return the parameter of that name or place."""
        if isinstance(key, str):
            return self.parameters[self.names.index(known("parameter", key, self.names))]
        return self.parameters[key]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the d parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def low(self) -> Array:
        """Lower ends (d,) of the search intervals, each in its parameter's unit."""
        return np.array([parameter.low for parameter in self.parameters])

    @cached_property
    def high(self) -> Array:
        """Upper ends (d,) of the search intervals."""
        return np.array([parameter.high for parameter in self.parameters])

    @cached_property
    def lower(self) -> Array:
        """Smallest values (d,) that are physically possible; -inf without such a limit."""
        return np.array([parameter.lower for parameter in self.parameters])

    @cached_property
    def upper(self) -> Array:
        """Largest values (d,) that are physically possible; inf without such a limit."""
        return np.array([parameter.upper for parameter in self.parameters])

    @cached_property
    def is_log(self) -> np.ndarray:
        """Which parameters (d,) are searched on a log scale."""
        return np.array([parameter.scale == "log" for parameter in self.parameters], dtype=bool)

    def vector(self, values: Mapping[str, float] | ArrayLike) -> Array:
        """Put values into a vector.

        Parameters
        ----------
        values : mapping of str to float, or (d,) array_like
            A value for every name, or all in this order.

        Returns
        -------
        (d,) array
            In the parameters' units.

        Raises
        ------
        UnknownName
            If a name is none of the parameters'.
        BadArgument
            If a value is missing or not finite.
        """
        if isinstance(values, Mapping):
            for name in values:
                known("parameter", name, self.names)
            missing = [name for name in self.names if name not in values]
            rule = "given for every parameter"
            require(not missing, "values", rule, f"none for {missing}", "ParameterSpace.vector")
            values = [values[name] for name in self.names]
        return float_array("values", values, (len(self),), "ParameterSpace.vector")

    def from_unit(self, unit: ArrayLike) -> Array:
        """Map points of the unit box to points of this box, linearly or in logarithms.

        Parameters
        ----------
        unit : (..., d) array_like
            Points of [0, 1]^d.

        Returns
        -------
        (..., d) array
            In the parameters' units.
        """
        unit = np.asarray(unit, dtype=float)
        linear = self.low + unit * (self.high - self.low)
        base = np.where(self.is_log, self.low, 1.0)
        logarithmic = base * (np.where(self.is_log, self.high, 1.0) / base) ** unit
        return np.clip(np.where(self.is_log, logarithmic, linear), self.low, self.high)

    def to_unit(self, values: ArrayLike) -> Array:
        """Map points of this box to points of the unit box, the inverse of `from_unit`.

        Parameters
        ----------
        values : (..., d) array_like
            In the parameters' units.

        Returns
        -------
        (..., d) array
            Outside [0, 1] for values outside the box.
        """
        values = np.asarray(values, dtype=float)
        linear = (values - self.low) / (self.high - self.low)
        base = np.where(self.is_log, self.low, 1.0)
        ratio = np.where(self.is_log, self.high / np.where(self.is_log, self.low, 1.0), math.e)
        logarithmic = np.log(np.where(self.is_log, values, 1.0) / base) / np.log(ratio)
        return np.where(self.is_log, logarithmic, linear)

    def clip(self, values: ArrayLike) -> Array:
        """Move values to the nearest point of the box.

        Parameters
        ----------
        values : (..., d) array_like
            In the parameters' units.

        Returns
        -------
        (..., d) array
            Within the bounds of the search.
        """
        return np.clip(values, self.low, self.high)

    def feasible(self, values: Array) -> Array:
        """Clip values to what is physically possible.

        Parameters
        ----------
        values : (..., d) array
            Array or tensor, in the parameters' units.

        Returns
        -------
        (..., d) array
            The nearest possible values.
        """
        xp = namespace(values)
        not_below = xp.maximum(values, constant(self.lower, values))
        return xp.minimum(not_below, constant(self.upper, values))
