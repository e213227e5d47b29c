"""The drawing of the rooms is made from the import contracts, and is that of the documentation."""

import importlib.util
import re
import xml.etree.ElementTree as ET
from pathlib import Path

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
