"""Cameras, poses and the picture of the robot, without a graphics library."""

import json
import re

import numpy as np
import pytest

from dropo.report.folder import read_result
from dropo.report.robot.camera import Camera, camera_of
from dropo.report.robot.picture import HEIGHT, WIDTH, scene_of, where_section
from dropo.report.robot.poses import FACTORS, SEEN, WANTED, enlargement, poses_of


def test_a_camera_projects_as_mujocos():
    """What it looks at is in the middle; right, up and nearer are where they should be."""
    camera = Camera(np.array([1.0, 2.0, 0.5]), 3.0, 90.0, 0.0)
    points = camera.lookat + np.array([[0, 0, 0], [0.3, 0, 0], [0, 0, 0.3], [0, -1.0, 0]])
    places, scale = camera.project(points, 400, 300)
    half = 150 / np.tan(np.deg2rad(22.5)) / 3.0
    np.testing.assert_allclose(places[0], (200, 150))
    np.testing.assert_allclose(places[1], (200 + 0.3 * half, 150))
    np.testing.assert_allclose(places[2], (200, 150 - 0.3 * half))
    assert scale[3] > scale[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_the_camera_looks_across_the_motion(axis):
    """Along the level axis about which things turn; all that moves is in the picture."""
    turn = np.linspace(0, 2 * np.pi, 50)
    places = np.zeros((50, 1, 3))
    places[:, 0, 1 - axis] = np.cos(turn)
    places[:, 0, 2] = np.sin(turn)
    camera, path = camera_of(places, np.array([0.1]), WIDTH / HEIGHT)
    forward = np.array([np.cos(np.deg2rad(camera.azimuth)), np.sin(np.deg2rad(camera.azimuth))])
    assert abs(forward[axis]) == pytest.approx(1.0)
    seen, _ = camera.project(places[:, 0], WIDTH, HEIGHT)
    assert (seen > 0).all()
    assert (seen < (WIDTH, HEIGHT)).all()
    assert np.ptp(seen[:, 1]) > 0.6 * HEIGHT
    assert np.ptp(path, axis=0).max() == 0


def test_what_goes_away_is_followed_and_what_is_level_is_seen_from_above():
    """Two parts that drive ten metres over the floor; control: at a place the camera stays."""
    places = np.zeros((100, 2, 3))
    places[:, 1, 1] = 0.5
    places[..., 0] = np.linspace(0, 10, 100)[:, None]
    sizes = np.array([0.1, 0.1])
    camera, path = camera_of(places, sizes, 1.5, True)
    assert camera.elevation < -40
    assert np.ptp(path[:, 0]) > 8
    assert camera.distance < 3
    assert np.ptp(camera_of(places, sizes, 1.5)[1], axis=0).max() == 0


@pytest.mark.parametrize(
    ("off", "factor"),
    [(0.0, 1), (0.5, 1), (2 * SEEN, 1), (2 * SEEN / 1.1, 2), (1e-3, 200), (1e-9, FACTORS[-1])],
)
def test_small_errors_are_enlarged_and_no_more(off, factor):
    """Of a robot of 2 m: those that are seen stay as they are; none becomes larger than wanted."""
    places = np.array([[[0.0, 0, 0], [2.0, 0, 0]]]).repeat(30, axis=0)
    errors = np.full((30, 2), off)
    found = enlargement(errors, places, np.zeros(2))
    assert found == factor
    assert found == 1 or found * off <= WANTED * 2.0


def test_poses_are_measured_ones_with_errors(diagnosis_folder):
    """Joint angles as in the data; before is off by the factor times its error, after by less."""
    result = read_result(diagnosis_folder)
    scene = scene_of(result)
    found = poses_of(result.predictions, scene.simulator)
    run = result.predictions.run
    shown = len(found.times)
    np.testing.assert_allclose(found.measured, run.rows[:shown, :2])
    errors = found.factor * (run.before - run.measured)[:shown, :2]
    np.testing.assert_allclose(found.before - found.measured, errors, atol=1e-12)
    assert np.abs(found.after - found.measured).max() < np.abs(errors).max()
    np.testing.assert_allclose(
        scene.qpos[None], found.measured[(found.measured == scene.qpos).all(1)][:1]
    )


def test_the_mark_is_at_the_joint(diagnosis_folder):
    """Between both links, with its number, size and unit; words for those who cannot see."""
    result = read_result(diagnosis_folder)
    section = where_section(result, "")
    ring = re.search(r'class="ring" cx="([\d.]+)" cy="([\d.]+)"', section.body)
    scene = scene_of(result)
    ends = [
        tuple(map(float, one.split(",")))
        for line in re.findall(r'part-core" points="([^"]+)"', section.body)
        for one in line.split()
    ]
    place = np.array([float(ring[1]), float(ring[2])])
    near = sorted(np.linalg.norm(np.array(ends) - place, axis=1))
    assert len(ends) == 4
    assert near[1] < 3
    assert near[2] > 50
    assert "1: joint damping at elbow." in section.body
    assert "N m s/rad" in section.body
    assert scene.simulator.model.nq == 2


def test_an_effect_without_a_place_and_a_folder_without_a_model(diagnosis_folder, copy_of):
    """Said in words, no mark; without extended/ the page has no such section."""
    folder = copy_of(diagnosis_folder)
    content = json.loads((folder / "diagnosis.json").read_text())
    content["causes"][0] |= {"effect": "gravity_tilt", "target": None}
    (folder / "diagnosis.json").write_text(json.dumps(content))
    section = where_section(read_result(folder), "")
    assert "It acts on the whole robot" in section.body
    assert "ring" not in section.body
    (folder / "extended" / "problem.yaml").write_text("model: none.xml\n")
    assert where_section(read_result(folder), "") is None
    content["causes"] = []
    (folder / "diagnosis.json").write_text(json.dumps(content))
    assert where_section(read_result(folder), "") is None
