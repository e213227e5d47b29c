"""What may be registered, and by whom."""

import sys
from pathlib import Path

import pytest

from dropo.core.services import registry
from dropo.core.services.errors import BadArgument, BadFile, UnknownName
from dropo.core.services.plugin_files import load_plugins


@pytest.fixture(autouse=True)
def _fresh_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is gone after it."""
    monkeypatch.setattr(registry, "_registered", {kind: {} for kind in registry.BUILT_IN})


@pytest.mark.parametrize("name", ["triangle", "random-search", "my_drag", "db3", "7z", "a1-b_2"])
def test_words_joined_by_hyphens_and_underscores_are_names(name: str) -> None:
    registry.register("families", name, print)
    assert registry.find("families", name) is print


def test_names_of_studies_have_numbers_with_points() -> None:
    registry.register("studies", "table-7.1", print)
    with pytest.raises(
        BadArgument, match=r"'name' of register\('effects', ...\) must be lower-case"
    ):
        registry.register("effects", "table-7.1", print)


@pytest.mark.parametrize("kind", registry.kinds())
def test_the_built_in_names_keep_the_rule(kind: str) -> None:
    assert all(registry.is_name(kind, name) for name in registry.BUILT_IN[kind])


@pytest.mark.parametrize(
    "name",
    [".tlm", "Bad Name", "Upper", "", "a:b", "a/b", "a=1", "a,b", "-a", "a--b", "a_", "é", 3],
)
def test_other_names_are_refused(name: str) -> None:
    """They have another meaning on the command line or in files, or are mistyped easily."""
    words = "must be lower-case words or numbers joined by - or _, such as 'my-part'. Got "
    with pytest.raises(BadArgument) as found:
        registry.register("readers", name, print)
    assert f"{words}{name!r}" in str(found.value)


@pytest.mark.parametrize(
    ("kind", "name", "what"),
    [("readers", "csv", "reader"), ("effects", "joint_damping", "effect")],
)
def test_what_is_built_in_is_not_replaced(kind: str, name: str, what: str) -> None:
    before = registry.find(kind, name)
    with pytest.raises(BadArgument, match=f"The {what} '{name}' is built in"):
        registry.register(kind, name, print)
    assert registry.find(kind, name) is before


def test_a_name_belongs_to_the_file_that_registered_it_first(tmp_path: Path) -> None:
    """That file may be run again; another one is told whose name it is."""
    text = (
        "import dropo\n\n\ndef part():\n    pass\n\n\ndropo.register('families', 'shared', part)\n"
    )
    first, second = (tmp_path / f"{name}_of_the_test.py" for name in ("one_part", "other_part"))
    for file in (first, second):
        file.write_text(text)
    load_plugins(first)
    assert load_plugins(first) == ["families: shared"]
    words = "line 8.*The family 'shared' is registered already, by one_part_of_the_test"
    with pytest.raises(BadFile, match=words):
        load_plugins(second)
    assert registry.find("families", "shared").__module__ == first.stem
    sys.modules.pop(first.stem)


def test_an_unknown_name_may_be_one_of_the_callers_own() -> None:
    """The message says how such a part is found; not of a name that is nearly a known one."""
    with pytest.raises(UnknownName) as found:
        registry.find("families", "gumbel")
    assert str(found.value).startswith("No family called 'gumbel'. There is full, ")
    assert str(found.value).endswith(f" {registry.HINT}")
    assert "--plugin FILE" in registry.HINT
    with pytest.raises(UnknownName) as found:
        registry.find("families", "uniforn")
    assert str(found.value) == "No family called 'uniforn'. Did you mean 'uniform'?"


def test_there_are_no_other_kinds() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'optimizers'"):
        registry.register("optimizer", "mine", print)
