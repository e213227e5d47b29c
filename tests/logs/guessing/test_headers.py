"""Headers of tables in the styles of ten loggers, columns in any order: most are mapped whole, none
is mapped wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.logs.guessing.guess import guess_mapping
from dropo.logs.readers.reader import open_log
from dropo.mjmodel.joints import ModelJoints, model_joints

UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")
SEVEN = tuple(f"joint{i}" for i in range(1, 8))
LEGS = ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "RR_hip_joint", "RR_thigh_joint")
FOUR = ("rotation", "pitch", "elbow", "jaw")
Name = Callable[[int, str], str]


@dataclass(frozen=True)
class Style:
    """How a logger names position, command, velocity and time; degrees, and stamps in a second."""

    joints: tuple[str, ...]
    position: Name
    command: Name
    velocity: Name | None
    time: str
    ticks: float = 1.0
    degrees: bool = False


def camel(name: str) -> str:
    first, second = name.split("_")[:2]
    return first.lower() + second.capitalize()


def short(name: str) -> str:
    return name.removesuffix("_joint")


STYLES = {
    "interface of URs": Style(
        UR,
        lambda i, n: f"actual_q_{i}",
        lambda i, n: f"target_q_{i}",
        lambda i, n: f"actual_qd_{i}",
        "timestamp",
    ),
    "two letters": Style(
        SEVEN, lambda i, n: f"O_q[{i}]", lambda i, n: f"q_d[{i}]", None, "time [ms]", 1e3
    ),
    "plotter": Style(
        UR,
        lambda i, n: f"/joint_states/{n}/position",
        lambda i, n: f"/cmd/{n}/position",
        lambda i, n: f"/joint_states/{n}/velocity",
        "__time",
    ),
    "German": Style(
        FOUR,
        lambda i, n: f"{n.capitalize()}_Ist_deg",
        lambda i, n: f"{n.capitalize()}_Soll_deg",
        None,
        "Zeit_s",
        degrees=True,
    ),
    "short names": Style(
        LEGS,
        lambda i, n: f"{short(n)}_q",
        lambda i, n: f"{short(n)}_q_des",
        lambda i, n: f"{short(n)}_dq",
        "tick_us",
        1e6,
    ),
    "servo bus": Style(
        FOUR,
        lambda i, n: f"ID{i + 1} Present Position",
        lambda i, n: f"ID{i + 1} Goal Position",
        None,
        "Time(s)",
        degrees=True,
    ),
    "formulas": Style(
        SEVEN,
        lambda i, n: f"theta{i + 1}",
        lambda i, n: f"theta_ref{i + 1}",
        lambda i, n: f"thetadot{i + 1}",
        "t",
    ),
    "microcontroller": Style(
        FOUR, lambda i, n: f"enc_{n}", lambda i, n: f"sp_{n}", None, "millis", 1e3, True
    ),
    "camel case": Style(
        LEGS, lambda i, n: f"{camel(n)}Pos", lambda i, n: f"{camel(n)}Cmd", None, "stamp_ns", 1e9
    ),
    "dots": Style(
        UR,
        lambda i, n: f"state.position.{n}",
        lambda i, n: f"command.position.{n}",
        lambda i, n: f"state.velocity.{n}",
        "header.stamp",
    ),
}
REFUSED = {"two letters"}


def robot(joints: tuple[str, ...]) -> ModelJoints:
    """A chain of servos."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for i, name in enumerate(joints):
        body = body.add_body(pos=[0, 0, 0.1])
        body.add_geom(size=[0.03, 0, 0], mass=0.3)
        axis = [0, i % 2, 1 - i % 2]
        body.add_joint(name=name, axis=axis, range=[-170, 170], limited=True)
        actuator = spec.add_actuator(name=f"a{i}", target=name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_position(kp=20)
    return model_joints(spec.compile())


def table(style: Style) -> dict[str, np.ndarray]:
    """A log in that style, its columns in another order than the joints."""
    time = np.arange(500) / 100
    unit = 180 / np.pi if style.degrees else 1.0
    columns = {style.time: time * style.ticks}
    for i in np.random.default_rng(77).permutation(len(style.joints)).tolist():
        name = style.joints[i]
        angle = 0.9 * np.sin((1 + 0.3 * i) * time + i)
        columns[style.position(i, name)] = unit * angle
        columns[style.command(i, name)] = unit * (angle + 0.02 * np.sin(9 * time))
        if style.velocity is not None:
            columns[style.velocity(i, name)] = unit * np.gradient(angle, time)
    return columns | {"battery_voltage": 0 * time + 24, "loop_count": np.arange(500.0)}


@pytest.mark.parametrize("name", STYLES)
def test_headers(tmp_path: Path, name: str) -> None:
    """All of joints, commands, velocities, units and time, or a refusal."""
    style = STYLES[name]
    columns = table(style)
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    log = open_log(tmp_path / "log.csv")
    if name in REFUSED:
        with pytest.raises(BadFile, match="columns that name the positions of the joints"):
            guess_mapping(log, robot(style.joints))
        return
    found = guess_mapping(log, robot(style.joints)).mapping
    for i, joint in enumerate(style.joints):
        assert found["qpos"][joint]["column"] == style.position(i, joint)
        assert found["ctrl"][f"a{i}"]["column"] == style.command(i, joint)
        assert found["qpos"][joint]["unit"] == ("deg" if style.degrees else "rad")
        if style.velocity is not None:
            assert found["qvel"][joint]["column"] == style.velocity(i, joint)
    units = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
    assert found["time"]["column"] == style.time
    assert units[found["time"]["unit"]] == style.ticks
