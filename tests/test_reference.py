"""Everything public is in the Python reference and says what its parameters are."""

import dataclasses
import inspect
import re
from pathlib import Path

import pytest

import dropo
from dropo.core.services import errors

REFERENCE = (Path(__file__).parents[1] / "docs" / "reference.md").read_text()
PUBLIC = sorted(
    set(dropo.__all__) - {"__version__", "plots"}
)  # a text, and a room of its own section
ONCE = {"self", "cls", "rng"}  # rng is explained at the head of the page


def functions_of(thing):
    """A function itself; of a class its constructor and public methods, with a property's function
    for the property.
    """
    if not inspect.isclass(thing):
        return [thing]
    members = [
        getattr(member, "__func__", member)
        for name, member in vars(thing).items()
        if not name.startswith("_")
    ]
    own = (
        [] if dataclasses.is_dataclass(thing) or "__init__" not in vars(thing) else [thing.__init__]
    )
    return [function for function in [*own, *members] if inspect.isfunction(function)]


def unexplained(thing) -> list[str]:
    """Parameters and fields that no docstring of the thing names as a word; one that is called like
    its type is explained by it.
    """
    about = (
        " ".join(cls.__doc__ or "" for cls in thing.__mro__[:-1]) if inspect.isclass(thing) else ""
    )
    found = []
    if dataclasses.is_dataclass(thing):
        found += [field.name for field in dataclasses.fields(thing) if not says(about, field.name)]
    for function in functions_of(thing):
        text = f"{about} {inspect.getdoc(function) or ''}"
        for name, parameter in inspect.signature(function).parameters.items():
            obvious = (
                name in ONCE or name == str(getattr(parameter.annotation, "__name__", "")).lower()
            )
            if not obvious and not says(text, name):
                found.append(f"{function.__name__}({name})")
    return found


def says(text: str, name: str) -> bool:
    """Whether the text has the name as a word."""
    return re.search(rf"(?<![\w.]){re.escape(name)}(?!\w)", text) is not None


def test_the_reference_lists_everything_public():
    listed = re.findall(r"^\.\. auto(?:function|class):: dropo\.(\w+)$", REFERENCE, re.MULTILINE)
    assert sorted(listed) == PUBLIC


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_explain_themselves(name):
    thing = getattr(dropo, name)
    assert (thing.__doc__ or "").split("\n")[0].rstrip().endswith((".", ":", ",", ";")) or len(
        thing.__doc__.split()
    ) > 5
    assert unexplained(thing) == []


def test_what_is_not_explained_is_noticed():
    """The control: a function, a class and a dataclass that leave something out."""

    def half(given, forgotten):
        """Takes what is given."""

    @dataclasses.dataclass
    class Record:
        """A record of a first."""

        first: int
        second: int

        def method(self, third):
            """Does it."""

    assert unexplained(half) == ["half(forgotten)"]
    assert unexplained(Record) == ["second", "method(third)"]


def test_errors_are_one_family_with_a_way_out():
    """Whatever is raised on purpose is a DropoError, a refusal is a ValueError too, and each class
    says when it is raised.
    """
    family = [cls for cls in vars(errors).values() if inspect.isclass(cls)]
    assert all(issubclass(cls, errors.DropoError) and cls.__doc__ for cls in family)
    assert issubclass(errors.InvalidInput, ValueError)
