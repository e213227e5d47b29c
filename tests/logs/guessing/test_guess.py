"""Mappings are guessed from names and numbers as loggers write them; what is not clear is asked."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadFile, Incompatible
from dropo.logs.guessing.base import moving_base
from dropo.logs.guessing.guess import guess_mapping
from dropo.logs.guessing.guessed import Guess
from dropo.logs.guessing.words import read_name
from dropo.logs.readers.reader import open_log
from dropo.mjmodel.joints import ModelJoints, model_joints

Columns = dict[str, Any]
SERVOS = """
<mujoco>
  <worldbody>
    <body name="a"><joint name="left_hip" axis="0 1 0" range="-90 90"/>
      <geom size="0.1" mass="1"/>
      <body name="b" pos="0 0 -0.3"><joint name="left_knee" axis="0 1 0" range="-140 0"/>
        <geom size="0.1" mass="1"/></body></body>
  </worldbody>
  <actuator><position name="hip_servo" joint="left_hip" kp="20"/>
    <position name="knee_servo" joint="left_knee" kp="20"/></actuator>
</mujoco>
"""
TIME = np.arange(400) / 200
HIP = 0.7 * np.sin(2.5 * TIME)
KNEE = -0.6 + 0.5 * np.sin(4 * TIME)
SPEEDS = (0.7 * 2.5 * np.cos(2.5 * TIME), 0.5 * 4 * np.cos(4 * TIME))
GOALS = (0.72 * np.sin(2.5 * TIME + 0.1), -0.6 + 0.55 * np.sin(4 * TIME + 0.1))


def robot(text: str = SERVOS) -> ModelJoints:
    return model_joints(mujoco.MjModel.from_xml_string(text))


def guess(folder: Path, columns: Columns, model: ModelJoints | None = None, **more: Any) -> Guess:
    """What is guessed of a log of these columns."""
    np.savez(folder / "log.npz", **{f"c{i}": values for i, values in enumerate(columns.values())})
    table = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(f"{x:.7g}" for x in row) for row in table)]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return guess_mapping(open_log(folder / "log.csv"), model or robot(), **more)


def columns_of(found: Guess, quantity: str) -> dict[str, str]:
    return {name: entry["column"] for name, entry in found.mapping.get(quantity, {}).items()}


STYLES: dict[str, tuple[Columns, str, dict[str, str], dict[str, str]]] = {
    "words": (
        {
            "t": TIME,
            "left_hip_pos": HIP,
            "left_knee_pos": KNEE,
            "left_hip_vel": SPEEDS[0],
            "left_knee_vel": SPEEDS[1],
            "left_hip_cmd": GOALS[0],
            "left_knee_cmd": GOALS[1],
        },
        "rad",
        {"left_hip": "left_hip_pos", "left_knee": "left_knee_pos"},
        {"hip_servo": "left_hip_cmd", "knee_servo": "left_knee_cmd"},
    ),
    "numbers": (
        {
            "time": TIME,
            "q2": KNEE,
            "q1": HIP,
            "dq1": SPEEDS[0],
            "dq2": SPEEDS[1],
            "qd1_des": GOALS[0],
        }
        | {"q1_des": GOALS[0], "q2_des": GOALS[1]},
        "rad",
        {"left_hip": "q1", "left_knee": "q2"},
        {"hip_servo": "q1_des", "knee_servo": "q2_des"},
    ),
    "vectors from 0, degrees, milliseconds": (
        {
            "stamp": 1000 * TIME + 5e6,
            "state[0]": np.degrees(HIP),
            "state[1]": np.degrees(KNEE),
            "action[0]": np.degrees(GOALS[0]),
            "action[1]": np.degrees(GOALS[1]),
        },
        "deg",
        {"left_hip": "state[0]", "left_knee": "state[1]"},
        {"hip_servo": "action[0]", "knee_servo": "action[1]"},
    ),
    "camel case": (
        {
            "timestampUs": 1e6 * TIME,
            "hipAngleDeg": np.degrees(HIP),
            "kneeAngleDeg": np.degrees(KNEE),
            "hipTarget": np.degrees(GOALS[0]),
            "kneeTarget": np.degrees(GOALS[1]),
            "batteryV": np.full(400, 24.0),
        },
        "deg",
        {"left_hip": "hipAngleDeg", "left_knee": "kneeAngleDeg"},
        {"hip_servo": "hipTarget", "knee_servo": "kneeTarget"},
    ),
    "ticks": (
        {
            "t_ms": 1000 * TIME,
            "hip present position": np.rint(2048 + HIP * 4096 / (2 * np.pi)),
            "knee present position": np.rint(2048 + KNEE * 4096 / (2 * np.pi)),
            "hip goal position": np.rint(2048 + GOALS[0] * 4096 / (2 * np.pi)),
            "knee goal position": np.rint(2048 + GOALS[1] * 4096 / (2 * np.pi)),
        },
        "tick/4096",
        {"left_hip": "hip present position", "left_knee": "knee present position"},
        {"hip_servo": "hip goal position", "knee_servo": "knee goal position"},
    ),
}


@pytest.mark.parametrize("style", STYLES)
def test_styles_of_loggers(tmp_path: Path, style: str) -> None:
    """Joints, commands, units and time of logs in other styles; nothing is asked."""
    columns, unit, positions, commands = STYLES[style]
    found = guess(tmp_path, columns)
    assert found.undecided == []
    assert columns_of(found, "qpos") == positions
    assert columns_of(found, "ctrl") == commands
    assert {entry["unit"] for entry in found.mapping["qpos"].values()} == {unit}
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {unit}
    time = found.mapping["time"]
    factor = {"s": 1.0, "ms": 1e-3, "us": 1e-6}[time["unit"]]
    assert np.median(np.diff(columns[time["column"]])) * factor == pytest.approx(0.005)
    if unit == "tick/4096":
        assert {entry["offset"] for entry in found.mapping["qpos"].values()} == {-2048.0}


@pytest.mark.parametrize("turn", [1024, 4096, 16384])
@pytest.mark.parametrize(("unit", "full"), [("rad", 2 * np.pi), ("deg", 360)])
def test_an_encoder_by_its_commands(tmp_path: Path, turn: int, unit: str, full: float) -> None:
    """Counts from 0 at the joint's zero, and commands in another unit, which tell their size."""
    counts = {
        name: np.rint(angle * turn / (2 * np.pi))
        for name, angle in (("hip counts", HIP), ("knee counts", KNEE))
    }
    goals = {
        name: goal * full / (2 * np.pi)
        for name, goal in zip(("hip target", "knee target"), GOALS, strict=True)
    }
    found = guess(tmp_path, {"t": TIME} | counts | goals)
    assert {entry["unit"] for entry in found.mapping["qpos"].values()} == {f"tick/{turn}"}
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {unit}
    assert any(f"follow their commands by {turn} a turn" in line for line in found.lines)


def test_an_encoder_by_the_ranges(tmp_path: Path) -> None:
    """Counts without commands: encoders by which joints stay in their ranges are asked for."""
    counts = {
        name: np.rint(angle * 16384 / (2 * np.pi))
        for name, angle in (("hip counts", HIP), ("knee counts", KNEE))
    }
    found = guess(tmp_path, {"t": TIME} | counts)
    (question,) = found.undecided
    assert question.startswith("An encoder's counts reach 2868, and nothing tells how many a turn")
    assert "tick/4096" not in question  # beyond the ranges
    found = guess(tmp_path, {"t": TIME} | counts, ask=lambda asked, options: "tick/16384")
    assert {entry["unit"] for entry in found.mapping["qpos"].values()} == {"tick/16384"}
    given = {"qpos": {"left_knee": {"unit": "tick/16384"}}}
    assert guess(tmp_path, {"t": TIME} | counts, given=given).undecided == []


@pytest.mark.parametrize(
    ("unit", "factor"), [("rad/s", 1), ("deg/s", 180 / np.pi), ("rpm", 30 / np.pi)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_velocities_by_the_slope_of_the_positions(
    tmp_path: Path, unit: str, factor: float, sign: int
) -> None:
    """Unit and sign, whatever the name; one that fits no unit is left out, and said to be."""
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    speeds = {"hip speed": sign * factor * SPEEDS[0], "knee speed": sign * factor * SPEEDS[1]}
    found = guess(tmp_path, columns | speeds)
    entries = found.mapping["qvel"].values()
    assert {(entry["unit"], entry.get("sign", 1)) for entry in entries} == {(unit, sign)}
    found = guess(tmp_path, columns | {"hip speed": SPEEDS[1], "knee speed": 400 * SPEEDS[1]})
    assert "qvel" not in found.mapping
    assert any("'hip speed' is left out" in line for line in found.lines)


def test_every_guess_is_said(tmp_path: Path) -> None:
    """Each in a line with its reason, and what is not used."""
    lines = guess(tmp_path, STYLES["camel case"][0]).lines
    assert lines[0] == "time: 'timestampUs' in us, since its name says so"
    assert lines[1].startswith(
        "positions: left_hip = 'hipAngleDeg', left_knee = 'kneeAngleDeg'; in"
    )
    assert lines[2].startswith("commands (position): hip_servo = 'hipTarget'")
    assert lines[3] == "not used: 'batteryV'"


def test_what_is_not_clear_is_asked(tmp_path: Path) -> None:
    """Angles of 15 on joints without limits may be either; a question decides, or an entry."""
    free = robot(SERVOS.replace('range="-90 90"', "").replace('range="-140 0"', ""))
    columns = {"t": TIME, "hip q": 15 * np.sin(TIME), "knee q": 12 * np.cos(TIME)}
    found = guess(tmp_path, columns, free)
    assert found.undecided == ["Angles reach 15: in which unit are 'hip q', 'knee q'? (rad or deg)"]
    asked = []

    def answer(question: str, options: Any) -> str:
        asked.append(question)
        return "deg"

    found = guess(tmp_path, columns, free, ask=answer)
    assert len(asked) == 1
    assert {entry["unit"] for entry in found.mapping["qpos"].values()} == {"deg"}
    found = guess(tmp_path, columns, free, given={"qpos": {"left_hip": {"unit": "deg"}}})
    assert found.undecided == []


def test_a_body_stands_for_the_joint_that_moves_it(tmp_path: Path) -> None:
    """Where no column has the joint's own name; a column that has it comes first."""
    model = robot(SERVOS.replace('name="a"', 'name="thigh"').replace('name="b"', 'name="shin"'))
    columns = {"t": TIME, "thigh_angle_rad": HIP, "shin_angle_rad": KNEE, "thigh_vel": SPEEDS[0]}
    found = guess(tmp_path, columns, model)
    expected = {"left_hip": "thigh_angle_rad", "left_knee": "shin_angle_rad"}
    assert columns_of(found, "qpos") == expected
    assert columns_of(found, "qvel") == {"left_hip": "thigh_vel"}
    both = guess(tmp_path, {**columns, "left_hip_angle": HIP}, model)
    assert columns_of(both, "qpos") == {**expected, "left_hip": "left_hip_angle"}


def test_stamps_may_begin_anew_in_each_run(tmp_path: Path) -> None:
    """Two recordings of one file, each with stamps from 0 on."""
    twice = {
        name: np.tile(values, 2)
        for name, values in {"time": TIME, "left_hip": HIP, "left_knee": KNEE}.items()
    }
    found = guess(tmp_path, {"run": np.repeat([0, 1], len(TIME)), **twice})
    assert found.mapping["time"] == {"column": "time", "unit": "s"}
    assert found.mapping["run"] == {"column": "run"}
    assert not found.undecided


def test_stamps_of_too_few_digits_are_named(tmp_path: Path) -> None:
    """Seconds since 1970 in ten digits stand still for a second each."""
    stamps = 1.7e9 + TIME
    found = guess(tmp_path, {"timestamp": stamps, "hip q": HIP, "knee q": KNEE})
    (question,) = found.undecided
    assert "of 'timestamp' 399 in 400 rows repeat or run backward" in question
    assert "too few digits (1700000000)" in question


def test_no_time_is_not_decided(tmp_path: Path) -> None:
    columns = {"hip q": HIP, "knee q": KNEE}
    assert "no column of time stamps" in guess(tmp_path, columns).undecided[0]
    assert guess(tmp_path, columns, given={"rate": 200}).undecided == []


def test_other_machines_are_refused(tmp_path: Path) -> None:
    """No column of a joint; torques for servos; a base that moves and is fixed in the model."""
    with pytest.raises(
        BadFile, match="positions of the joints left_hip, left_knee, got 'wheel pos'"
    ):
        guess(tmp_path, {"t": TIME, "wheel pos": HIP, "tail pos": KNEE, "ear pos": KNEE})
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    with pytest.raises(Incompatible, match="take position commands, and the log has torque alone"):
        guess(tmp_path, columns | {"tau_cmd_hip": HIP, "tau_cmd_knee": KNEE})
    still = {"base_x": 0 * TIME, "base_y": 0 * TIME, "base_z": 0.3 + 0 * TIME}
    assert guess(tmp_path, columns | still).undecided == []
    moving = still | {"base_z": 0.3 + 0.1 * HIP}
    with pytest.raises(
        Incompatible, match="fixed in the model and moves in the log: base_z moves by"
    ):
        guess(tmp_path, columns | moving)


def test_commands_of_legs_that_sag(tmp_path: Path) -> None:
    """Loaded joints that hardly follow small commands are near them all the same; torques of that
    size are not, and those of a motor that holds a load are no positions.
    """
    load = 0.1 * np.cos(3 * TIME)
    columns = {"t": TIME, "hip q": HIP - 0.5 + 3 * load, "knee q": KNEE - 0.6 - 3 * load}
    goals = {"hip cmd": 0.1 * HIP - 0.4, "knee cmd": 0.1 * KNEE - 1.2}
    found = guess(tmp_path, columns | goals)
    assert set(found.mapping["ctrl"]) == {"hip_servo", "knee_servo"}
    torques = {"hip cmd": 5 * load, "knee cmd": -4 * load[::-1]}
    with pytest.raises(Incompatible, match="take position commands, and the log has torque alone"):
        guess(tmp_path, columns | torques)


def test_commands_of_turned_and_exchanged_joints(tmp_path: Path) -> None:
    """A wrong sign, or two columns exchanged, makes no torque of a position that is commanded."""
    goals = {"hip cmd": GOALS[0], "knee cmd": GOALS[1]}
    for hip, knee in ((HIP, -KNEE), (KNEE, HIP)):
        found = guess(tmp_path, {"t": TIME, "hip q": hip, "knee q": knee} | goals)
        assert set(found.mapping["ctrl"]) == {"hip_servo", "knee_servo"}


def test_a_command_without_a_position_is_in_the_unit_of_the_others(tmp_path: Path) -> None:
    """Degrees, where those are degrees whose joints follow them."""
    goals = {"hip cmd": np.degrees(GOALS[0]), "knee cmd": np.degrees(GOALS[1])}
    found = guess(tmp_path, {"t": TIME, "hip q deg": np.degrees(HIP)} | goals)
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {"deg"}


def test_an_imu_may_be_on_another_body(tmp_path: Path) -> None:
    """Its turns are a warning for a check of logs, and refuse nothing."""
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    hand = {f"imu_gyro_{part}": 2 * HIP for part in "xyz"}
    assert guess(tmp_path, columns | hand).undecided == []
    found = moving_base(open_log(tmp_path / "log.csv"), robot())
    assert found is not None
    assert found.level == "warning"
    assert "imu_gyro_x is" in found.sentence


def test_a_floating_base(tmp_path: Path) -> None:
    """Its pose is found, also where the quaternion's columns are in another order."""
    free = robot(
        SERVOS.replace(
            '<body name="a"><joint name="left_hip" axis="0 1 0" range="-90 90"/>',
            '<body name="t"><freejoint name="root"/><geom size="0.1" mass="1"/>'
            '<body name="a"><joint name="left_hip" axis="0 1 0" range="-90 90"/>',
        ).replace("</body></body>", "</body></body></body>")
    )
    turn = np.stack([0 * TIME, np.sin(0.1 * HIP), 0 * TIME, np.cos(0.1 * HIP)], axis=1)
    base = {"base_pos_x": 0 * TIME, "base_pos_y": 0 * TIME, "base_pos_z": 0.3 + 0.01 * HIP}
    named = {f"base_q{part}": turn[:, i] for i, part in enumerate("xyzw")}
    numbered = {f"base_quat[{i}]": turn[:, i] for i in range(4)}
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE} | base
    found = guess(tmp_path, columns | named, free)
    wanted = ["base_pos_x", "base_pos_y", "base_pos_z", "base_qw", "base_qx", "base_qy", "base_qz"]
    assert found.mapping["qpos"]["root"]["columns"] == wanted
    found = guess(tmp_path, columns | numbered, free)
    assert found.mapping["qpos"]["root"]["columns"][3:] == [f"base_quat[{i}]" for i in (3, 0, 1, 2)]
    assert any("quaternion: in the order x, y, z, w" in line for line in found.lines)


def test_motors_take_torques(tmp_path: Path) -> None:
    """Of position and torque commands those that the actuators take; measured ones if no other."""
    motors = robot(SERVOS.replace("<position", "<motor").replace(' kp="20"', ""))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE, "hip q_des": HIP, "knee q_des": KNEE}
    torques = {"hip tau_ff_cmd": 3 * HIP, "knee tau_ff_cmd": KNEE}
    found = guess(tmp_path, columns | torques, motors)
    assert columns_of(found, "ctrl") == {
        "hip_servo": "hip tau_ff_cmd",
        "knee_servo": "knee tau_ff_cmd",
    }
    found = guess(tmp_path, columns | {"hip torque": HIP, "knee torque": KNEE}, motors)
    assert columns_of(found, "ctrl") == {"hip_servo": "hip torque", "knee_servo": "knee torque"}
    assert any("was measured: no torque was commanded" in line for line in found.lines)


def test_words_of_names() -> None:
    """A word of a joint's name keeps its meaning."""
    name = read_name("Rotation.pos", None, ["Rotation", "Pitch"])
    assert (name.quantity, name.rest) == ("position", ("rotation",))
    name = read_name("position[elbow]", "/arm/joint_commands", ["elbow"])
    assert (name.quantity, name.kind, name.rest) == ("command", "position", ("elbow",))
    name = read_name("q_dot_3 [deg/s]", None, ["j3"])
    assert (name.quantity, name.unit) == ("velocity", "deg/s")


ROW = "".join(
    f'<body name="b{i}" pos="0 0 0.1"><joint name="joint{i}" axis="0 1 0"/><geom size="0.05"/>'
    for i in (1, 2, 3)
)
NUMBERED = f"<mujoco><worldbody>{ROW}</body></body></body></worldbody></mujoco>"


@pytest.mark.parametrize(
    ("first", "wanted"),
    [(0, ["q0", "q1", "q2"]), (1, ["q1", "q2", "q3"])],
)
def test_numbers_count_from_0_or_1(tmp_path: Path, first: int, wanted: list[str]) -> None:
    """Columns q0 to q2 are joint1 to joint3, as q1 to q3 are: never one place off."""
    columns = {"t": TIME} | {f"q{first + i}": HIP + 0.1 * i for i in range(3)}
    found = guess(tmp_path, columns, robot(NUMBERED))
    assert list(columns_of(found, "qpos").values()) == wanted


def test_four_numbers_for_three_joints_are_not_guessed(tmp_path: Path) -> None:
    """From 0: which one is too many is not known; from 1 the names say it."""
    columns = {"t": TIME} | {f"q{i}": HIP + 0.1 * i for i in range(4)}
    with pytest.raises(BadFile, match="positions of the joints joint1, joint2, joint3"):
        guess(tmp_path, columns, robot(NUMBERED))
    columns = {"t": TIME} | {f"q{1 + i}": HIP + 0.1 * i for i in range(4)}
    found = guess(tmp_path, columns, robot(NUMBERED))
    assert list(columns_of(found, "qpos").values()) == ["q1", "q2", "q3"]


def test_dates_are_stamps(tmp_path: Path) -> None:
    """As ISO 8601 writes them; velocities are found beside them."""
    dates = np.datetime64("2026-03-01T10:00:00") + (1e9 * TIME).astype("timedelta64[ns]")
    lines = ["Zeit,hip q,knee q,hip dq,knee dq"]
    for k in range(len(TIME)):
        numbers = (HIP[k], KNEE[k], SPEEDS[0][k], SPEEDS[1][k])
        lines.append(",".join([str(dates[k]), *(f"{x:.6f}" for x in numbers)]))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    found = guess_mapping(open_log(tmp_path / "log.csv"), robot())
    assert found.lines[0] == "time: 'Zeit' in s, since its cells are dates"
    assert {entry["unit"] for entry in found.mapping["qvel"].values()} == {"rad/s"}


def test_commands_go_with_the_positions_of_their_words(tmp_path: Path) -> None:
    """Whatever numbers the actuators' names have: never one place off."""
    text = SERVOS.replace('name="hip_servo"', 'name="a1"').replace('name="knee_servo"', 'name="a2"')
    columns = {"t": TIME, "A0_act": HIP, "A1_act": KNEE, "A1_cmd": GOALS[1], "A0_cmd": GOALS[0]}
    found = guess(tmp_path, columns, robot(text))
    assert columns_of(found, "ctrl") == {"a1": "A0_cmd", "a2": "A1_cmd"}


def test_a_given_sign_counts_for_the_velocity(tmp_path: Path) -> None:
    """A joint that turns the other way: its velocity's column, too, turns with it."""
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE, "hip dq": SPEEDS[0], "knee dq": SPEEDS[1]}
    found = guess(tmp_path, columns, given={"qpos": {"left_hip": {"sign": -1}}})
    assert found.mapping["qvel"]["left_hip"]["sign"] == -1
    assert "sign" not in found.mapping["qvel"]["left_knee"]


CART = """
<mujoco>
  <worldbody>
    <body name="cart"><joint name="rail" type="slide" axis="1 0 0" range="-0.5 0.5"/>
      <geom size="0.1" mass="1"/>
      <body name="rod"><joint name="pole" axis="0 1 0" range="-180 180"/>
        <geom size="0.1" mass="1" pos="0 0 -0.3"/></body></body>
  </worldbody>
  <actuator><motor name="push" joint="rail"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("factor", "name", "unit", "why"),
    [
        (1, "rail pos", "m", "slides are in m"),
        (100, "rail pos", "cm", "it reaches 40, the joint 0.5 m"),
        (1000, "rail pos", "mm", "it reaches 400, the joint 0.5 m"),
        (1, "rail pos [mm]", "mm", "its name says so"),
    ],
)
def test_the_unit_of_a_slide(tmp_path: Path, factor: float, name: str, unit: str, why: str) -> None:
    """By its name, else by how far it goes beyond the joint's range."""
    place = 0.4 * factor * np.sin(2.5 * TIME)
    found = guess(tmp_path, {"t": TIME, name: place, "pole pos": HIP}, robot(CART))
    assert found.mapping["qpos"]["rail"] == {"column": name, "unit": unit}
    (line,) = [line for line in found.lines if line.startswith("positions: rail")]
    assert line.endswith(f"in {unit}, since {why}")


def test_what_is_not_in_the_log_is_said(tmp_path: Path) -> None:
    """A joint without a position, an actuator without a command, a robot without any command."""
    columns = {"t": TIME, "hip q": HIP, "hip cmd": GOALS[0]}
    lines = guess(tmp_path, columns).lines
    assert any(line.startswith("no position in the log: left_knee; such a") for line in lines)
    assert "no command in the log: knee_servo; taken as 0" in lines
    lines = guess(tmp_path, {"t": TIME, "hip q": HIP, "knee q": KNEE}).lines
    assert "no commands in the log: all are taken as 0" in " ".join(lines)


def test_runs_are_told_apart_by_a_column(tmp_path: Path) -> None:
    """One of few numbers; one that counts rows tells nothing apart, and one that is given wins."""
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    found = guess(tmp_path, columns | {"episode": np.arange(400) // 100})
    assert found.mapping["run"] == {"column": "episode"}
    assert "runs: told apart by 'episode'" in found.lines
    found = guess(tmp_path, columns | {"episode": np.arange(400)})
    assert "run" not in found.mapping
    given = {"run": {"column": "trial"}}
    found = guess(tmp_path, columns | {"episode": np.arange(400) // 100}, given=given)
    assert "run" not in found.mapping


def test_which_of_two_columns_is_asked(tmp_path: Path) -> None:
    """Two columns are as much like the knee: an answer is taken; without it the joint has none."""
    columns = {"t": TIME, "hip q": HIP, "knee_a q": KNEE, "knee_b q": 0.9 * KNEE}
    question = "Which column is the position of 'left_knee'?"
    found = guess(tmp_path, columns)
    assert found.undecided == [f"{question} (knee_a q or knee_b q)"]
    assert columns_of(found, "qpos") == {"left_hip": "hip q"}

    def answer(asked: str, options: Any) -> str:
        assert asked == question
        return str(options[1])

    found = guess(tmp_path, columns, ask=answer)
    assert found.undecided == []
    assert columns_of(found, "qpos") == {"left_hip": "hip q", "left_knee": "knee_b q"}


FREE = SERVOS.replace(
    '<body name="a"><joint name="left_hip" axis="0 1 0" range="-90 90"/>',
    '<body name="t"><freejoint name="root"/><geom size="0.1" mass="1"/>'
    '<body name="a"><joint name="left_hip" axis="0 1 0" range="-90 90"/>',
).replace("</body></body>", "</body></body></body>")


def test_a_base_without_a_pose_stays_where_it_is(tmp_path: Path) -> None:
    found = guess(tmp_path, {"t": TIME, "hip q": HIP, "knee q": KNEE}, robot(FREE))
    assert "root" not in found.mapping["qpos"]
    assert any(line.startswith("no pose of root in the log") for line in found.lines)
    with pytest.raises(BadFile, match="positions of the joints root, left_hip, left_knee"):
        guess(tmp_path, {"t": TIME, "voltage": HIP}, robot(FREE))


def test_a_quaternion_whose_order_is_not_known_is_asked(tmp_path: Path) -> None:
    """A base that lies on its side tells nothing; without an answer it is w, x, y, z."""
    side = np.stack([np.full(400, np.sqrt(0.5)), 0 * TIME, 0 * TIME, np.full(400, np.sqrt(0.5))])
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    columns |= {f"base_pos_{part}": 0 * TIME for part in "xyz"}
    columns |= {f"base_quat[{i}]": side[i] for i in range(4)}
    found = guess(tmp_path, columns, robot(FREE))
    (question,) = found.undecided
    assert question.startswith("In which order is the quaternion 'base_quat[0]'")
    assert question.endswith("(wxyz or xyzw)")
    for order, wanted in (("wxyz", (0, 1, 2, 3)), ("xyzw", (3, 0, 1, 2))):
        told = guess(tmp_path, columns, robot(FREE), ask=lambda asked, options, said=order: said)
        names = told.mapping["qpos"]["root"]["columns"][3:]
        assert names == [f"base_quat[{i}]" for i in wanted]
    asked = found.answers["qpos"]["root"]["columns"]
    assert asked == [name for name in columns if name.startswith("base_")]
    turned = [*asked[:3], asked[6], *asked[3:6]]
    for answer in (asked, turned):
        found = guess(tmp_path, columns, robot(FREE), given={"qpos": {"root": {"columns": answer}}})
        assert not found.undecided
        assert found.mapping["qpos"]["root"]["columns"] == answer


def test_currents_and_commanded_velocities_have_their_units(tmp_path: Path) -> None:
    """Amperes where a torque's name says so; rad/s, and what a name says otherwise."""
    motors = robot(SERVOS.replace("<position", "<motor").replace(' kp="20"', ""))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    currents = {"hip current cmd": 3 * HIP, "knee current cmd": KNEE}
    found = guess(tmp_path, columns | currents, motors)
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {"A"}
    wheels = robot(SERVOS.replace("<position", "<velocity").replace('kp="20"', 'kv="2"'))
    speeds = {"hip vel_cmd": SPEEDS[0], "knee vel_cmd [deg/s]": np.degrees(SPEEDS[1])}
    found = guess(tmp_path, columns | speeds, wheels)
    units = {name: entry["unit"] for name, entry in found.mapping["ctrl"].items()}
    assert units == {"hip_servo": "rad/s", "knee_servo": "deg/s"}


@pytest.mark.parametrize("name", ["{}_cmd_deg_s", "{} cmd [deg/s]", "{}_target_rad_per_s"])
def test_a_unit_of_speed_says_that_speeds_were_commanded(tmp_path: Path, name: str) -> None:
    """Degrees stand for positions, and degrees a second do not."""
    wheels = robot(SERVOS.replace("<position", "<velocity").replace('kp="20"', 'kv="2"'))
    columns = {"t": TIME, "hip_angle_deg": np.degrees(HIP), "knee_angle_deg": np.degrees(KNEE)}
    speeds = {name.format("hip"): SPEEDS[0], name.format("knee"): SPEEDS[1]}
    found = guess(tmp_path, columns | speeds, wheels)
    assert list(columns_of(found, "ctrl").values()) == list(speeds)
    with pytest.raises(Incompatible, match="take position commands, and the log has velocity"):
        guess(tmp_path, columns | speeds)


@pytest.mark.parametrize("name", ["{}_cmd_deg", "{} foo", "{} torque"])
def test_the_kind_of_a_command_that_a_mapping_gives(tmp_path: Path, name: str) -> None:
    """Its unit there says it, else it is what the model takes, whatever the name looks like."""
    wheels = robot(SERVOS.replace("<position", "<velocity").replace('kp="20"', 'kv="2"'))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    told = {name.format("hip"): SPEEDS[0], name.format("knee"): SPEEDS[1]}
    for unit in ({"unit": "deg/s"}, {}):
        hip, knee = ({"column": column} | unit for column in told)
        given = {"ctrl": {"hip_servo": hip, "knee_servo": knee}}
        found = guess(tmp_path, columns | told, wheels, given=given)
        assert list(columns_of(found, "ctrl").values()) == list(told)
        assert any("commands (velocity)" in line for line in found.lines)
    given = {"ctrl": {"hip_servo": hip | {"unit": "deg"}, "knee_servo": knee | {"unit": "deg"}}}
    with pytest.raises(Incompatible, match="and the log has position alone"):
        guess(tmp_path, columns | told, wheels, given=given)


def test_late_followers_are_told_in_their_own_unit(tmp_path: Path) -> None:
    """Angles in counts, and goals in rad that joints follow a quarter of a turn late."""
    late = {"hip": 0.5 * np.cos(3 * TIME), "knee": 0.4 * np.cos(3 * TIME)}
    counts = {f"{name} q": np.rint(4096 / np.pi / 2 * one) for name, one in late.items()}
    goals = {f"{name} cmd": 0.6 * np.sin(3 * TIME) for name in late}
    given = {"left_hip": {"column": "hip q", "unit": "tick/4096"}}
    servos = robot(SERVOS)
    found = guess(
        tmp_path,
        {"t": TIME} | counts | goals,
        servos,
        given={
            "qpos": given,
            "ctrl": {"hip_servo": {"column": "hip cmd"}, "knee_servo": {"column": "knee cmd"}},
        },
    )
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {"rad"}


@pytest.mark.parametrize("begins", [0.0, 1900.0])
def test_counts_that_begin_at_0_have_no_middle(tmp_path: Path, begins: float) -> None:
    """An encoder that counts from where it is switched on, beside one that knows its place."""
    counts = np.rint(800 * (1 - np.cos(TIME)))
    columns = {"t": TIME, "hip q": counts + begins, "knee q": counts + begins}
    given = {"left_hip": {"column": "hip q", "unit": "tick/4096"}}
    found = guess(tmp_path, columns, given={"qpos": given})
    entry = found.mapping["qpos"]["left_hip"]
    assert entry.get("offset", 0.0) == (-2048.0 if begins else 0.0)


def test_commands_without_a_kind_are_speeds_where_joints_follow_so(tmp_path: Path) -> None:
    """Drives that take speeds: what the joints follow, late; and whatever a mapping says."""
    wheels = robot(SERVOS.replace("<position", "<velocity").replace('kp="20"', 'kv="2"'))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    commands = {f"{name} cmd": np.roll(SPEEDS[i], -3) for i, name in enumerate(("hip", "knee"))}
    found = guess(tmp_path, columns | commands, wheels)
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {"rad/s"}
    pushes = {name: np.gradient(values, TIME) for name, values in commands.items()}
    with pytest.raises(Incompatible, match="take velocity commands, and the log has torque"):
        guess(tmp_path, columns | pushes, wheels)
    given = {"hip_servo": {"column": "hip cmd"}, "knee_servo": {"column": "knee cmd"}}
    found = guess(tmp_path, columns | pushes, wheels, given={"ctrl": given})
    assert found.mapping["ctrl"]["hip_servo"] == {"column": "hip cmd", "unit": "rad/s"}


@pytest.mark.parametrize("stands", [0.0, 0.137])
def test_a_velocity_that_stands_is_left_out(tmp_path: Path, stands: float) -> None:
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE, "hip dq": SPEEDS[0]}
    found = guess(tmp_path, columns | {"knee dq": np.full(len(TIME), stands)})
    assert list(found.mapping["qvel"]) == ["left_hip"]
    assert any(f"it stands at {stands:g} while 'knee q' moves" in one for one in found.lines)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("{} volt", "V"),
        ("{} u [V]", "V"),
        ("{}_voltage_mV", "mV"),
        ("{}_pwm", "1"),
        ("{} cmd [Nm]", "N m"),
        ("{}_command (A)", "A"),
    ],
)
def test_what_motors_were_told(tmp_path: Path, names: str, unit: str) -> None:
    """Volts, parts of a duty cycle, torques and currents are commands, in their units."""
    motors = robot(SERVOS.replace("<position", "<motor").replace(' kp="20"', ""))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    told = {names.format("hip"): 9 * SPEEDS[0], names.format("knee"): 9 * SPEEDS[1]}
    found = guess(tmp_path, columns | told | {"supply voltage": 12 + 0.1 * HIP}, motors)
    assert {entry["unit"] for entry in found.mapping["ctrl"].values()} == {unit}
    assert list(columns_of(found, "ctrl").values()) == list(told)


def test_commands_of_no_known_name_are_asked_for(tmp_path: Path) -> None:
    """Columns with the joints' names that say nothing else: asked, never left out in silence."""
    motors = robot(SERVOS.replace("<position", "<motor").replace(' kp="20"', ""))
    columns = {"t": TIME, "hip q": HIP, "knee q": KNEE}
    told = {"hip foo": 9 * SPEEDS[0], "knee foo": 9 * SPEEDS[1]}
    (question,) = guess(tmp_path, columns | told, motors).undecided
    assert question == "Are 'hip foo', 'knee foo' what the actuators were told? (yes or no)"
    found = guess(tmp_path, columns | told, motors, ask=lambda asked, options: "yes")
    assert list(columns_of(found, "ctrl").values()) == list(told)
    found = guess(tmp_path, columns | told, motors, given={"ctrl": {}})
    assert found.undecided == []
    assert any("as of motors that are off" in line for line in found.lines)


def test_velocities_that_cannot_be_checked_are_left_out(tmp_path: Path) -> None:
    """Ten rows tell no unit; without stamps the given rate makes the time."""
    columns = {"hip q": HIP, "knee q": KNEE, "hip dq": SPEEDS[0], "knee dq": SPEEDS[1]}
    few = {"t": TIME} | columns
    found = guess(tmp_path, {name: values[:10] for name, values in few.items()})
    assert "qvel" not in found.mapping
    found = guess(tmp_path, columns, given={"rate": 200})
    assert {entry["unit"] for entry in found.mapping["qvel"].values()} == {"rad/s"}
    found = guess(tmp_path, columns, given={"rate": 200 * np.pi / 180})
    assert {entry["unit"] for entry in found.mapping["qvel"].values()} == {"deg/s"}


def test_a_column_of_texts_is_no_number(tmp_path: Path) -> None:
    """Beside columns of numbers it is left out, and the others are read."""
    lines = ["t,hip q,knee q,hip q mode"]
    lines += [f"{TIME[i]:.6f},{HIP[i]:.6f},{KNEE[i]:.6f},on" for i in range(400)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    found = guess_mapping(open_log(tmp_path / "log.csv"), robot())
    assert columns_of(found, "qpos") == {"left_hip": "hip q", "left_knee": "knee q"}


def test_a_given_column_with_one_text_is_no_number(tmp_path: Path) -> None:
    """The commands beside it are taken all the same."""
    lines = ["t,left_hip_pos,u"]
    lines += [f"{TIME[i]:.6f},{HIP[i]:.6f},{GOALS[0][i]:.6f}" for i in range(400)]
    lines[37] = lines[37].replace(",", ",&a", 1)
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    given = {
        "qpos": {"left_hip": {"column": "left_hip_pos", "unit": "rad"}},
        "ctrl": {"hip_servo": {"column": "u"}},
    }
    found = guess_mapping(open_log(tmp_path / "log.csv"), robot(), given=given)
    assert columns_of(found, "ctrl") == {"hip_servo": "u"}


def test_commands_that_never_stand_beside_positions(tmp_path: Path) -> None:
    """Rows that hold the one or the other: how joints follow commands is then not known."""
    even = np.arange(len(TIME)) % 2 == 0
    measured = np.where(even, HIP, np.nan)
    commanded = np.where(even, np.nan, GOALS[0])
    found = guess(tmp_path, {"t": TIME, "left_hip_pos": measured, "left_hip_cmd": commanded})
    assert columns_of(found, "qpos") == {"left_hip": "left_hip_pos"}
