"""Robots by file and by name, their drives, and what is refused."""

import sys
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.mjmodel.files.robots import (
    DriveGuess,
    RobotFile,
    add_drives,
    find_robot,
    load_spec,
    write_spec,
)

ARM = """<mujoco model="lab arm"><compiler meshdir="{place}"/><asset>{assets}</asset>
<worldbody><body name="link">
<joint name="hinge" axis="0 1 0"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_files_that_are_no_robots(tmp_path: Path) -> None:
    """Neither form; one that MuJoCo refuses; a comment's words do not count."""
    path = tmp_path / "arm.xml"
    path.write_text("<!-- <mujoco/> --><sdf/>")
    with pytest.raises(BadFile, match="MJCF or URDF file, with <mujoco> or <robot>, got neither"):
        find_robot(path)
    path.write_text("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>")
    with pytest.raises(BadFile, match=r"a model that compiles, got .*mass"):
        load_spec(find_robot(path))
    with pytest.raises(BadFile, match="an MJCF or URDF file, got a folder"):
        find_robot(tmp_path)
    path.write_text(ARM.format(place="", assets=""))
    assert find_robot(path) == RobotFile("lab arm", path, False)


def test_descriptions_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that cannot be fetched, one that is in another form."""
    package = ModuleType("robot_descriptions")
    listed = ModuleType("robot_descriptions._descriptions")
    names = {"far_description": 1, "odd_description": 1}
    monkeypatch.setattr(listed, "DESCRIPTIONS", names, raising=False)
    odd = ModuleType("robot_descriptions.odd_description")
    for module in (package, listed, odd):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    with pytest.raises(BadFile, match="far_description: expected a description that can be fetch"):
        find_robot("far")
    with pytest.raises(BadFile, match="a description as MJCF or URDF, got another"):
        find_robot("odd")


def test_drives_act_as_they_are_called(tmp_path: Path) -> None:
    """The force of each at a command of 0.3 and at rest, by its gains."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(place="", assets=""))
    forces = {}
    for drive in (
        DriveGuess("position", 20.0, 1.0),
        DriveGuess("velocity", 0.0, 4.0),
        DriveGuess("torque"),
    ):
        spec, _ = load_spec(find_robot(path))
        add_drives(spec, {"hinge": drive})
        model = spec.compile()
        data = mujoco.MjData(model)
        data.ctrl[0] = 0.3
        mujoco.mj_forward(model, data)
        forces[drive.kind] = data.qfrc_actuator[0]
        data.qvel[0] = 0.5
        mujoco.mj_forward(model, data)
        forces[f"{drive.kind}, moving"] = data.qfrc_actuator[0]
    assert forces == pytest.approx(
        {
            "position": 6.0,
            "position, moving": 5.5,
            "velocity": 1.2,
            "velocity, moving": -0.8,
            "torque": 0.3,
            "torque, moving": 0.3,
        }
    )


def test_a_written_model_finds_its_meshes(tmp_path: Path) -> None:
    """From another folder, by the path from there."""
    meshes = tmp_path / "robot" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "part.obj").write_text(TETRAHEDRON)
    path = tmp_path / "robot" / "arm.xml"
    path.write_text(ARM.format(place=meshes, assets='<mesh name="part" file="part.obj"/>'))
    spec, left_out = load_spec(find_robot(path))
    assert left_out == []
    out = tmp_path / "out"
    out.mkdir()
    (out / "arm.xml").write_text(write_spec(spec, out, "Made of arm.xml."))
    text = (out / "arm.xml").read_text()
    assert text.startswith("<!-- Made of arm.xml. -->")
    assert "../robot/meshes" in text
    model = mujoco.MjModel.from_xml_path(str(out / "arm.xml"))
    assert model.nmesh == 1
    assert np.isfinite(model.mesh_vert).all()
