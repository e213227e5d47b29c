"""Draws the rooms of dropo in layers, docs/images/architecture.svg.

The layers are read from the import contracts in pyproject.toml, so that the drawing shows what
`lint-imports` keeps; tests/test_architecture.py compares the file with what this script draws.
To draw it anew: `python docs/make_architecture.py`.
"""

import argparse
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
WIDTH = 352  # pixels, for a phone
ROW = 46  # height of a box
GAP = 6  # between boxes
MARGIN = 8  # of a layer around its boxes
ARROW = 20  # between layers
LINE = "#868e96"  # a grey that shows on white and on black
PHRASES = {
    "cli": ("the commands", "#5c4b8a"),
    "studies": ("the papers' tables", "#5c4b8a"),
    "training": ("policies under a fit", "#5c4b8a"),
    "report": ("page and video", "#5c4b8a"),
    "exports": ("for other tools", "#5c4b8a"),
    "testing": ("checks for plug-ins", "#5c4b8a"),
    "plots": ("figures", "#5c4b8a"),
    "diagnosis": ("search for causes", "#1f5f99"),
    "problems": ("files and built-in ones", "#1f5f99"),
    "logs": ("raw logs to data", "#1f5f99"),
    "data": ("reading and checks", "#1f5f99"),
    "executors": ("processes, clusters", "#1b6e53"),
    "evaluation": ("how good, how sure", "#1f5f99"),
    "estimators": ("methods", "#1b6e53"),
    "simulators": ("predictions", "#1b6e53"),
    "effects": ("what a model lacks", "#1b6e53"),
    "families": ("distributions", "#1b6e53"),
    "likelihoods": ("how well a draw fits", "#1b6e53"),
    "optimizers": ("searches, samplers", "#1b6e53"),
    "mjmodel": ("the only reader of MuJoCo models", "#444b52"),
    "core": ("what all stand on", "#444b52"),
}
"""What each room holds, and a colour for its kind: uses, steps, plug-ins, ground."""


@dataclass(frozen=True)
class Box:
    """A room at its place in the drawing, in pixels."""

    room: str
    x: float
    y: float
    width: float


def read_layers(pyproject: Path, container: str = "dropo") -> list[list[str]]:
    """Reads the layers of a package from the import contracts, the highest first.

    Parameters
    ----------
    pyproject : Path
        A file with `[[tool.importlinter.contracts]]` of type "layers".
    container : str
        The package whose parts are in layers: the contract with it among its `containers`.

    Returns
    -------
    list of lists of str
        The names of the parts, layer by layer.

    Raises
    ------
    SystemExit
        If the file has no such contract.
    """
    tool = tomllib.loads(pyproject.read_text()).get("tool", {})
    for contract in tool.get("importlinter", {}).get("contracts", []):
        if contract.get("type") == "layers" and container in contract.get("containers", []):
            layers = [parts_of(layer) for layer in contract["layers"]]
            return [layer for layer in layers if layer]
    raise SystemExit(f"{pyproject} has no import contract of layers in {container!r}.")


def parts_of(layer: str) -> list[str]:
    """Returns the names in a layer: "a", "a | b" or "a : b", optional ones in parentheses.

    Single files such as _version.py are no rooms, and are left out.
    """
    names = [name.strip(" ()") for name in re.split(r"[|:]", layer)]
    return [name for name in names if not name.startswith("_")]


def check_rooms(layers: list[list[str]], package: Path) -> None:
    """Checks that the layers hold every room of the package, once, and no other.

    Parameters
    ----------
    layers : list of lists of str
        The rooms, layer by layer.
    package : Path
        The folder whose subfolders are the rooms.

    Raises
    ------
    SystemExit
        If a room is in no layer or in two, is not there, or has no words in `PHRASES`.
    """
    named = sorted(room for layer in layers for room in layer)
    there = sorted(path.parent.name for path in package.glob("*/__init__.py"))
    there = [room for room in there if len(list((package / room).rglob("*.py"))) > 1]
    if named != there:
        raise SystemExit(f"The contract has the rooms {named}, and the package {there}.")
    silent = [room for room in named if room not in PHRASES]
    if silent:
        raise SystemExit(f"Say in PHRASES what these rooms hold: {', '.join(silent)}.")


def place(layers: list[list[str]]) -> tuple[list[Box], list[tuple[float, float]]]:
    """Places the boxes, two in a row; also returns the top and height of each layer."""
    boxes = []
    bands = []
    top = 1.0
    inner = WIDTH - 2 - 2 * MARGIN
    half = (inner - GAP) / 2
    for layer in layers:
        rows = -(-len(layer) // 2)
        bands.append((top, rows * ROW + (rows - 1) * GAP + 2 * MARGIN))
        for number, room in enumerate(layer):
            last_alone = number == len(layer) - 1 and number % 2 == 0
            x = 1 + MARGIN + (number % 2) * (half + GAP)
            y = top + MARGIN + (number // 2) * (ROW + GAP)
            boxes.append(Box(room, x, y, inner if last_alone else half))
        top += bands[-1][1] + ARROW
    return boxes, bands


def draw(layers: list[list[str]], floors: list[list[str]]) -> str:
    """Draws the layers.

    Parameters
    ----------
    layers : list of lists of str
        The rooms, layer by layer, the highest first.
    floors : list of lists of str
        The parts of `core`, likewise, which stand in its box.

    Returns
    -------
    str
        A picture in SVG, 352 pixels wide, with letters of 12 pixels or more.
    """
    boxes, bands = place(layers)
    height = bands[-1][0] + bands[-1][1] + 1
    rows = "; ".join(", ".join(layer) for layer in layers)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height:g}" '
        f'viewBox="0 0 {WIDTH} {height:g}" role="img" font-family="sans-serif">',
        f"<title>Rooms from the top layer to the lowest: {escape(rows)}.</title>",
    ]
    for top, tall in bands:
        lines.append(
            f'<rect x="1" y="{top:g}" width="{WIDTH - 2}" height="{tall:g}" rx="8" fill="none" '
            f'stroke="{LINE}"/>'
        )
    for top, tall in bands[:-1]:
        lines.append(arrow(top + tall))
    for box in boxes:
        phrase, colour = PHRASES[box.room]
        if box.room == "core":
            phrase = ", ".join(part for floor in floors for part in floor)
        lines += room_box(box, phrase, colour)
    return "\n".join([*lines, "</svg>", ""])


def arrow(y: float) -> str:
    """Draws an arrow from one layer down to the next."""
    x = WIDTH / 2
    end = y + ARROW - 2
    path = f"M{x:g} {y + 2:g}V{end:g}M{x - 5:g} {end - 6:g}L{x:g} {end:g}L{x + 5:g} {end - 6:g}"
    return f'<path d="{path}" fill="none" stroke="{LINE}" stroke-width="2"/>'


def room_box(box: Box, phrase: str, colour: str) -> list[str]:
    """Draws a room: its name above what it holds."""
    middle = box.x + box.width / 2
    common = f'x="{middle:g}" fill="#ffffff" text-anchor="middle"'
    return [
        f'<rect x="{box.x:g}" y="{box.y:g}" width="{box.width:g}" height="{ROW}" rx="5" '
        f'fill="{colour}"/>',
        f'<text {common} y="{box.y + 19:g}" font-size="14" font-weight="bold">{box.room}</text>',
        f'<text {common} y="{box.y + 36:g}" font-size="12">{escape(phrase)}</text>',
    ]


def main() -> None:
    """Draws the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pyproject", type=Path, default=ROOT / "pyproject.toml")
    parser.add_argument("--out", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    layers = read_layers(arguments.pyproject)
    check_rooms(layers, ROOT / "dropo")
    floors = read_layers(arguments.pyproject, "dropo.core")
    arguments.out.write_text(draw(layers, floors))


if __name__ == "__main__":
    main()
