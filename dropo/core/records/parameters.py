"""Parameters by name: bounds, unit, scale; and the box that they span."""

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
    """One number to be found.

    name: what it is called in tables and files; low, high: the search interval, in `unit`. lower,
    upper: what is physically possible, which a draw never leaves; by default a tenth of `low` where
    `low` is positive, 0 where it is 0, and no limit otherwise.
    scale: how a search moves in the interval, "linear" or "log".
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
        require(
            bool(self.name) and isinstance(self.name, str), "name", "a word", self.name, "Parameter"
        )
        require(
            math.isfinite(self.low) and math.isfinite(self.high),
            "low, high",
            "finite",
            (self.low, self.high),
            caller,
        )
        require(self.low < self.high, "low", f"below high = {self.high:g}", self.low, caller)
        require(self.scale in ("linear", "log"), "scale", "'linear' or 'log'", self.scale, caller)
        require(
            self.scale == "linear" or self.low > 0,
            "low",
            "positive on a log scale",
            self.low,
            caller,
        )
        if math.isnan(self.lower):
            object.__setattr__(
                self,
                "lower",
                self.low / 10 if self.low > 0 else 0.0 if self.low == 0 else -math.inf,
            )
        require(self.lower <= self.low, "lower", f"at most low = {self.low:g}", self.lower, caller)
        require(
            self.upper >= self.high, "upper", f"at least high = {self.high:g}", self.upper, caller
        )

    @property
    def width(self) -> float:
        """High - low."""
        return self.high - self.low

    @property
    def place(self) -> dict[str, Any]:
        """What a kind of parameter says beside this: where in a model it is; empty for a bare one."""
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in Parameter.__dataclass_fields__
        }


@dataclass(frozen=True)
class ParameterSpace(Sequence[Parameter]):
    """An ordered set of parameters of different names: vectors (d,) in this order, and the box
    [low, high].
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        twice = {name for name in self.names if self.names.count(name) > 1}
        require(not twice, "names", "different from each other", sorted(twice), "ParameterSpace")

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, key):  # type: ignore[no-untyped-def]
        """The parameter of that name or place."""
        if isinstance(key, str):
            return self.parameters[self.names.index(known("parameter", key, self.names))]
        return self.parameters[key]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The d names."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def low(self) -> Array:
        """(d,) the lower ends of the search intervals, each in its parameter's unit."""
        return np.array([parameter.low for parameter in self.parameters])

    @cached_property
    def high(self) -> Array:
        """(d,) the upper ends of the search intervals."""
        return np.array([parameter.high for parameter in self.parameters])

    @cached_property
    def lower(self) -> Array:
        """(d,) the least values that are physically possible; -inf where there is no such limit."""
        return np.array([parameter.lower for parameter in self.parameters])

    @cached_property
    def upper(self) -> Array:
        """(d,) the largest values that are physically possible; inf where there is no such limit."""
        return np.array([parameter.upper for parameter in self.parameters])

    @cached_property
    def is_log(self) -> np.ndarray:
        """(d,) which are searched on a log scale."""
        return np.array([parameter.scale == "log" for parameter in self.parameters], dtype=bool)

    def vector(self, values: Mapping[str, float] | ArrayLike) -> Array:
        """(d,) in this order, from `values`: a mapping of all names, or an array (d,)."""
        if isinstance(values, Mapping):
            for name in values:
                known("parameter", name, self.names)
            missing = [name for name in self.names if name not in values]
            require(
                not missing,
                "values",
                "given for every parameter",
                f"none for {missing}",
                "ParameterSpace.vector",
            )
            values = [values[name] for name in self.names]
        return float_array("values", values, (len(self),), "ParameterSpace.vector")

    def from_unit(self, unit: ArrayLike) -> Array:
        """Points of the box from points of [0, 1]^d, linear or in logarithms; unit: (..., d) ->
        (..., d).
        """
        unit = np.asarray(unit, dtype=float)
        linear = self.low + unit * (self.high - self.low)
        base = np.where(self.is_log, self.low, 1.0)
        logarithmic = base * (np.where(self.is_log, self.high, 1.0) / base) ** unit
        return np.clip(np.where(self.is_log, logarithmic, linear), self.low, self.high)

    def to_unit(self, values: ArrayLike) -> Array:
        """The inverse of `from_unit`; values outside the box land outside [0, 1]."""
        values = np.asarray(values, dtype=float)
        linear = (values - self.low) / (self.high - self.low)
        base = np.where(self.is_log, self.low, 1.0)
        ratio = np.where(self.is_log, self.high / np.where(self.is_log, self.low, 1.0), math.e)
        logarithmic = np.log(np.where(self.is_log, values, 1.0) / base) / np.log(ratio)
        return np.where(self.is_log, logarithmic, linear)

    def feasible(self, values: Array) -> Array:
        """`values` (..., d) moved to the nearest physically possible ones."""
        xp = namespace(values)
        return xp.minimum(
            xp.maximum(values, constant(self.lower, values)), constant(self.upper, values)
        )
