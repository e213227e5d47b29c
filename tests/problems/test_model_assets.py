"""Models with meshes are written with them, so that the folder can be moved."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from dropo.problems.file.plain_model import write_extended
from dropo.problems.file.verification import PlainRollout
from dropo.problems.loading import load
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.hidden_in_arm import problem

CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)) + (
    "f 1 2 4\nf 1 4 3\nf 5 7 8\nf 5 8 6\nf 1 5 6\nf 1 6 2\n"
    "f 3 4 8\nf 3 8 7\nf 1 3 7\nf 1 7 5\nf 2 6 8\nf 2 8 4\n"
)
XML = """<mujoco><option timestep="0.005"/><compiler {compiler}/>
<asset><mesh name="one" file="{first}"/><mesh name="two" file="{second}" scale="2 2 2"/></asset>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<geom type="mesh" mesh="one" density="300"/>
<body name="fore" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>
<geom type="mesh" mesh="two" density="300"/></body></body></worldbody>
<actuator><motor name="a" joint="shoulder"/><motor name="b" joint="elbow"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("compiler", "first", "second"),
    [
        ("", "meshes/a/cube.obj", "meshes/b/cube.obj"),
        ('meshdir="meshes"', "a/cube.obj", "b/cube.obj"),
        ('assetdir="meshes"', "a/cube.obj", "a/cube.obj"),
    ],
)
def test_meshes_are_beside_the_model(tmp_path, compiler, first, second):
    """Once each, under names of their own; the moved folder has the same masses, is loaded by the
    package and by plain MuJoCo, and holds no path of this computer.
    """
    source = tmp_path / "source"
    for place in ("a", "b"):
        (source / "meshes" / place).mkdir(parents=True)
        (source / "meshes" / place / "cube.obj").write_text(CUBE)
    path = source / "robot.xml"
    path.write_text(XML.format(compiler=compiler, first=first, second=second))
    simulator = MujocoSimulator(path, [], frame_skip=4, threads=1)
    found = replace(problem([], episodes=2, steps=20), simulator=simulator)
    write_extended(found, {}, tmp_path / "out")
    shutil.rmtree(source)
    moved = shutil.move(tmp_path / "out", tmp_path / "elsewhere")
    text = (moved / "model.xml").read_text()
    assert str(tmp_path) not in text
    assert len(list((moved / "assets").iterdir())) == len({first, second})
    back = load(moved / "problem.yaml", threads=1).simulator
    np.testing.assert_allclose(back.model.body_mass, simulator.model.body_mass, rtol=1e-5)
    windows = found.trajectories.from_rows(np.array([0, 5, 20]), 3)
    ours = simulator.predict(np.zeros((1, 0)), windows)[0]
    plain = PlainRollout(back, np.zeros(0), moved, trusted=False).predict(windows)
    np.testing.assert_allclose(plain, ours, atol=1e-9)
