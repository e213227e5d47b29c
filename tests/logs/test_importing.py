"""Logs with known faults are imported with delays and noise levels that are right; good ones come
out as they went in.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, BadFile
from dropo.data.checks.check import check
from dropo.data.reading import read
from dropo.logs.guessing.check import check_logs
from dropo.logs.importing import Import, import_logs
from dropo.logs.mapping import read_mapping
from dropo.logs.recordings import read_runs
from dropo.mjmodel.joints import load_model_joints
from dropo.problems.loading import load

Columns = dict[str, Any]
POSITIONS = """
time: {column: t}
qpos: {shoulder: {column: q1}, elbow: {column: q2}}
ctrl: {m1: {column: tau1}, m2: {column: tau2}}
"""


def imported(folder: Path, columns: Columns, text: str | None = None) -> Import:
    """What an import of these columns writes into the folder `out`."""
    np.savez(folder / "log.npz", **columns)
    if text is not None:
        (folder / "map.yaml").write_text(text)
    return import_logs(
        folder / "log.npz", folder / "map.yaml", folder / "robot.xml", folder / "out" / "data.npz"
    )


def test_a_good_log_comes_out_as_it_went_in(folder: Path, arm: Any) -> None:
    """500 Hz on a model of 1 ms: two physics steps, nothing resampled, dropped, left out, shifted
    or found.
    """
    log = arm.log()
    found = imported(folder, log)
    data = read(folder / "out" / "data.npz")
    assert (found.frame_skip, found.control_step) == (2, 0.002)
    np.testing.assert_array_equal(
        data.observations, np.stack([log["q1"], log["q2"], log["dq1"], log["dq2"]], axis=1)[:-1]
    )
    np.testing.assert_array_equal(data.actions, np.stack([log["tau1"], log["tau2"]], axis=1)[:-1])
    assert data.time is not None
    np.testing.assert_allclose(data.time, log["t"][:-1], atol=1e-9)
    assert found.rows["log"] | {"log": ""} == {
        "log": "",
        "read": 4000,
        "dropped": 0,
        "resampled": 0,
        "kept": 4000,
        "trajectories": 1,
    }
    assert (found.left_out, found.findings) == ([], [])
    assert not any(late.removed for late in found.delays)


def test_the_problem_file_is_ready(folder: Path, arm: Any) -> None:
    """It loads, passes the check, and its model explains the data; import.json says the same as the
    result.
    """
    found = imported(folder, arm.log(rate=1000))
    problem = load(folder / "out" / "problem.yaml", threads=1)
    assert [
        finding
        for finding in check(problem.trajectories, problem)
        if finding.level != "information"
    ] == []
    assert [signal.name for signal in problem.simulator.signals] == [
        "qpos.shoulder",
        "qpos.elbow",
        "qvel.shoulder",
        "qvel.elbow",
    ]
    record = json.loads((folder / "out" / "import.json").read_text())
    assert str(folder) not in json.dumps(record)
    assert record.pop("model") == "../robot.xml"
    assert len(record.pop("problem_sum")) == 64
    said = json.loads(json.dumps(found.to_json()))
    for rows, as_given in zip(record["runs"].values(), said["runs"].values(), strict=True):
        given = Path(as_given.pop("log"))
        assert (folder / "out" / rows.pop("log")).resolve() == given.resolve()
    assert record == said
    assert record["noise"]["qvel.elbow"]["unit"] == "rad/s"
    error = problem.simulator.predict(np.empty((1, 0)), problem.segments)[
        0
    ] - problem.simulator.targets(problem.segments)
    assert np.abs(error).max() < 1e-6  # the log is the model's own motion


@pytest.mark.parametrize("delay", [0.3e-3, 2e-3, 12e-3])
def test_delays(folder: Path, arm: Any, delay: float) -> None:
    """A late velocity, with noise on both, is found to 0.2 ms and taken off; that of the other
    joint, on time, is left.
    """
    log = arm.log(seconds=12)
    rng = np.random.default_rng(1)
    log["dq1"] = arm.qvel(log["t"] - delay)[:, 0]
    for name, sd in (("q1", 2e-4), ("q2", 2e-4), ("dq1", 0.02), ("dq2", 0.02)):
        log[name] = log[name] + rng.normal(0, sd, len(log[name]))
    found = imported(folder, log)
    late, other = found.delays
    assert (late.signal, late.reference) == ("qvel.shoulder", "qpos.shoulder")
    assert abs(late.seconds - delay) < 0.2e-3
    assert abs(late.seconds - delay) < 4 * late.se
    assert late.removed
    assert abs(other.seconds) < 0.2e-3
    data = found.arrays
    wrong = data["observations"][:, 2] - arm.qvel(data["time"])[:, 0]
    assert np.sqrt(np.mean(wrong**2)) < 0.03
    assert found.noise["qvel.shoulder"].sd == pytest.approx(0.02, rel=0.2)
    assert found.noise["qpos.elbow"].sd == pytest.approx(2e-4, rel=0.2)


def two_files(folder: Path, log: Columns, beside: Columns, columns: dict[str, str]) -> Import:
    """log.npz and, with a clock of its own, log_drive.npz, whose columns take the place of those of
    MAP.
    """
    np.savez(folder / "log_drive.npz", **beside)
    text = (folder / "map.yaml").read_text()
    for name, unit in columns.items():
        text = text.replace(
            f"{{column: {name},",
            f"{{column: {name}, file: '{{stem}}_drive.npz', "
            f"clock: {{column: ticks, unit: {unit}}},",
        )
    return imported(folder, log, text)


def test_two_clocks(folder: Path, arm: Any) -> None:
    """Velocities at 330 Hz on a clock that runs 1 % fast, counts microseconds from elsewhere and is
    7 ms late: to 0.2 ms.
    """
    log = arm.log(seconds=15)
    rng = np.random.default_rng(2)
    true = 1.02 + np.arange(4800) / 330
    speeds = arm.qvel(true) + rng.normal(0, 0.02, (4800, 2))
    ticks = 1e6 * (5.0 + 1.01 * (true - 1.0) + 0.007)
    found = two_files(
        folder,
        log,
        {"ticks": ticks, "dq1": speeds[:, 0], "dq2": speeds[:, 1]},
        {"dq1": "us", "dq2": "us"},
    )
    clock = found.delays[0]
    assert clock.skew == pytest.approx(0.01, abs=5e-5)
    stamps = ticks * 1e-6
    at = clock.origin + (stamps - clock.origin - clock.seconds) / (1 + clock.skew)
    assert np.abs(at - true).max() < 0.2e-3
    wrong = found.arrays["observations"][:, 2:] - arm.qvel(found.arrays["time"])
    assert np.sqrt(np.mean(wrong**2)) < 0.03


def test_commands_on_another_clock(folder: Path, arm: Any) -> None:
    """Commands of a clock 1 % fast and 40 ms late are brought back by the forces that the motion
    needs.
    """
    log = arm.log(seconds=15)
    true = np.arange(1.0, 16.0, 0.001)
    torques = arm.ctrl(true)
    beside = {
        "ticks": 1.0 + 1.01 * (true - 1.0) + 0.04,
        "tau1": torques[:, 0],
        "tau2": torques[:, 1],
    }
    found = two_files(folder, log, beside, {"tau1": "s", "tau2": "s"})
    assert found.delays[0].reference == "the forces that the motion needs"
    assert found.delays[0].skew == pytest.approx(0.01, abs=2e-4)
    clock = found.delays[0]
    at = clock.origin + (beside["ticks"] - clock.origin - clock.seconds) / (1 + clock.skew)
    assert np.abs(at - true).max() < 0.2e-3
    held = arm.ctrl(true[np.searchsorted(true, found.arrays["time"] + 1e-9, side="right") - 1])
    wrong = (
        found.arrays["actions"] - held
    )  # a stamp that is late by less than a step leaves the row before for as long
    assert np.sqrt(np.mean(wrong[:-1] ** 2)) < 0.02 * torques.std()


def test_topics_of_other_rates(folder: Path, arm: Any) -> None:
    """Positions at 400 Hz and commands at 125 Hz, uneven, in another file on the same clock:
    resampled on one grid.
    """
    log = arm.log(rate=400, seconds=6)
    rng = np.random.default_rng(3)
    t = np.sort(0.9 + np.arange(900) / 125 + rng.uniform(-1e-3, 1e-3, 900))
    text = (folder / "map.yaml").read_text() + "rate: 250\n"
    for name in ("tau1", "tau2"):
        text = text.replace(f"{{column: {name},", f"{{column: {name}, file: '{{stem}}_drive.npz',")
    np.savez(folder / "log_drive.npz", t=t, tau1=arm.ctrl(t)[:, 0], tau2=arm.ctrl(t)[:, 1])
    found = imported(folder, log, text)
    assert (found.frame_skip, len(found.trajectories)) == (4, 1)
    at = found.arrays["time"]
    np.testing.assert_allclose(np.diff(at), 0.004)
    np.testing.assert_allclose(
        found.arrays["observations"], np.hstack([arm.qpos(at), arm.qvel(at)]), atol=2e-3
    )
    parts = [
        t[np.searchsorted(t, at + share * 0.004, side="right") - 1]
        for share in (np.arange(400) + 0.5) / 400
    ]
    held = np.mean(
        [arm.ctrl(part) for part in parts], axis=0
    )  # each row until the next, over the control step
    assert np.sqrt(np.mean((found.arrays["actions"] - held) ** 2)) < 1e-3 * held.std()


@pytest.mark.parametrize("fault", ["noise", "quantisation"])
def test_positions_alone(folder: Path, arm: Any, fault: str) -> None:
    """Velocities are estimated, and their stated noise level is right within 20 %; noise or a
    12-bit encoder.
    """
    log = arm.log(seconds=12)
    rng = np.random.default_rng(4)
    step = 2 * np.pi / 4096
    for name in ("q1", "q2"):
        log[name] = (
            log[name] + rng.normal(0, 5e-4, len(log["t"]))
            if fault == "noise"
            else np.rint(log[name] / step) * step
        )
    found = imported(folder, log, POSITIONS)
    wrong = found.arrays["observations"][:, 2:] - arm.qvel(found.arrays["time"])
    for i, joint in enumerate(("shoulder", "elbow")):
        noise = found.noise[f"qvel.{joint}"]
        assert (noise.unit, noise.estimated) == ("rad/s", True)
        assert noise.sd == pytest.approx(np.sqrt(np.mean(wrong[:, i] ** 2)), rel=0.2)
        true = 5e-4 if fault == "noise" else step / np.sqrt(12)
        assert found.noise[f"qpos.{joint}"].sd == pytest.approx(true, rel=0.2)


def test_commands_stay_as_they_were_beside_estimated_velocities(folder: Path, arm: Any) -> None:
    """Stamps on the grid: the half step by which the velocities are late moves neither the
    positions nor the commands.
    """
    log = arm.log()
    imported(folder, {name: log[name] for name in ("t", "q1", "q2", "tau1", "tau2")}, POSITIONS)
    data = read(folder / "out" / "data.npz")
    at = [int(np.flatnonzero(row == log["q1"])[0]) for row in data.observations[[0, -1], 0]]
    assert at[1] - at[0] == len(data) - 1 >= len(log["t"]) - 4
    np.testing.assert_array_equal(data.observations[:, 1], log["q2"][at[0] : at[1] + 1])
    np.testing.assert_array_equal(
        data.actions, np.stack([log["tau1"], log["tau2"]], axis=1)[at[0] : at[1] + 1]
    )


def test_commands_faster_than_the_control_step_are_averaged(folder: Path, arm: Any) -> None:
    """Five rows of a log in every control step: positions are those at its beginning, commands the
    means over it.
    """
    log = arm.log()
    imported(folder, log, (folder / "map.yaml").read_text() + "rate: 100\n")
    data = read(folder / "out" / "data.npz")
    np.testing.assert_array_equal(data.observations[:, 0], log["q1"][: 5 * len(data) : 5])
    np.testing.assert_allclose(
        data.actions[:, 0],
        log["tau1"][: 5 * len(data)].reshape(-1, 5).mean(axis=1),
        rtol=1e-6,
        atol=1e-9,
    )


def test_gaps_end_trajectories(folder: Path, arm: Any) -> None:
    """Two gaps make three trajectories of one group; what is left out is said, with why."""
    log = arm.log()
    keep = np.ones(4000, dtype=bool)
    keep[1000:1040] = keep[2500:2700] = False
    found = imported(folder, {name: column[keep] for name, column in log.items()})
    assert found.trajectories == [1000, 1460, 1300]
    assert [(span.start, span.stop) for span in found.left_out] == [
        (log["t"][999], log["t"][1040]),
        (log["t"][2499], log["t"][2700]),
    ]
    assert {span.why.split(" of ")[0] for span in found.left_out} == {"a gap in the stamps"}
    assert set(found.arrays["group"]) == {0}
    data = read(folder / "out" / "data.npz")
    assert len(data.spans) == 3
    wrong = data.next_observations[:, :2] - arm.qpos(np.asarray(data.time) + 0.002)
    assert np.abs(wrong).max() < 1e-9


def test_rows_that_cannot_be_used(folder: Path, arm: Any) -> None:
    """Doubled and late rows are dropped; a sensor that hangs is left out; an encoder that starts
    anew is unwrapped.
    """
    log = arm.log()
    log["q1"] = np.mod(log["q1"], 2 * np.pi)
    log["q2"] = log["q2"].copy()
    log["q2"][700:760] = log["q2"][700]
    order = np.concatenate(
        [np.arange(100), [99], np.arange(100, 3000), [2990], np.arange(3000, 4000)]
    )
    found = imported(folder, {name: column[order] for name, column in log.items()})
    assert found.rows["log"]["dropped"] == 2 + 59
    assert ["59 rows of qpos.elbow hang" in span.why for span in found.left_out] == [True]
    np.testing.assert_allclose(
        np.diff(found.arrays["observations"][:, 0]),
        np.diff(arm.qpos(found.arrays["time"])[:, 0]),
        atol=1e-6,
    )
    assert [finding.signal for finding in found.findings] == [
        "t",
        "t",
        "qpos.elbow",
        "qpos.shoulder",
    ]


def test_control_step(folder: Path, arm: Any) -> None:
    """The mapping's rate, else the median of the log, as a whole number of physics steps; a rate in
    between is refused.
    """
    text = (folder / "map.yaml").read_text()
    assert imported(folder, arm.log(rate=245, seconds=4)).frame_skip == 4
    assert imported(folder, arm.log(rate=500, seconds=4), text + "rate: 100\n").frame_skip == 10
    with pytest.raises(
        BadFile,
        match=(
            r"rate: expected a rate whose control step is a whole number of .* such as 500 "
            r"Hz, got 400"
        ),
    ):
        imported(folder, arm.log(rate=500, seconds=4), text + "rate: 400\n")


def test_candidates_stand_side_by_side(folder: Path, arm: Any) -> None:
    """The first one's commands are the actions; all are kept by name, in one file that `read`
    takes.
    """
    log = arm.log()
    text = (folder / "map.yaml").read_text().replace("ctrl:", "inputs:\n  commanded:")
    text += "  current: {m2: {column: i2, unit: mN m}, m1: {column: i1, unit: mN m}}\n"
    found = imported(folder, {**log, "i1": 900 * log["tau1"], "i2": 900 * log["tau2"]}, text)
    assert found.inputs == ("commanded", "current")
    np.testing.assert_allclose(found.arrays["actions.current"], 0.9 * found.arrays["actions"])
    np.testing.assert_array_equal(found.arrays["actions.commanded"], found.arrays["actions"])
    np.testing.assert_array_equal(
        read(folder / "out" / "data.npz").actions, found.arrays["actions"][:-1]
    )


def test_some_joints_alone(folder: Path, arm: Any) -> None:
    """The items name what is observed; without a command all actuators are at zero."""
    found = imported(
        folder,
        arm.log(),
        "time: {column: t}\nqpos: {elbow: {column: q2}}\nqvel: {elbow: {column: dq2}}",
    )
    assert (found.observation, found.action) == (["qpos.elbow", "qvel.elbow"], ["ctrl"])
    assert not found.arrays["actions"].any()
    problem = load(folder / "out" / "problem.yaml", threads=1)
    assert len(problem.simulator.signals) == 2


def test_rotations(folder: Path) -> None:
    """A body that spins and falls, positions alone: the body's angular velocity is estimated,
    across the quaternion's change of sign.
    """
    (folder / "robot.xml").write_text(
        "<mujoco><worldbody><body name='b'><freejoint/><geom "
        "size='.1'/></body></worldbody></mujoco>"
    )
    t = np.arange(0, 1.0, 0.004)
    angle = 7.0 * t / 2
    axis = np.array([0.6, 0.0, 0.8])
    q = np.hstack([np.cos(angle)[:, None], np.sin(angle)[:, None] * axis])
    q[60:] *= -1
    place = np.stack([t, 0 * t, 1 - 9.81 / 2 * t**2], axis=1) + np.random.default_rng(0).normal(
        0, 1e-5, (len(t), 3)
    )
    text = "time: {column: t}\nqpos: {b: {columns: ['p[0:3]', 'q[0:4]']}}\nrate: 250"
    found = imported(folder, {"t": t, "p": place, "q": q}, text)
    assert (found.frame_skip, found.observation) == (2, ["qpos", "qvel"])
    velocities = found.arrays["observations"][:, 7:]
    np.testing.assert_allclose(
        velocities[:, 3:], np.tile(7.0 * axis, (len(velocities), 1)), atol=0.01
    )
    np.testing.assert_allclose(velocities[:, 2], -9.81 * found.arrays["time"], atol=0.02)
    problem = load(folder / "out" / "problem.yaml", threads=1)
    assert set(problem.estimated) == {
        signal.name for signal in problem.simulator.signals if signal.name.startswith("qvel")
    }


def test_nothing_is_written_where_something_is_refused(folder: Path, arm: Any) -> None:
    log = arm.log()
    with pytest.raises(
        BadArgument,
        match=(
            r"qvel.elbow: it has the opposite sign of the change of qpos.elbow, .* Give one "
            r"of the two"
        ),
    ):
        imported(folder, {**log, "dq2": -log["dq2"]})
    with pytest.raises(BadFile):
        imported(folder, {**log, "t": np.full(4000, np.nan)})
    assert not (folder / "out").exists()
    with pytest.raises(BadFile, match=r"--out: expected a file that ends in .npz, got '.csv'"):
        import_logs(
            [folder / "log.npz"], folder / "map.yaml", folder / "robot.xml", folder / "data.csv"
        )


def test_a_problem_file_with_parameters_is_kept(folder: Path, arm: Any) -> None:
    """An import may be repeated, but not over a problem file that someone has worked on."""
    imported(folder, arm.log(seconds=4))
    imported(folder, arm.log(seconds=4))
    path = folder / "out" / "problem.yaml"
    path.write_text(path.read_text() + "lambda: 20\n")
    before = (folder / "out" / "data.npz").read_bytes()
    with pytest.raises(
        BadFile,
        match=(
            r"problem.yaml: expected no file, or one that an import wrote, .* got one that "
            r"was changed"
        ),
    ):
        imported(folder, arm.log(seconds=4))
    assert (folder / "out" / "data.npz").read_bytes() == before
    assert sorted(file.name for file in (folder / "out").iterdir()) == [
        "data.npz",
        "import.json",
        "problem.yaml",
    ]


# Measured data, where they are at hand

MEASURED = {
    "double-pendulum": (
        "model.xml",
        """
qpos: {shoulder: {column: 'qpos[0]'}, elbow: {column: 'qpos[1]'}}
qvel: {shoulder: {column: 'qvel[0]'}, elbow: {column: 'qvel[1]'}}
inputs:
  commanded: {m1: {column: 'ctrl[0]', unit: N m}, m2: {column: 'ctrl[1]', unit: N m}}
  current: {m1: {column: 'tau[0]', unit: N m}, m2: {column: 'tau[1]', unit: N m}}
run: {only: [A0_sysid_00, A0_pendubot_0]}
""",
    ),
    "simple-pendulum": (
        "model.xml",
        """
qpos: {hinge: {column: qpos}}
qvel: {hinge: {column: qvel}}
ctrl: {m: {column: tau, unit: N m}}
run: {only: [pd_sysid, ddp]}
""",
    ),
    "cube-toss": (
        "model.xml",
        """
qpos: {cube: {columns: 'qpos[0:7]'}}
qvel: {cube: {columns: 'qvel[0:6]'}}
run: {only: ['toss_00*']}
""",
    ),
    "swinging-pendulum": (
        "model_single.xml",
        """
qpos: {j1: {column: 'qpos[0]'}}
qvel: {j1: {column: 'qvel[0]'}}
run: {only: [single_00]}
""",
    ),
}


def measured_data() -> Path:
    """The folder of the measured sets; the test is skipped without."""
    folders = (
        Path(os.environ.get("DROPO_DATA", "none")),
        Path(__file__).parents[3] / "shared" / "data",
    )
    found = next((folder for folder in folders if (folder / "double-pendulum").is_dir()), None)
    if found is None:
        pytest.skip("needs the measured data (DROPO_DATA)")
    return found


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.study) if name == "double-pendulum" else name
        for name in MEASURED
    ],
)
def test_measured_sets(tmp_path: Path, name: str) -> None:
    """Each imports without an error, and its problem passes the check before every fit."""
    source = measured_data()
    model, text = MEASURED[name]
    (tmp_path / "map.yaml").write_text(text)
    found = import_logs(
        [source / name / "runs.npz"],
        tmp_path / "map.yaml",
        source / name / model,
        tmp_path / "data.npz",
    )
    problem = load(tmp_path / "problem.yaml", threads=1)
    assert [
        finding for finding in check(problem.trajectories, problem) if finding.level == "error"
    ] == []
    assert sum(found.trajectories) == sum(run["kept"] for run in found.rows.values()) > 500
    if (
        name == "cube-toss"
    ):  # differences to the row before are half a row late; the model's own, half a physics step
        assert found.delays[0].seconds == pytest.approx(0.5 / 148 - 0.5 / 592, abs=0.2e-3)


def test_a_measured_run_as_a_table(tmp_path: Path, csv: Any) -> None:
    """The same run as CSV, in degrees and milliseconds and with one sign turned, gives the same
    data as the archive.
    """
    source = measured_data() / "double-pendulum"
    model, text = MEASURED["double-pendulum"]
    with np.load(source / "runs.npz") as content:
        number = [str(name) for name in content["names"]].index("A0_sysid_00")
        run = {
            key: content[f"{number:03d}/{key}"].astype(float)
            for key in ("time", "qpos", "qvel", "tau")
        }
    columns = {
        "ms": 1e3 * run["time"],
        "q1": np.degrees(run["qpos"][:, 0]),
        "q2": -run["qpos"][:, 1],
        "v1": run["qvel"][:, 0],
        "v2": -run["qvel"][:, 1],
        "u1": run["tau"][:, 0],
        "u2": run["tau"][:, 1],
    }
    csv(tmp_path / "log.csv", columns)
    (tmp_path / "table.yaml").write_text("""
time: {column: ms, unit: ms}
qpos: {shoulder: {column: q1, unit: deg}, elbow: {column: q2, sign: -1}}
qvel: {shoulder: {column: v1}, elbow: {column: v2, sign: -1}}
ctrl: {m1: {column: u1}, m2: {column: u2}}
""")
    (tmp_path / "runs.yaml").write_text(text.replace("A0_sysid_00, A0_pendubot_0", "A0_sysid_00"))
    table = import_logs(
        [tmp_path / "log.csv"], tmp_path / "table.yaml", source / model, tmp_path / "a" / "data.npz"
    ).arrays
    archive = import_logs(
        [source / "runs.npz"], tmp_path / "runs.yaml", source / model, tmp_path / "b" / "data.npz"
    ).arrays
    np.testing.assert_allclose(table["observations"], archive["observations"], atol=1e-5)
    np.testing.assert_allclose(table["actions"], archive["actions.current"], atol=1e-5)


def test_a_rate_that_must_be_resampled(folder: Path, arm: Any) -> None:
    """Rows every 2.5 ms on a model of 1 ms are resampled; the step that is proposed avoids it."""
    found = imported(folder, arm.log(rate=400, seconds=4))
    warning = next(str(finding) for finding in found.findings if "whole number" in str(finding))
    assert warning == (
        "warning: time: a row every 2.5 ms is no whole number of the model's physics steps of "
        '1 ms: all rows are resampled on 2 ms. `<option timestep="0.0005"/>` avoids it.'
    )
    text = (folder / "robot.xml").read_text()
    (folder / "robot.xml").write_text(text.replace('"0.001"', '"0.0005"'))
    again = imported(folder, arm.log(rate=400, seconds=4))
    assert not any("whole number" in str(finding) for finding in again.findings)
    assert again.control_step == pytest.approx(0.0025)


def test_runs_of_one_name_are_told_apart(folder: Path, arm: Any) -> None:
    """Two files of a name in two folders: the second is called by its path."""
    for name in ("monday", "tuesday"):
        (folder / name).mkdir()
        np.savez(folder / name / "log.npz", **arm.log(seconds=1))
    logs = [folder / name / "log.npz" for name in ("monday", "tuesday")]
    found = import_logs(logs, folder / "map.yaml", folder / "robot.xml", folder / "out" / "a.npz")
    assert list(found.rows) == ["log", str(logs[1])]
    again = import_logs(
        [*logs, logs[1]], folder / "map.yaml", folder / "robot.xml", folder / "out" / "b.npz"
    )
    assert list(again.rows)[2] == f"{logs[1]}: log (2)"


def test_commands_of_some_actuators_are_of_these_columns(folder: Path, arm: Any) -> None:
    """The others have no column of actions."""
    text = POSITIONS.replace("m1: {column: tau1}, ", "")
    found = imported(folder, arm.log(seconds=1), text)
    data = read(folder / "out" / "data.npz")
    assert data.actions.shape[1] == 1
    assert "ctrl[1]" in (folder / "out" / "problem.yaml").read_text()
    assert found.rows["log"]["trajectories"] == 1


def test_a_log_without_a_trajectory_is_refused(folder: Path, arm: Any) -> None:
    """Two signals that are never there together, and nothing is written."""
    log = arm.log(seconds=2)
    log["q1"] = np.where(np.arange(1000) < 400, log["q1"], np.nan)
    log["q2"] = np.where(np.arange(1000) > 600, log["q2"], np.nan)
    with pytest.raises(BadArgument, match="No run holds a trajectory: not every signal is there"):
        imported(folder, log)
    assert not (folder / "out").exists()


def test_many_spans_that_are_left_out_are_counted(
    folder: Path, arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first are printed, of the others how many there are."""
    monkeypatch.setattr("dropo.logs.importing.SHOWN", 4)
    keep = np.ones(2000, dtype=bool)
    for first in range(100, 1900, 120):
        keep[first : first + 40] = False
    found = imported(folder, {name: one[keep] for name, one in arm.log(seconds=4).items()})
    assert len(found.left_out) == 15
    lines = str(found).splitlines()
    assert "... and 11 more spans left out" in lines
    assert sum(line.startswith("left out: log, ") for line in lines) == 4


def test_what_is_checked_beside_the_mapping(folder: Path, arm: Any) -> None:
    """A joint that is commanded and not measured; a base that moves, once for all logs."""
    text = "time: {column: t}\nqpos: {elbow: {column: q2}}\nctrl: {m1: {column: tau1}}"
    (folder / "map.yaml").write_text(text)
    log = arm.log(seconds=1)
    names = ("base_x", "base_y", "base_z")
    moving = log | {name: 0.2 * np.sin(log["t"]) for name in names}
    logs = []
    for i in range(2):
        logs.append(folder / f"log{i}.npz")
        np.savez(logs[-1], **moving)
    robot = load_model_joints(folder / "robot.xml")
    mapping = read_mapping(folder / "map.yaml", robot)
    runs = read_runs(logs, mapping, lambda share, what: None)
    texts = [finding.sentence for finding in check_logs(logs, runs, mapping, robot)]
    assert "commanded, and without a position in the log: shoulder." in texts
    assert sum("fixed in the model and moves in the log" in text for text in texts) == 1
