"""Every defect that the check of raw logs knows is injected and must be named with its place; a
clean log gives no finding.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dropo.data.checks.findings import Finding
from dropo.logs.log_checks import check_runs
from dropo.logs.mapping import read_mapping
from dropo.logs.recordings import read_runs
from dropo.mjmodel.joints import load_model_joints

Columns = dict[str, NDArray[Any]]


def found(folder: Path, columns: Columns) -> list[Finding]:
    """What the check says of a log with these columns."""
    np.savez(folder / "log.npz", **columns)
    robot = load_model_joints(folder / "robot.xml")
    return check_runs(
        read_runs(
            [folder / "log.npz"],
            read_mapping(folder / "map.yaml", robot),
            lambda share, text: None,
        ),
        robot,
    )


@pytest.fixture
def clean(arm: Any) -> Columns:
    """8 s at 500 Hz with the noise of good sensors."""
    rng = np.random.default_rng(0)
    noise = {"q1": 1e-4, "q2": 1e-4, "dq1": 0.01, "dq2": 0.01}
    return {
        name: column + rng.normal(0, noise[name], len(column)) if name in noise else column
        for name, column in arm.log().items()
    }


def test_a_clean_log_gives_nothing(folder: Path, clean: Columns, arm: Any) -> None:
    """With noise, without it, as a fine encoder writes it, and with the jitter of an ordinary
    logger.
    """
    assert found(folder, clean) == []
    assert found(folder, arm.log()) == []
    fine = {
        name: np.rint(column / 1e-4) * 1e-4 if name[0] in "dq" else column
        for name, column in clean.items()
    }
    assert found(folder, fine) == []
    shaken = clean["t"] + np.random.default_rng(1).uniform(-1e-4, 1e-4, len(clean["t"]))
    assert found(folder, {**clean, "t": shaken}) == []


def rows(columns: Columns, order: Any) -> Columns:
    return {name: column[order] for name, column in columns.items()}


def put(name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, name: change(columns[name])}


def hold(column: NDArray[Any]) -> NDArray[Any]:
    out = column.copy()
    out[1500:1560] = out[1500]
    return out


def exceed(column: NDArray[Any]) -> NDArray[Any]:
    out = column.copy()
    out[300:310] = 7.5
    return out


def jitter(time: NDArray[Any]) -> NDArray[Any]:
    return time + np.random.default_rng(2).uniform(-8e-4, 8e-4, len(time))


# defect -> (what it does, level, signal, row or None where any will do, what the sentence or the
# advice holds)
DEFECTS: dict[str, tuple[Callable[[Columns], Columns], str, str, int | None, str]] = {
    "doubled stamps": (
        lambda c: rows(c, np.insert(np.arange(4000), 900, 899)),
        "warning",
        "t",
        900,
        "1 row has the time stamp",
    ),
    "a row too late": (
        lambda c: rows(c, np.insert(np.arange(4000), 900, 880)),
        "warning",
        "t",
        900,
        "backward once, first to row 900",
    ),
    "a clock that restarts": (
        put("t", lambda t: np.where(t < 4, t, t - 3)),
        "error",
        "t",
        1500,
        "Cut the log there",
    ),
    "a gap": (
        lambda c: rows(c, np.delete(np.arange(4000), slice(1000, 1100))),
        "warning",
        "t",
        1000,
        "1 gap of more than 5 steps of 2 ms",
    ),
    "jitter": (put("t", jitter), "information", "t", None, "steps vary by 3"),
    "stuck": (
        put("q2", hold),
        "warning",
        "qpos.elbow",
        1500,
        "it hangs once, the first time for 60 rows from row 1500",
    ),
    "wrapped": (
        put("q1", lambda q: np.mod(q, 2 * np.pi)),
        "information",
        "qpos.shoulder",
        None,
        "it starts anew after a whole turn",
    ),
    "dead": (put("dq1", np.zeros_like), "warning", "qvel.shoulder", None, "it does not move"),
    "clipped": (
        put("dq1", lambda v: np.clip(v, -4, 4)),
        "warning",
        "qvel.shoulder",
        None,
        "it is cut off at its largest value, 4 rad/s",
    ),
    "quantised": (
        put("q1", lambda q: np.rint(q / 0.05) * 0.05),
        "warning",
        "qpos.shoulder",
        None,
        "it moves in steps of 0.05 rad",
    ),
    "outside the range": (
        put("tau1", exceed),
        "warning",
        "ctrl.m1",
        300,
        "10 of 4000 actions are outside the control range [-6, 6]",
    ),
    "saturated": (
        put("tau1", lambda u: np.clip(8 * u, -6, 6)),
        "information",
        "ctrl.m1",
        None,
        "commands stand at a limit of [-6, 6]",
    ),
    "sign": (
        put("dq2", np.negative),
        "error",
        "qvel.elbow",
        None,
        "it has the opposite sign of the change of qpos.elbow",
    ),
    "sign of the position": (
        put("q2", np.negative),
        "error",
        "qvel.elbow",
        None,
        "it has the opposite sign of the change of qpos.elbow",
    ),
    "degrees in the velocity": (
        put("dq1", np.degrees),
        "error",
        "qvel.shoulder",
        None,
        "It looks like deg/s in place of rad/s",
    ),
    "degrees in the position": (
        put("q1", np.degrees),
        "error",
        "qvel.shoulder",
        None,
        "or a position in deg",
    ),
    "revolutions a minute": (
        put("dq1", lambda v: v * 30 / np.pi),
        "error",
        "qvel.shoulder",
        None,
        "It looks like rpm in place of rad/s",
    ),
    "a gear ratio": (
        put("dq1", lambda v: v * 6),
        "error",
        "qvel.shoulder",
        None,
        "it is 6 times the change of qpos.shoulder",
    ),
    "milliseconds": (
        put("t", lambda t: 1e3 * t),
        "error",
        "qvel.elbow",
        None,
        "or ms in place of s",
    ),
    "another joint": (
        lambda c: {**c, "dq1": c["dq2"][::-1]},
        "warning",
        "qvel.shoulder",
        None,
        "it does not follow",
    ),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_defects_are_named_with_their_place(folder: Path, clean: Columns, name: str) -> None:
    spoil, level, signal, row, words = DEFECTS[name]
    everything = [finding for finding in found(folder, spoil(clean)) if finding.signal == signal]
    named = [finding for finding in everything if words in f"{finding.sentence} {finding.advice}"]
    assert len(named) == 1
    assert named[0].level == level
    if row is not None:
        assert named[0].row == row
    if name != "dead":
        assert named[0].row is not None
        assert named[0].time is not None
        assert f"row {named[0].row} at " in named[0].sentence
        assert named[0].advice


def test_several_runs_are_named(folder: Path, clean: Columns) -> None:
    """A fault of one run alone is found, and the run is named."""
    half = np.arange(4000) >= 2000
    text = (folder / "map.yaml").read_text() + "run: {column: run_id}\n"
    (folder / "map.yaml").write_text(text)
    for factor in (-1, 3.0):
        columns = {
            **clean,
            "dq1": np.where(half, factor * clean["dq1"], clean["dq1"]),
            "run_id": np.where(half, "bad", "good"),
        }
        (finding,) = found(folder, columns)
        assert (finding.level, finding.signal, finding.run) == ("error", "qvel.shoulder", "bad")
    assert found(folder, {**clean, "run_id": np.where(half, "b", "a")}) == []


# A body in free fall

BALL = (
    "<mujoco><worldbody><body name='ball'><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
)
BALL_MAP = (
    "time: {column: t}\nqpos: {ball: {columns: ['p[0:3]', 'q[0:4]']}}\n"
    "qvel: {ball: {columns: ['v[0:3]', 'w[0:3]']}}"
)
T = np.arange(300) / 300


def tossed(lie: str = "") -> Columns:
    """A toss of 0.7 s, then rest on the ground, seen by a camera with noise of 0.1 mm."""
    rng = np.random.default_rng(0)
    flying = np.minimum(T, 0.7)
    z = 1.0 + 3.0 * flying - 9.81 / 2 * flying**2
    place = np.stack([0.5 * flying, -0.3 * flying, z], axis=1) + rng.normal(0, 1e-4, (300, 3))
    speed = np.stack([0.5 + 0 * T, -0.3 + 0 * T, 3.0 - 9.81 * T], axis=1) * (T < 0.7)[:, None]
    turn = np.array([3.0, 0.0, 4.0])
    half = 2.5 * T
    q = np.hstack([np.cos(half)[:, None], np.sin(half)[:, None] * turn / 5])
    w = np.tile(turn, (300, 1))
    speed = speed + rng.normal(0, 1e-3, speed.shape)
    columns = {"t": T, "p": place, "q": q, "v": speed, "w": w + rng.normal(0, 0.01, w.shape)}
    if lie == "upside down":
        columns |= {"p": place * [1, 1, -1], "v": speed * [1, 1, -1]}
    if lie == "millimetres":
        columns |= {"p": 1e3 * place, "v": 1e3 * speed}
    if lie == "slow motion":
        columns |= {"t": 2 * T, "v": speed / 2, "w": w / 2}
    if lie == "other axes":
        columns |= {"p": place[:, [0, 2, 1]], "v": speed[:, [0, 2, 1]]}
    if lie == "x y z w":
        columns |= {"q": q[:, [1, 2, 3, 0]]}
    return columns


def test_free_fall(folder: Path) -> None:
    """Gravity shows the units of length and time, and the axes; a right toss gives nothing."""
    (folder / "robot.xml").write_text(BALL)
    (folder / "map.yaml").write_text(BALL_MAP)
    assert found(folder, tossed()) == []
    said = {
        lie: [str(finding) for finding in found(folder, tossed(lie)) if finding.level == "error"]
        for lie in ("upside down", "millimetres", "slow motion", "other axes")
    }
    falls = {
        lie: next(sentence for sentence in sentences if "fall" in sentence)
        for lie, sentences in said.items()
    }
    assert float(falls["upside down"].split(" at ")[1].split()[0]) == pytest.approx(-1, rel=0.05)
    assert "Check the sign of the axis" in falls["upside down"]
    assert float(falls["millimetres"].split(" at ")[1].split()[0]) == pytest.approx(1000, rel=0.05)
    assert float(falls["slow motion"].split(" at ")[1].split()[0]) == pytest.approx(0.25, rel=0.2)
    assert "it falls along -y, first from row" in falls["other axes"]


def test_a_quaternion_in_another_order(folder: Path) -> None:
    """Its length is right in any order, but not its rotation."""
    (folder / "robot.xml").write_text(BALL)
    (folder / "map.yaml").write_text(BALL_MAP)
    assert any("qvel.ball[" in finding.signal for finding in found(folder, tossed("x y z w")))
    columns = tossed()
    columns["q"] = 2 * columns["q"]
    assert "a quaternion must have length 1, and one has 2" in found(folder, columns)[0].sentence


def stick_slip(rows: int, rng: np.random.Generator) -> NDArray[Any]:
    """Ticks of a joint that dry friction holds for 15 rows, and that then goes on for 12."""
    place = 0.0
    ticks = []
    for k in range(rows):
        if k % 27 >= 15:
            place += rng.uniform(3.0, 6.0)
        ticks.append(np.rint(place))
    return np.array(ticks)


def test_a_joint_held_by_friction_is_no_dead_sensor(folder: Path, clean: Columns) -> None:
    """It breaks loose with steps like its next ones; one that hung jumps by all that it missed."""
    rows = len(clean["q1"])
    ticks = stick_slip(rows, np.random.default_rng(3)) * 1e-4
    (folder / "map.yaml").write_text(
        "time: {column: t}\nqpos: {shoulder: {column: q1}, elbow: {column: q2}}\n"
    )
    sentences = [finding.sentence for finding in found(folder, {**clean, "q1": ticks})]
    assert not any("hangs" in sentence for sentence in sentences)
    hung = clean["q1"].copy()
    hung[1500:1560] = hung[1500]
    sentences = [finding.sentence for finding in found(folder, {**clean, "q1": hung})]
    assert any("hangs once" in sentence for sentence in sentences)


def test_the_resolution_of_all_joints_is_one_line(folder: Path, clean: Columns) -> None:
    step = 2 * np.pi / 256
    coarse = {name: np.rint(clean[name] / step) * step for name in ("q1", "q2")}
    (folder / "map.yaml").write_text(
        "time: {column: t}\nqpos: {shoulder: {column: q1}, elbow: {column: q2}}\n"
    )
    lines = [str(finding) for finding in found(folder, {**clean, **coarse})]
    told = [line for line in lines if "resolution" in line]
    assert told == [
        "warning: qpos.shoulder, qpos.elbow: the resolution of 2 signals is 0.0245437 rad, coarse "
        "beside what they move. Their noise is at least 0.00708515 rad."
    ]


def test_the_order_of_a_quaternion(folder: Path) -> None:
    """By the names of its columns, and by its turns beside the angular velocity."""
    (folder / "robot.xml").write_text(BALL)
    (folder / "map.yaml").write_text(BALL_MAP)
    told = [str(finding) for finding in found(folder, tossed("x y z w"))]
    assert told[0].startswith("error: qpos.ball: its quaternion is in the order x, y, z, w.")
    assert not any("order" in str(finding) for finding in found(folder, tossed()))


def test_packets_that_were_lost(folder: Path, clean: Columns) -> None:
    """Of one row in 20 a warning, of one in three an error; a clean log has none."""
    for share, level in ((0.05, "warning"), (0.35, "error")):
        keep = np.random.default_rng(0).uniform(size=len(clean["t"])) > share
        findings = found(folder, {name: column[keep] for name, column in clean.items()})
        told = [finding for finding in findings if "packets were lost" in finding.sentence]
        assert [finding.level for finding in told] == [level]


def test_degrees_and_clocks(folder: Path, clean: Columns) -> None:
    """Degrees where the range is in rad; a clock that jumps, beside a gap in which joints moved."""
    text = (folder / "robot.xml").read_text()
    wide = 'type="hinge" range="-200 200"'
    limited = text.replace('name="elbow" type="hinge"', f'name="elbow" {wide}')
    (folder / "robot.xml").write_text(limited)
    assert found(folder, clean) == []
    told = found(folder, {**clean, "q2": np.degrees(clean["q2"])})
    assert told[0].level == "error"
    assert "these are degrees" in told[0].sentence
    jumped = clean["t"].copy()
    jumped[1200:] += 3.0
    told = found(folder, {**clean, "t": jumped})
    assert told[0].sentence.startswith("the clock jumps by 3.002 s, row 1200 at")
    lost = np.r_[0:1200, 1700:4000]
    told = found(folder, {name: column[lost] for name, column in clean.items()})
    assert [finding.level for finding in told] == ["warning"]
    assert "1 gap of" in told[0].sentence
