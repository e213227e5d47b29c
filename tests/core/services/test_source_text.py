"""Functions as text that runs without this package."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest

from dropo.core.services.errors import Incompatible
from dropo.core.services.source_text import SourceText
from dropo.effects.sensors import sensor_bias, sensor_gain

FACTOR = 3
_HIDDEN = (1.5, "two")


@dataclass(frozen=True)
class Place:
    """Where something is."""

    row: int
    shift: float = 0.25
    names: list[str] = field(default_factory=list)

    def moved(self) -> float:
        """Farther on."""
        return _twice(self.row + self.shift)


def _twice(value: float) -> float:
    return 2 * value


def shifted(place: Place, values: np.ndarray, factor: int = FACTOR) -> np.ndarray:
    """Uses a constant, another function and an outside package."""
    return factor * np.asarray(values) + place.moved() + len(_HIDDEN)


def run(source: SourceText, expression: str):
    """What an expression is worth where the text was run alone."""
    scope = {"__name__": "alone"}
    exec(source.text(), scope)
    assert not any(str(getattr(one, "__module__", "")) == __name__ for one in scope.values())
    return eval(expression, scope)


def test_a_function_brings_what_it_needs():
    """The value is that of the function itself; the text has no word of this module."""
    source = SourceText([__name__])
    hook = partial(shifted, Place(2), factor=2)
    expression = source.expression(hook)
    assert __name__ not in source.text() + expression
    np.testing.assert_array_equal(run(source, expression)([1.0, 2.0]), hook([1.0, 2.0]))


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        3,
        0.1,
        "a 'b'",
        (1,),
        (1, 2.5),
        [1, [2]],
        {"a": (1, None)},
        np.float64(0.3),
        -np.inf,
    ],
    ids=repr,
)
def test_values(value):
    """Numbers, texts and containers are themselves."""
    source = SourceText()
    found = run(source, source.expression(value))
    assert found == value
    assert type(found) is type(value) or isinstance(value, np.generic)


def test_arrays():
    """Every digit."""
    value = np.random.default_rng(0).normal(size=(2, 3))
    source = SourceText()
    expression = source.expression(value)
    np.testing.assert_array_equal(run(source, expression), value)


def test_names_that_are_taken_carry_their_module():
    """Two functions of one name stand side by side."""
    source = SourceText()
    first, second = source.expression(sensor_bias._undo), source.expression(sensor_gain._undo)
    assert (first, second) == ("_sensor_bias_undo", "_sensor_gain_undo")
    signals, speeds, sizes = np.ones((1, 2)), np.zeros((1, 2)), np.array([0.5])
    for module, name in ((sensor_bias, first), (sensor_gain, second)):
        np.testing.assert_array_equal(
            run(source, name)(0, signals, speeds, sizes),
            module._undo(0, signals, speeds, sizes),
        )


def test_what_has_no_source_is_refused():
    """A function inside of a function, an object of no dataclass: a sentence."""
    for value, told in ((lambda: 1, "top of its module"), (object(), "source text")):
        with pytest.raises(Incompatible, match=told):
            SourceText([__name__]).expression(value)
