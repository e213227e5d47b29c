"""A picture of the robot with the place of each cause: drawn as lines, or over a rendered still."""

import base64
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dropo.core.services.errors import InvalidInput
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Cause, effect_in_words
from dropo.mjmodel.appearance import (
    GeomOutline,
    element_places,
    part_places,
    part_sizes,
    posed,
    shapes,
)
from dropo.mjmodel.joints import reference_pose
from dropo.report.folder import Result
from dropo.report.page import Section, plain
from dropo.report.robot.camera import Camera, camera_of
from dropo.report.robot.poses import poses_of

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator

WIDTH = 480
HEIGHT = 400
BADGE = 15
"""Radius of a number's disc."""
AWAY = 52
"""How far it stands from its place."""
POSES = 40
"""Measured poses from which the one that shows most is taken."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot in a pose, seen by a camera.

    Attributes
    ----------
    simulator : RobotSimulator
        Of the extended model.
    qpos : (nq,) array
        The pose.
    camera : Camera
        The camera.
    """

    simulator: "RobotSimulator"
    qpos: Array
    camera: Camera


def scene_of(result: Result) -> Scene | None:
    """Place the extended model of a diagnosis before a camera.

    Parameters
    ----------
    result : Result
        The diagnosis.

    Returns
    -------
    Scene or None
        None where the extended model is not in the folder, or cannot be read.
    """
    path = result.folder / str(result.content.get("extended_problem") or "")
    simulator = None
    if path.is_file():
        simulator = _simulator(path.resolve(), path.stat().st_mtime_ns)
    if simulator is None:
        return None
    model = simulator.model
    qpos = reference_pose(model)
    places = part_places(model, qpos[None])
    sizes = part_sizes(model)
    if result.predictions is not None:
        poses = poses_of(result.predictions, simulator, POSES)
        camera, _ = camera_of(poses.places, poses.sizes, WIDTH / HEIGHT)
        areas = [_area(camera, shapes(model, posed(model, own))) for own in poses.measured]
        best = int(np.argmax(areas))
        qpos = poses.measured[best]
        places = poses.places[best : best + 1]
        alone, _ = camera_of(places, sizes, WIDTH / HEIGHT)
        seen = Camera(alone.lookat, alone.distance, camera.azimuth, camera.elevation)
        return Scene(simulator, qpos, seen)
    return Scene(simulator, qpos, camera_of(places, sizes, WIDTH / HEIGHT)[0])


@lru_cache(maxsize=1)
def _simulator(path: Path, written: int) -> "RobotSimulator | None":
    """The simulator of a problem file of some time, if it has a model and can be read."""
    from dropo.mjmodel.robot_simulator import RobotSimulator
    from dropo.problems.loading import load

    try:
        found = load(path, checked=False, trusted=False).simulator
    except InvalidInput:
        return None
    return found if isinstance(found, RobotSimulator) else None


def _area(camera: Camera, parts: list[GeomOutline]) -> float:
    """How much of the picture the moving parts of a robot span."""
    moving = [part.points for part in parts if not part.ground]
    if not moving:
        return 0.0
    seen, _ = camera.project(np.concatenate(moving), WIDTH, HEIGHT)
    return float(np.linalg.det(np.cov(seen.T) + np.eye(2))) if len(seen) > 1 else 0.0


def still(scene: Scene) -> bytes:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
        What is seen.

    Returns
    -------
    bytes
        A PNG file.

    Raises
    ------
    DropoError
        If MuJoCo cannot draw on this machine.
    """
    import io

    from matplotlib.image import imsave

    from dropo.report.robot.renderer import RobotRenderer

    model = scene.simulator.model
    renderer = RobotRenderer(model, WIDTH, HEIGHT)
    try:
        renderer.aim(scene.camera, scene.camera.lookat)
        image = renderer.frame(scene.qpos, plain=False)
    finally:
        renderer.close()
    file = io.BytesIO()
    imsave(file, image, format="png")
    return file.getvalue()


def where_section(result: Result, changes: str) -> Section | None:
    """Show the robot with a numbered mark at the place of each cause, and what to type.

    Parameters
    ----------
    result : Result
        The diagnosis.
    changes : str
        Of `changes_part`.

    Returns
    -------
    Section or None
        None where there is no cause, or no model.
    """
    scene = scene_of(result)
    causes = [Cause.from_json(saved) for saved in result.content["causes"]]
    if not causes or scene is None:
        return None
    model = scene.simulator.model
    data = posed(model, scene.qpos)
    marks: list[tuple[str, Array]] = []
    items = []
    numbers = count(1)
    for cause in causes:
        named = effect_in_words(cause.effect, cause.target, cause.variant, cause.formula)
        sizes = ", ".join(
            f"{name} {one.value:+.4g}{_error(one.se)} {one.unit.removeprefix('1')}".rstrip()
            for name, one in cause.estimate.items()
        )
        places = element_places(model, data, cause.effect, cause.target) if cause.target else []
        sign = str(next(numbers)) if places else "–"
        marks += [(sign, place) for place in places]
        whole = "" if places else " It acts on the whole robot, in no one place."
        phrase = f"{named[:1].upper()}{named[1:]}" + f": {sizes}" * bool(sizes)
        items.append(f"<li><b>{sign}</b> <span>{escape(phrase)}.{whole}</span></li>")
    image = b"" if result.media is None else result.media.still
    text = ". ".join(
        f"{k}: {effect_in_words(cause.effect, cause.target, cause.variant)}"
        for k, cause in enumerate(causes, 1)
    )
    svg = _svg(scene, shapes(model, data), marks, image, f"The robot, with causes marked. {text}.")
    listed = f'<ol class="marks">{"".join(items)}</ol>'
    pose = "its model's own pose" if result.predictions is None else "a pose of the data"
    lead = f"The robot in {pose}; a number stands where each cause acts."
    body = f'<div class="pair"><figure>{svg}</figure><div>{listed}{changes}</div></div>'
    return Section("Where it is, and what to type", lead, body)


def _error(se: float) -> str:
    """The standard error behind a number, where it has one."""
    return f" ± {plain(se, 2)}" if np.isfinite(se) else ""


def _svg(
    scene: Scene, parts: list[GeomOutline], marks: list[tuple[str, Array]], image: bytes, text: str
) -> str:
    """The picture: a still or lines, then the marks."""
    drawn = _lines(scene.camera, parts)
    if image:
        data = base64.b64encode(image).decode()
        drawn = f'<image width="{WIDTH}" height="{HEIGHT}" href="data:image/png;base64,{data}"/>'
    centre, _ = scene.camera.project(scene.camera.lookat[None], WIDTH, HEIGHT)
    solid = _filled(scene.camera, parts)
    badges: list[Array] = []
    shown = []
    for sign, place in marks:
        (at,), _ = scene.camera.project(place[None], WIDTH, HEIGHT)
        badge = _free(at, centre[0], badges, solid)
        badges.append(badge)
        shown.append(_mark(sign, at, badge))
    return (
        f'<svg role="img" aria-label="{escape(text)}" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'class="robot">{drawn}{"".join(shown)}</svg>'
    )


def _lines(camera: Camera, parts: list[GeomOutline]) -> str:
    """The outlines of a robot's parts, the far ones first."""
    drawn = []
    for part in parts:
        places, scale = camera.project(part.points, WIDTH, HEIGHT)
        kind = "ground" if part.ground else "part"
        width = max(2.0, 2 * part.radius * float(scale.mean()))
        if part.ground and (np.ptp(places, axis=0) > 4 * WIDTH).any():
            continue  # a floor, or a wall around it
        if len(places) == 1:
            x, y = places[0]
            r = max(2.0, width / 2)
            element = f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}"/>'
        elif len(places) == 2:
            ends = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
            element = "".join(
                f'<polyline class="{own}" points="{ends}" stroke-width="{w:.1f}"/>'
                for own, w in ((f"{kind}-rim", width), (f"{kind}-core", max(1.0, width - 3)))
            )
        else:
            ends = " ".join(f"{x:.1f},{y:.1f}" for x, y in _hull(places))
            element = f'<polygon class="{kind}" points="{ends}"/>'
        drawn.append((not part.ground, float(scale.mean()), element))
    return "".join(element for *_, element in sorted(drawn, key=lambda one: one[:2]))


def _hull(places: Array) -> Array:
    """The corners of the convex hull of places (n, 2), in order."""
    ordered = np.unique(places.round(1), axis=0)
    if len(ordered) < 3:
        return ordered

    def chain(points: Array) -> list[Array]:
        kept: list[Array] = []
        for point in points:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: Array, b: Array, c: Array) -> float:
    """Above 0 where the way from a over b to c turns left."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _filled(camera: Camera, parts: list[GeomOutline]) -> Array:
    """Places (n, 2) all along the moving parts of a robot."""
    shares = np.linspace(0, 1, 9)[:, None, None]
    along = [np.zeros((0, 3))]
    for part in parts:
        if not part.ground:
            middle = part.points.mean(axis=0)
            along.append((shares * part.points + (1 - shares) * middle).reshape(-1, 3))
    return camera.project(np.concatenate(along), WIDTH, HEIGHT)[0]


def _free(at: Array, centre: Array, others: list[Array], solid: Array) -> Array:
    """Where a number stands: beside its place, in the picture, off the robot and the others."""
    low = np.full(2, BADGE + 3.0)
    high = np.array([WIDTH, HEIGHT]) - BADGE - 3.0
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    best = at
    room = -np.inf
    ways = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for way in np.concatenate([ways, 1.8 * ways]):
        tried = np.clip(at + AWAY * way, low, high)
        off = [np.linalg.norm(solid - tried, axis=1).min(initial=AWAY)]
        off += [2 * np.linalg.norm(tried - one) - 2 * BADGE for one in others]
        off.append(float(np.linalg.norm(tried - at)))
        own = min(float(min(off)), AWAY / 2) + 1e-3 * float(way @ (at - centre))
        own -= 0.1 * float(np.linalg.norm(way))  # near its place
        if own > room:
            best = tried
            room = own
    return best


def _mark(sign: str, at: Array, badge: Array) -> str:
    """A ring at a place, with its number beside it."""
    x, y = at
    u, v = badge
    return (
        f'<g class="mark"><line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}"/>'
        f'<circle class="ring" cx="{x:.1f}" cy="{y:.1f}" r="10"/>'
        f'<circle class="disc" cx="{u:.1f}" cy="{v:.1f}" r="{BADGE}"/>'
        f'<text x="{u:.1f}" y="{v:.1f}" dy="6" text-anchor="middle">{escape(sign)}</text></g>'
    )
