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
from typing import Any
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
WIDTH = 352  # pixels, for a phone
ROW = 46  # height of a box
GAP = 6  # between boxes
MARGIN = 8  # of a layer around its boxes
ARROW = 20  # between layers
LINE = "#868e96"  # a grey that shows on white and on black
FLOORS = "contracts, records, numerics, services"
PHRASES = {
    "cli": ("the commands", "#5c4b8a"),
    "studies": ("the papers' tables", "#5c4b8a"),
    "training": ("policies under a fit", "#5c4b8a"),
    "report": ("page and video", "#5c4b8a"),
    "testing": ("checks for plug-ins", "#5c4b8a"),
    "plots": ("figures", "#5c4b8a"),
    "diagnosis": ("search for causes", "#1f5f99"),
    "problems": ("files and built-in ones", "#1f5f99"),
    "logs": ("raw logs to data", "#1f5f99"),
    "data": ("reading and checks", "#1f5f99"),
    "evaluation": ("how good, how sure", "#1f5f99"),
    "estimators": ("methods", "#1b6e53"),
    "simulators": ("predictions", "#1b6e53"),
    "effects": ("what a model lacks", "#1b6e53"),
    "families": ("distributions", "#1b6e53"),
    "likelihoods": ("how well a draw fits", "#1b6e53"),
    "optimizers": ("searches, samplers", "#1b6e53"),
    "mjmodel": ("the only reader of MuJoCo models", "#444b52"),
    "core": (FLOORS, "#444b52"),
}
"""What each room holds, and a colour for its kind: uses, steps, plug-ins, ground."""


@dataclass(frozen=True)
class Box:
    """A room at its place in the drawing, in pixels."""

    room: str
    x: float
    y: float
    width: float


def read_layers(pyproject: Path) -> list[list[str]]:
    """Reads the layers of rooms from the import contracts, the highest first.

    Parameters
    ----------
    pyproject : Path
        A file with `[[tool.importlinter.contracts]]` of type "layers". Among several, the one with
        the most rooms is taken.

    Returns
    -------
    list of lists of str
        The names of the rooms, without "dropo.", layer by layer.

    Raises
    ------
    SystemExit
        If the file has no contract of layers of rooms.
    """
    tool = tomllib.loads(pyproject.read_text()).get("tool", {})
    contracts = tool.get("importlinter", {}).get("contracts", [])
    found = [layers_of(one) for one in contracts if one.get("type") == "layers"]
    rooms = [layers for layers in found if not any("." in room for row in layers for room in row)]
    if not rooms:
        raise SystemExit(f"{pyproject} has no contract of layers of rooms under tool.importlinter.")
    return max(rooms, key=lambda layers: sum(map(len, layers)))


def layers_of(contract: dict[str, Any]) -> list[list[str]]:
    """Returns the rooms of one contract; a layer is "a", "a | b" or "a : b", optional ones in
    parentheses.
    """
    layers = []
    for layer in contract["layers"]:
        names = re.split(r"[|:]", layer)
        layers.append([name.strip(" ()").removeprefix("dropo.") for name in names])
    return layers


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


def draw(layers: list[list[str]]) -> str:
    """Draws the layers.

    Parameters
    ----------
    layers : list of lists of str
        The rooms, layer by layer, the highest first.

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
        lines += room_box(box)
    return "\n".join([*lines, "</svg>", ""])


def arrow(y: float) -> str:
    """Draws an arrow from one layer down to the next."""
    x = WIDTH / 2
    end = y + ARROW - 2
    path = f"M{x:g} {y + 2:g}V{end:g}M{x - 5:g} {end - 6:g}L{x:g} {end:g}L{x + 5:g} {end - 6:g}"
    return f'<path d="{path}" fill="none" stroke="{LINE}" stroke-width="2"/>'


def room_box(box: Box) -> list[str]:
    """Draws a room: its name above what it holds."""
    phrase, colour = PHRASES[box.room]
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
    arguments.out.write_text(draw(layers))


if __name__ == "__main__":
    main()
