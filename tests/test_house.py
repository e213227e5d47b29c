"""What neither ruff nor mypy nor import-linter checks: names by string, start-up, texts."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dropo.core.services.registry import BUILT_IN, SERVICES

ROOT = Path(__file__).parents[1]
SOURCES = {
    str(path.relative_to(ROOT / "dropo")): path.read_text()
    for path in sorted((ROOT / "dropo").rglob("*.py"))
}
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
HEAVY = set(SETTINGS["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-module-level-imports"])
REGISTRY = "core/services/registry.py"


def layers():
    """Room -> how high it stands, from the import contract of the rooms."""
    contract = SETTINGS["tool"]["importlinter"]["contracts"][0]
    return {
        room.strip(): -i for i, layer in enumerate(contract["layers"]) for room in layer.split("|")
    }


def rooms_by_string(source):
    """The rooms that a source names in texts such as "dropo.room.module:name"."""
    constants = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant))
    texts = (node.value for node in constants if isinstance(node.value, str))
    found = (re.fullmatch(r"dropo\.(\w+)(?:\.\w+)*(?:\.|:\w+)?", text) for text in texts)
    return {match.group(1) for match in found if match}


def reach_up(name, source):
    """The rooms at or above its own, other than itself, that a file names by string."""
    height = layers()
    own = name.split("/")[0]
    named = rooms_by_string(source) & set(height)
    return {room for room in named if room != own and height[room] >= height[own]}


def test_names_by_string_keep_the_direction_too():
    """Only the registry names rooms above it; the control is a source that does."""
    assert reach_up("core/a.py", 'find("dropo.training.ars:ARS")') == {"training"}
    assert reach_up("cli/a.py", 'find("dropo.training.ars:ARS")') == set()
    files = [name for name in SOURCES if "/" in name and name != REGISTRY]
    assert {name: up for name in files if (up := reach_up(name, SOURCES[name]))} == {}


def test_names_of_the_registry_resolve():
    """Each is something that can be called, in its own module."""
    places = [place for plugins in BUILT_IN.values() for place in plugins.values()]
    for place in [*places, *SERVICES.values()]:
        module, attribute = place.split(":")
        plugin = getattr(importlib.import_module(module), attribute)
        assert callable(plugin), place
        assert plugin.__module__ == module, place


def loaded_by(script):
    """The top-level modules that a script loads."""
    command = [sys.executable, "-c", f"{script}; import sys; print(*sys.modules)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {module.split(".")[0] for module in done.stdout.split()}


def test_starting_is_light():
    """Contracts and command line load no heavy module, `import dropo` not even NumPy or MuJoCo."""
    files = [name for name in SOURCES if name.startswith("core/") and "schema" not in name]
    names = [name.removesuffix(".py").removesuffix("/__init__") for name in files]
    core = [f"dropo.{name.replace('/', '.')}" for name in names]
    start = f"import {', '.join([*core, 'dropo.cli.main', 'dropo.cli.list', 'dropo.testing'])}"
    assert loaded_by(start) & (HEAVY | {"mujoco"}) == set()
    assert loaded_by("import dropo") & (HEAVY | {"mujoco", "numpy"}) == set()


def test_public_names_resolve():
    """Each name of dropo.__all__ is there, and of a wrong one Python names the nearest."""
    import dropo

    assert [name for name in dropo.__all__ if not hasattr(dropo, name)] == []
    with pytest.raises(AttributeError, match="no attribute 'DROPPO'") as caught:
        dropo.DROPPO  # noqa: B018
    assert (caught.value.name, caught.value.obj) == ("DROPPO", dropo)


# in pieces: this file is read too
MACHINE = re.compile(r"(?<![\w.~)\]}-])/(?:wor" + r"k|roo" + r"t|hom" + r"e|tm" + r"p)(?:/|\b)")
TEXTS = {".py", ".pyi", ".md", ".toml", ".yaml", ".yml", ".txt", ".json", ".sh", ".cff", ".xml"}
FOLDERS = ("dropo", "tests", "benchmarks", "papers", "docs", ".ci")


def texts():
    """Every text of the repository's own: its root, and the folders of source and documents."""
    inside = [path for name in FOLDERS for path in (ROOT / name).rglob("*")]
    own = [
        path for path in inside if "__pycache__" not in path.parts and "_build" not in path.parts
    ]
    kinds = TEXTS | {".html", ""}
    return [path for path in [*ROOT.glob("*.*"), *own] if path.is_file() and path.suffix in kinds]


def test_no_path_of_a_machine():
    """Nothing names a folder of the machine it was written on; the control is found."""
    assert MACHINE.search('"' + "/wor" + 'k/main"')
    assert MACHINE.search("see " + "/tm" + "p/x")
    assert not MACHINE.search("https://example.org" + "/hom" + "e and a/wor" + "k")
    lines = []
    for path in texts():
        found = [line[:100] for line in path.read_text().splitlines() if MACHINE.search(line)]
        lines += [(path.name, line) for line in found if path.name != "MUJOCO_LOG.TXT"]
    assert lines == []


PAIRS = {"Point", "Uniform", "RandomEffects"}
"""Names of two classes that are meant as a pair."""


def class_names(sources):
    """The names of all classes, one inside another too."""
    nodes = (node for source in sources for node in ast.walk(ast.parse(source)))
    return [node.name for node in nodes if isinstance(node, ast.ClassDef)]


def test_a_class_has_a_name_of_its_own():
    """But for the pairs that docs/architecture.md names; the control is a name given twice."""
    assert class_names(["class A: ...", "class A:\n    class B: ..."]) == ["A", "A", "B"]
    names = class_names(SOURCES.values())
    assert {name for name in names if names.count(name) > 1} == PAIRS
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert all(f"`{name}`" in page for name in PAIRS)
