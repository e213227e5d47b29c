"""The drawing of the rooms is made from the import contracts, and is that of the documentation;
models are read and stepped where it says.
"""

import ast
import importlib.util
import re
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
CONTRACTS = """
[[tool.importlinter.contracts]]
name = "Floors"
type = "layers"
containers = ["dropo.core"]
layers = ["records", "services"]

[[tool.importlinter.contracts]]
name = "Rooms"
type = "layers"
containers = ["dropo"]
layers = ["cli", "report | training : (plots)", "core", "_version"]
"""


@pytest.fixture(scope="module")
def script():
    """The script docs/make_architecture.py as a module."""
    spec = importlib.util.spec_from_file_location(
        "make_architecture", ROOT / "docs" / "make_architecture.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_layers_are_read_from_the_contract_of_a_package(script, tmp_path):
    """Rooms beside each other, optional ones, and files that are no rooms."""
    path = tmp_path / "pyproject.toml"
    path.write_text(CONTRACTS)
    assert script.read_layers(path) == [["cli"], ["report", "training", "plots"], ["core"]]
    assert script.read_layers(path, "dropo.core") == [["records"], ["services"]]
    with pytest.raises(SystemExit, match="no import contract of layers"):
        script.read_layers(path, "dropo.cli")


def test_rooms_of_contract_and_package_are_the_same(script, tmp_path):
    """A room that is missing on either side is named."""
    for room in ("cli", "core"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "__init__.py").touch()
        (tmp_path / room / "a.py").touch()
    script.check_rooms([["cli"], ["core"]], tmp_path)
    with pytest.raises(SystemExit, match=r"the package \['cli', 'core'\]"):
        script.check_rooms([["cli"]], tmp_path)
    (tmp_path / "core").rename(tmp_path / "attic")
    with pytest.raises(SystemExit, match=r"what these rooms hold: attic"):
        script.check_rooms([["cli"], ["attic"]], tmp_path)


def test_lower_layers_are_drawn_lower(script):
    """Every room stands once, below the layer above, in letters that a phone shows."""
    layers = [["cli"], ["report", "training", "plots"], ["core"]]
    picture = ET.fromstring(script.draw(layers, [["records"], ["services"]]))
    texts = [one for one in picture.iter() if one.tag.endswith("text")]
    height = {one.text: float(one.get("y")) for one in texts}
    assert height["cli"] < height["report"] == height["training"] < height["plots"] < height["core"]
    assert "records, services" in height
    assert min(float(one.get("font-size")) for one in texts) >= 12
    assert float(picture.get("width")) <= 360


def test_the_drawing_is_that_of_the_contracts(script):
    """`python docs/make_architecture.py` would change nothing."""
    layers = script.read_layers(ROOT / "pyproject.toml")
    script.check_rooms(layers, ROOT / "dropo")
    floors = script.read_layers(ROOT / "pyproject.toml", "dropo.core")
    assert script.PICTURE.read_text() == script.draw(layers, floors)


def test_the_page_names_every_room(script):
    """The table in docs/architecture.md has a row for each room, and no other."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    layers = script.read_layers(ROOT / "pyproject.toml")
    assert sorted(rows) == sorted(room for layer in layers for room in layer)


def test_contributing_is_short_and_names_every_room(script):
    """It is read as a whole, and says of each room which tests belong to it."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    assert len(text.splitlines()) <= 30
    layers = script.read_layers(ROOT / "pyproject.toml")
    rooms = {room for layer in layers for room in layer}
    table = "".join(line for line in text.splitlines() if line.startswith("|"))
    assert rooms - set(re.findall(r"`(\w+)`", table)) == set()


READERS = ("mjmodel", "simulators")
"""Rooms that read models by index."""
WRITERS = ("effects",)
"""Those whose functions write the fields of a model, by index too."""
STEPPERS = ("simulators",)
"""Rooms that step a simulation."""
OWN = {"sensor_delay", "plugin"}
"""Fields of MjModel that attributes of the package's own classes are called after too."""
NAMED = {"body", "joint", "geom", "site", "actuator", "sensor", "tendon", "camera", "key"}
"""Methods of MjModel and MjData that give an element by name or index."""
STATE = {"qpos", "qvel", "qacc", "ctrl", "act"}
"""What `data` of a model has, and no other thing of that name in this package."""
STEPS = re.compile(r"mj_(step|Euler|RungeKutta|implicit)")
STEPPING_MODULES = {"mujoco.rollout", "mujoco.batch"}


@cache
def fields_of_models():
    """The names of all arrays of MjModel."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    names = [name for name in dir(model) if not name.startswith("_")]
    return {name for name in names if isinstance(getattr(model, name), np.ndarray)} - OWN


def last_name(node):
    """The name that an expression ends with: of `robot.model` and `model()` it is `model`."""
    if isinstance(node, ast.Call):
        return last_name(node.func)
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def is_model(node):
    """Whether an expression is called a model."""
    return last_name(node).lstrip("_") == "model"


@cache
def nodes_of(source):
    """The attributes, calls and imports of a source, which several tests look through."""
    kinds = (ast.Attribute, ast.Call, ast.Import, ast.ImportFrom)
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]


def reads(source):
    """What of a source reads or writes the numbers of a model, or of its data, by index."""
    fields = fields_of_models()
    found = []
    for node in nodes_of(source):
        by_name = isinstance(node, ast.Call) and last_name(node) in ("getattr", "setattr")
        if by_name and is_model(node.args[0]):
            found.append(f"{node.lineno}: {ast.unparse(node)}")
        if not isinstance(node, ast.Attribute):
            continue
        of_model = is_model(node.value) and node.attr in (*NAMED, "opt")
        of_data = last_name(node.value) == "data" and node.attr in STATE
        if node.attr in fields or of_model or of_data:
            found.append(f"{node.lineno}: {ast.unparse(node)}")
    return found


def calls(source):
    """What of a source calls MuJoCo's functions of a model, or makes its data."""
    found = []
    for node in nodes_of(source):
        names = []
        if isinstance(node, ast.Call):
            names = [last_name(node)]
        elif isinstance(node, ast.ImportFrom) and node.module == "mujoco":
            names = [one.name for one in node.names]
        found += [f"{node.lineno}: {name}" for name in names if re.match(r"mj_|MjData$", name)]
    return found


def steps(source):
    """What of a source steps a simulation."""
    found = []
    for node in nodes_of(source):
        if isinstance(node, ast.Attribute) and STEPS.match(node.attr):
            found.append(f"{node.lineno}: {ast.unparse(node)}")
        modules = []
        if isinstance(node, ast.Import):
            modules = [one.name for one in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules = [node.module, *(f"{node.module}.{one.name}" for one in node.names)]
        found += [f"{node.lineno}: {name}" for name in modules if name in STEPPING_MODULES]
    return found


def sources_outside(*rooms):
    """The sources of the package by their place in it, without those of some rooms."""
    package = ROOT / "dropo"
    paths = {path.relative_to(package): path for path in sorted(package.rglob("*.py"))}
    return {
        str(place): path.read_text() for place, path in paths.items() if place.parts[0] not in rooms
    }


@pytest.mark.parametrize(
    "line",
    [
        "mass = robot.model.body_mass[3]",
        "model.dof_damping[joint.qvel] = 0.1",
        "puck = model.body('puck').mass",
        "step = float(simulator.model.opt.timestep)",
        "place = data.qpos[3]",
        "values = getattr(simulator.model, name)",
    ],
)
def test_readers_of_models_are_found(line):
    """The control of the next test: lines that read a model."""
    assert len(reads(line)) == 1


@pytest.mark.parametrize(
    "line",
    [
        "n = model.nq",
        "spec.body('box').mass = 1",
        "x = joint.qpos",
        "v = state.qvel[:, 2]",
        "u = content.ctrl",
        "delay = instance.sensor_delay",
    ],
)
def test_what_only_looks_alike_is_no_reading(line):
    """Sizes, specifications and attributes of the package's own classes."""
    assert reads(line) == []


def test_only_mjmodel_and_simulators_read_models():
    """No other room indexes MjModel or MjData but effects, which write fields."""
    outside = sources_outside(*READERS, *WRITERS)
    assert {place: found for place, text in outside.items() if (found := reads(text))} == {}
    assert any(reads(text) for text in sources_outside(*READERS).values())


def test_only_mjmodel_and_simulators_call_functions_of_models():
    """No other room, effects included, calls `mj_...` or makes an MjData; controls are found."""
    assert len(calls("data = mujoco.MjData(model)")) == 1
    assert len(calls("self.mujoco.mj_fwdPosition(model, data)")) == 1
    assert len(calls("from mujoco import mj_step")) == 1
    assert calls("mujoco.mju_quat2Mat(out, quaternion)") == []
    assert calls("def f(data: mujoco.MjData): ...") == []
    outside = sources_outside(*READERS)
    assert {place: found for place, text in outside.items() if (found := calls(text))} == {}


def test_only_simulators_step():
    """No other room makes a physics step or asks MuJoCo for many; the controls are found."""
    assert len(steps("mujoco.mj_step(model, data, 3)")) == 1
    assert len(steps("from mujoco import rollout")) == 1
    assert len(steps("import mujoco.batch")) == 1
    assert steps("robot.step(command)") == []
    outside = sources_outside(*STEPPERS)
    assert {place: found for place, text in outside.items() if (found := steps(text))} == {}
    assert any(steps(text) for text in sources_outside().values())
