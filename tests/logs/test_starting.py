"""One call makes a complete folder of a robot and its logs, which loads and is right."""

import json
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, BadFile, MissingPackage, UnknownName
from dropo.data.checks.check import check
from dropo.logs.starting import init
from dropo.mjmodel.files.robots import find_robot
from dropo.problems.loading import load
from dropo.problems.simulated.example_log import ExampleMachine, write_example

URDF = """<?xml version="1.0"?>
<robot name="lab_arm">
  <link name="base_link"/>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.15"/><mass value="0.8"/>
      <inertia ixx="0.007" iyy="0.007" izz="0.0004" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><mesh filename="package://lab/meshes/upper.stl"/></geometry></collision>
  </link>
  <link name="lower">
    <inertial><origin xyz="0 0 -0.12"/><mass value="0.4"/>
      <inertia ixx="0.003" iyy="0.003" izz="0.0002" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base_link"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2.0" upper="2.0" effort="12" velocity="8"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <axis xyz="0 1 0"/><origin xyz="0 0 -0.3"/>
    <limit lower="-2.4" upper="2.4" effort="6" velocity="8"/></joint>
</robot>
"""
SHORT = ExampleMachine(rows=240)


@pytest.fixture
def example(tmp_path: Path) -> Path:
    """arm.xml, arm.urdf and three logs of 2.4 s."""
    write_example(tmp_path, machine=SHORT)
    (tmp_path / "arm.urdf").write_text(URDF)
    return tmp_path


def logs(folder: Path) -> list[Path]:
    return sorted(folder.glob("log*.csv"))


def test_a_complete_folder(example: Path) -> None:
    """It loads without an edit, holds out the third run by name, and every number fits the log."""
    found = init(example / "arm.xml", logs(example), example / "out")
    assert sorted(path.name for path in (example / "out").iterdir()) == [
        "data.npz",
        "import.json",
        "map.yaml",
        "problem.yaml",
    ]
    problem = load(example / "out" / "problem.yaml", threads=1)
    assert problem.name == "arm"
    assert problem.horizon == 20
    assert problem.start_noise
    assert problem.held_out is not None
    assert len(problem.held_out.spans) == 1
    assert len(problem.trajectories.spans) == 2
    assert [one for one in check(problem.trajectories, problem) if one.level == "error"] == []
    table = np.loadtxt(logs(example)[2], delimiter=",", skiprows=1)
    held = problem.held_out
    rows = table[1 : len(held)]  # the first has no smoothed velocity
    np.testing.assert_allclose(held.actions[:-1], np.radians(rows[:, 3:]), atol=1e-5)
    assert np.abs(held.observations[:-1, :2] - np.radians(rows[:, 1:3])).max() < 1e-4
    assert found.next == f"dropo diagnose {example / 'out' / 'problem.yaml'}"
    record = json.loads((example / "out" / "import.json").read_text())
    assert record["guesses"] == list(found.lines)
    assert record["robot"] == "arm"


def test_every_commented_parameter_can_be_taken(example: Path) -> None:
    """One of each joint by a pattern; all joint by joint; with bounds around the model's number."""
    init(example / "arm.xml", logs(example), example / "out")
    path = example / "out" / "problem.yaml"
    text = path.read_text()
    head, lines = text.split("# parameters:\n")
    apart = lines.index("#   # or joint by joint")
    each, single = lines[:apart], lines[apart:]
    wanted = {
        "each": (
            each,
            "shoulder_armature elbow_armature shoulder_damping elbow_damping "
            "shoulder_frictionloss elbow_frictionloss gain",
        ),
        "single": (
            single,
            "shoulder_armature shoulder_damping shoulder_frictionloss "
            "elbow_armature elbow_damping elbow_frictionloss "
            "shoulder_servo_gain elbow_servo_gain mass",
        ),
    }
    for block, names in wanted.values():
        path.write_text(head + "parameters:\n" + re.sub(r"(?m)^# ", "", block))
        problem = load(path, threads=1)
        assert problem.space.names == tuple(names.split())
        inside = (problem.simulator.nominal >= problem.space.low) & (
            problem.simulator.nominal <= problem.space.high
        )
        assert inside.all()
    levels = re.search(r"(?m)^# (epsilon: .*)$", text)
    assert levels is not None
    path.write_text(head + levels[1] + "\n")
    assert np.shape(load(path, threads=1).epsilon) == (4,)


def test_one_factor_for_many_places(example: Path) -> None:
    """A shared factor sets all servos at once; each alone would set its own."""
    init(example / "arm.xml", logs(example), example / "out")
    path = example / "out" / "problem.yaml"
    entry = 'field: actuator_kp, name: "*", target: relative, low: 0.2, high: 5'
    path.write_text(path.read_text() + f"parameters: {{gain: {{{entry}, shared: true}}}}\n")
    shared = load(path, threads=1).simulator
    model = shared.model.__copy__()
    shared.bindings[0].set(model, 0.5)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], [15, 7.5])
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], [-15, -7.5])
    path.write_text(path.read_text().replace(", shared: true", ""))
    assert load(path, threads=1).space.names == ("shoulder_servo_gain", "elbow_servo_gain")
    path.write_text(path.read_text().replace('"*"', '"w*"'))
    with pytest.raises(
        BadFile, match=r"gain.name: expected a pattern that fits a actuator: should"
    ):
        load(path, threads=1)


def test_rows_that_stay_as_they_are_count_as_such(example: Path) -> None:
    """Velocities are estimated between the rows; what was logged is on the grid."""
    found = init(example / "arm.xml", logs(example), example / "out").imported
    assert {rows["resampled"] for rows in found.rows.values()} == {0}
    assert "0 rows are resampled" in str(found)
    log = logs(example)[0]
    head, *table = [line.split(",") for line in log.read_text().splitlines()]
    late = [[f"{float(row[0]) + 3 * (i % 2)}", *row[1:]] for i, row in enumerate(table)]
    log.write_text("\n".join(map(",".join, [head, *late])) + "\n")
    found = init(example / "arm.xml", log, example / "out").imported
    (rows,) = found.rows.values()
    assert rows["resampled"] == rows["kept"]


def test_unknown_runs_are_named(example: Path) -> None:
    init(example / "arm.xml", logs(example), example / "out")
    path = example / "out" / "problem.yaml"
    path.write_text(path.read_text().replace("- log3", "- log4"))
    with pytest.raises(BadFile, match=r"held_out.runs: expected the name of a run .the nearest is"):
        load(path, threads=1)
    path.write_text(path.read_text().replace("- log4", "- log*"))
    with pytest.raises(BadFile, match=r"held_out.runs: expected some trajectories left to fit"):
        load(path, threads=1)


def test_a_urdf_gets_drives(example: Path) -> None:
    """Servos with gains of the size of the machine's, a step of the log's; meshes are said."""
    found = init(example / "arm.urdf", logs(example), example / "out")
    model = mujoco.MjModel.from_xml_path(str(example / "out" / "model.xml"))
    assert model.opt.timestep == pytest.approx(0.002)
    gains = model.actuator_gainprm[:, 0]
    assert 15 < gains[0] < 60  # 30 in the machine
    assert 7 < gains[1] < 30  # 15 in the machine
    assert "without the meshes upper.stl" in found.lines[0]
    problem = load(example / "out" / "problem.yaml", threads=1)
    assert problem.name == "lab_arm"
    assert problem.simulator.control_step == pytest.approx(0.01)


def test_what_is_given_is_not_guessed(example: Path) -> None:
    """A mapping file of one entry; init again, but not over an edited problem."""
    (example / "mine.yaml").write_text("qpos: {elbow: {sign: -1}}\nrate: 50\n")
    found = init(example / "arm.xml", logs(example), example / "out", mapping=example / "mine.yaml")
    assert found.mapping["qpos"]["elbow"] == {"column": "elbow angle", "unit": "deg", "sign": -1}
    assert found.imported.frame_skip == 10
    init(example / "arm.xml", logs(example), example / "out")
    path = example / "out" / "problem.yaml"
    path.write_text(path.read_text() + "student_t: 5\n")
    with pytest.raises(BadFile, match="got one that was changed"):
        init(example / "arm.xml", logs(example), example / "out")


def test_an_edited_mapping_is_not_lost(example: Path) -> None:
    """Init refuses to write over it, unless it is given, and then takes it."""
    place = example / "out" / "map.yaml"
    init(example / "arm.xml", logs(example), example / "out")
    place.write_text(place.read_text() + "rate: 50\n")
    with pytest.raises(BadFile, match=r"map.yaml: expected no file, .* got one that was changed"):
        init(example / "arm.xml", logs(example), example / "out")
    found = init(example / "arm.xml", logs(example), example / "out", mapping=place)
    assert found.imported.frame_skip == 10


def test_messages_name_the_mapping_that_was_given(example: Path) -> None:
    """Not the file that would have been written."""
    given = example / "mine.yaml"
    given.write_text("qpos: {elbw: {sign: -1}}\n")
    with pytest.raises(BadFile, match=r"mine.yaml: qpos.elbw: .*the nearest is 'elbow'"):
        init(example / "arm.xml", logs(example), example / "out", mapping=given)


def changed(path: Path, change: Any) -> None:
    """Changes the table (n, 5) of a log: ms, two angles, two targets."""
    lines = path.read_text().splitlines()
    table = change(np.loadtxt(path, delimiter=",", skiprows=1))
    rows = [",".join(f"{x:.6g}" for x in row) for row in table]
    path.write_text("\n".join([lines[0], *rows]) + "\n")


def lost_packets(table: Any) -> Any:
    """Three of ten rows are missing."""
    return table[np.random.default_rng(0).uniform(size=len(table)) > 0.3]


def jumping_clock(table: Any) -> Any:
    table[120:, 0] += 700
    return table


BAD = {
    "a clock that jumps": (
        jumping_clock,
        r"time: the clock jumps by 0.71 s, row 120 at 1.9 s: the",
    ),
    "missing packets": (lost_packets, r"rows are missing, .* packets were lost, the first before"),
    "other joints": (None, r"expected columns that name the positions of the joints shoulder, elb"),
}


@pytest.mark.parametrize("fault", BAD)
def test_bad_logs_are_refused(example: Path, fault: str) -> None:
    """One sentence, and nothing is written."""
    change, sentence = BAD[fault]
    for path in logs(example):
        if change is None:
            text = path.read_text()
            path.write_text(text.replace("shoulder", "wheel").replace("elbow", "tail") + "\n")
            break
        changed(path, change)
    with pytest.raises((BadArgument, BadFile), match=sentence):
        init(example / "arm.xml", logs(example), example / "out")
    assert not (example / "out").exists()


def test_degrees_mapped_as_radians(example: Path) -> None:
    (example / "mine.yaml").write_text("qpos: {elbow: {unit: rad}, shoulder: {unit: rad}}\n")
    with pytest.raises(BadArgument, match=r"qpos.\w+: it reaches .* rad, .*: these are degrees."):
        init(example / "arm.xml", logs(example), example / "out", mapping=example / "mine.yaml")
    assert not (example / "out").exists()


def test_a_question_about_commands_is_answered_under_ctrl(example: Path) -> None:
    """What is proposed names the columns in question, and is an answer."""
    log = logs(example)[0]
    text = log.read_text().replace("shoulder target", "shoulder foo")
    log.write_text(text.replace("elbow target", "elbow [foo]"))
    with pytest.raises(BadArgument) as refusal:
        init(example / "arm.xml", log, example / "out")
    said = str(refusal.value)
    assert said.startswith("Are 'shoulder foo', 'elbow [foo]' what the actuators were told?")
    assert "qpos" not in said
    proposed = said.split("`")[1]
    assert proposed == (
        'ctrl: {shoulder_servo: {column: "shoulder foo"}, elbow_servo: {column: "elbow [foo]"}}'
    )
    (example / "mine.yaml").write_text(proposed + "\n")
    found = init(example / "arm.xml", log, example / "out", mapping=example / "mine.yaml")
    assert found.mapping["ctrl"]["elbow_servo"]["column"] == "elbow [foo]"


def test_questions_about_units_and_time_have_their_own_answers(example: Path) -> None:
    """A rate, and a unit; what is proposed of the unit is an answer."""
    turns = np.sin(np.arange(240) / 20)
    rows = [f"{15 * turn},{9 * turn}" for turn in turns]
    (example / "log.csv").write_text("\n".join(["shoulder q,elbow q", *rows]) + "\n")
    free = re.sub(' range="[^"]*"', "", (example / "arm.xml").read_text())
    (example / "free.xml").write_text(free)
    with pytest.raises(BadArgument) as refusal:
        init(example / "free.xml", example / "log.csv", example / "out")
    *_, rate, unit = str(refusal.value).split("`")[1::2]
    assert (rate, unit) == ("rate: HZ", "qpos: {shoulder: {unit: rad}}")
    (example / "mine.yaml").write_text(f"rate: 100\n{unit}\n")
    found = init(
        example / "free.xml", example / "log.csv", example / "out", mapping=example / "mine.yaml"
    )
    assert found.mapping["qpos"]["elbow"]["unit"] == "rad"


def test_robots_by_name(example: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A description's file; of an unknown name the nearest; without the package, how to get it."""
    monkeypatch.setitem(sys.modules, "robot_descriptions._descriptions", None)
    with pytest.raises(MissingPackage, match=r"pip install 'dropo\[robots\]'"):
        find_robot("panda")
    listed = ModuleType("robot_descriptions._descriptions")
    names = {"go2_mj_description": 1, "lab_arm_description": 1}
    monkeypatch.setattr(listed, "DESCRIPTIONS", names, raising=False)
    found = ModuleType("robot_descriptions.lab_arm_description")
    monkeypatch.setattr(found, "URDF_PATH", str(example / "arm.urdf"), raising=False)
    for module in (ModuleType("robot_descriptions"), listed, found):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    robot = find_robot("lab_arm")
    assert (robot.is_urdf, robot.path) == (True, example / "arm.urdf")
    with pytest.raises(UnknownName, match=r"called 'go22'. Did you mean 'go2'\?"):
        find_robot("go22")
    with pytest.raises(BadFile, match="expected an MJCF or URDF file, got no such file"):
        find_robot("arm3.xml")


def test_noisy_velocities_are_smoothed_instead(example: Path) -> None:
    """Coarse logged velocities are left out, and why is said; fine ones are kept."""
    for noise, kept in ((0.5, False), (1e-3, True)):
        for number, path in enumerate(logs(example)):
            table = np.loadtxt(path, delimiter=",", skiprows=1)[:, :5]
            rng = np.random.default_rng(number)
            speeds = np.gradient(table[:, 1:3], 0.01, axis=0)
            speeds = speeds + np.degrees(noise) * rng.standard_normal(speeds.shape)
            rows = [",".join(f"{x:.6g}" for x in row) for row in np.hstack([table, speeds])]
            names = "ms,shoulder angle,elbow angle,shoulder target,elbow target"
            path.write_text("\n".join([names + ",shoulder speed,elbow speed", *rows]) + "\n")
        found = init(example / "arm.xml", logs(example), example / f"out{kept}")
        assert ("qvel" in found.mapping) == kept
        assert any("smoothed from the positions in place" in line for line in found.lines) != kept


def test_a_tossed_box(tmp_path: Path) -> None:
    """A free body alone, its quaternion last to first: mapped, imported, and loaded."""
    text = """<mujoco model="toss"><option timestep="0.001"/><worldbody>
      <body name="box" pos="0 0 1"><freejoint name="box"/>
      <geom type="box" size="0.05 0.05 0.05" mass="0.3"/></body></worldbody>
      </mujoco>"""
    (tmp_path / "box.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:] = [1, 0, 3, 1, 2, 0.5]
    lines = ["time,box_pos_x,box_pos_y,box_pos_z,box_quat_x,box_quat_y,box_quat_z,box_quat_w"]
    for k in range(100):
        numbers = [0.005 * k, *data.qpos[:3], *data.qpos[4:], data.qpos[3]]
        lines.append(",".join(f"{x:.8f}" for x in numbers))
        mujoco.mj_step(model, data, 5)
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    init(tmp_path / "box.xml", tmp_path / "log.csv", tmp_path / "out")
    problem = load(tmp_path / "out" / "problem.yaml", threads=1)
    errors = problem.simulator.predict(np.empty((1, 0)), problem.segments)[0]
    assert np.abs(errors - problem.simulator.targets(problem.segments)).max() < 0.02
    (tmp_path / "log.csv").write_text("\n".join(lines).replace("box_quat", "box_spin") + "\n")
    with pytest.raises(BadFile, match="expected columns that name the positions of the joints box"):
        init(tmp_path / "box.xml", tmp_path / "log.csv", tmp_path / "again")


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_what_a_kill_leaves_is_no_edit(
    example: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Of a new folder's files some stand in their places: the same call makes it whole. So it does
    where another mapping had made a whole one before.
    """
    replace = Path.replace
    done: list[str] = []

    def killed(self: Path, target: Path) -> Path:
        if len(done) == count and self.parent.name == "out":
            raise KeyboardInterrupt
        if target.name in ("data.npz", "problem.yaml", "import.json", "map.yaml", "model.xml"):
            done.append(target.name)
        return replace(self, target)

    def init_killed(**given: Any) -> None:
        done.clear()
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", killed)
            with pytest.raises(KeyboardInterrupt):
                init(example / "arm.urdf", logs(example), example / "out", **given)

    init_killed()
    init(example / "arm.urdf", logs(example), example / "out")
    (example / "mine.yaml").write_text("rate: 50\n")
    init_killed(mapping=example / "mine.yaml")
    init(example / "arm.urdf", logs(example), example / "out", mapping=example / "mine.yaml")
    assert load(example / "out" / "problem.yaml").simulator.control_step == pytest.approx(0.02)
