"""`dropo data describe` and `dropo data check` print what the functions say."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dropo.cli.main import main
from dropo.problems.loading import load


def test_describe_a_problem(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the signals' names and units; the data alone have numbered columns."""
    assert main(["data", "describe", str(problem)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "40 transitions in 2 trajectories of 20"
    assert [line.split()[:2] for line in lines[3:5]] == [["qpos.slide", "m"], ["qvel.slide", "m/s"]]
    assert lines[5].startswith("ctrl.push ")
    assert main(["data", "describe", str(problem.parent / "data.npz"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["transitions"] == 40
    assert list(found["signals"]) == ["observation[0]", "observation[1]", "action[0]"]


@pytest.mark.parametrize("target", ["problem.yaml", "data.npz"])
def test_the_first_transitions(
    problem: Path, capsys: pytest.CaptureFixture[str], target: str
) -> None:
    """`--transitions` takes so many of a problem or of data; raw logs have none."""
    place = str(problem.parent / target)
    assert main(["data", "describe", place, "--transitions", "25"]) == 0
    assert capsys.readouterr().out.startswith("25 transitions in 2 trajectories of 5 to 20")
    assert main(["data", "check", place, "--transitions", "25", "--json"]) == 0
    raw = ["data", "check", place, "--map", "m.yaml", "--model", "r.xml", "--transitions", "25"]
    capsys.readouterr()
    assert main(raw) == 2
    assert "--transitions is of problems and data; raw logs have rows." in capsys.readouterr().err


def test_check(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Noise on the next observations is information: status 0."""
    assert main(["data", "check", str(problem)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[:2] for line in lines] == [
        ["information", " qpos.slide"],
        ["information", " qvel.slide"],
    ]
    data = dict(np.load(problem.parent / "data.npz"))
    data["next_observations"][:-1] = data["observations"][1:]
    np.savez(problem.parent / "data.npz", **data)
    assert main(["data", "check", str(problem)]) == 0
    assert capsys.readouterr().out == "Nothing looks odd.\n"


def test_an_error_is_status_2(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Here the check prints it; `dropo fit` and `dropo diagnose` refuse it, unless they are told to
    take it.
    """
    data = dict(np.load(problem.parent / "data.npz"))
    np.savez(problem.parent / "data.npz", **data, time=np.zeros(40))
    assert main(["data", "check", str(problem), "--json"]) == 2
    sentence = "38 rows are not later than the row before them, the first is row 1."
    advice = "Take them out, or set `terminals` where the clock starts anew."
    finding = {
        "level": "error",
        "signal": "time",
        "sentence": sentence,
        "advice": advice,
        "run": None,
        "row": 1,
        "time": 0.0,
    }
    assert json.loads(capsys.readouterr().out)["findings"][0] == finding
    way_out = "If they are right all the same: --unchecked, or load(..., checked=False)."
    for command in ("fit", "diagnose"):
        assert main([command, str(problem)]) == 2
        assert (
            capsys.readouterr().err
            == f"dropo: {problem}: data: time: {sentence} {advice} {way_out}\n"
        )
    assert main(["fit", str(problem), "--unchecked", "--quiet"]) == 0
    assert main(["diagnose", str(problem), "--unchecked", "--quiet"]) == 2
    assert "needs at least 8 windows" in capsys.readouterr().err


def test_held_out_data_are_checked_too(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They judge a fit: an error there is named as theirs, and blocks it."""
    data = dict(np.load(problem.parent / "data.npz"))
    time = np.r_[0.01 * np.arange(20), np.zeros(20)]
    np.savez(problem.parent / "data.npz", **data, time=time)
    problem.write_text(problem.read_text() + "held_out: [1]\n")
    assert main(["data", "check", str(problem)]) == 2
    assert capsys.readouterr().out.startswith(
        "error: held out: time: 19 rows are not later than the row before them"
    )
    assert main(["fit", str(problem)]) == 2
    assert "problem.yaml: held_out: time: 19 rows" in capsys.readouterr().err


ARM = """
<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody><body name="link">
<joint name="hinge" axis="0 -1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1" contype="0" conaffinity="0"/>
</body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>
"""


def logged_arm(folder: Path) -> Path:
    """A problem file of an arm with dry friction, whose command and (rough) current were logged."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_frictionloss[0] = 0.2
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    rows = []
    for i in range(3001):
        data.ctrl[0] = 1.5 * np.sin(0.03 * i) + np.sin(0.011 * i)
        rows.append((data.qpos[0], data.qvel[0], data.ctrl[0]))
        mujoco.mj_step(model, data)
    log = np.array(rows)
    log[:, :2] += 1e-4 * rng.standard_normal((3001, 2))
    command = log[:, 2:]
    current = log[:, 2:] + 0.4 * rng.standard_normal((3001, 1))
    ends = np.arange(3001) % 500 == 499
    ends[-1] = True
    arrays = {"observations": log[:, :2], "terminals": ends, "actions": current}
    np.savez(
        folder / "data.npz", **arrays, **{"actions.current": current, "actions.commanded": command}
    )
    (folder / "arm.xml").write_text(ARM)
    (folder / "problem.yaml").write_text(
        "model: arm.xml\ndata: data.npz\nobservation: [qpos, qvel]\naction: [ctrl]\n"
    )
    return folder / "problem.yaml"


def test_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command moved the arm, although the model lacks its friction; `input` in the problem file
    takes it.
    """
    problem = logged_arm(tmp_path)
    assert main(["data", "inputs", str(problem), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["names"] == ["commanded", "current"]
    assert found["sure"]
    assert abs(found["values"]["commanded"]["joint_friction:hinge/frictionloss"] - 0.2) < 0.01
    stored = np.load(tmp_path / "data.npz")
    for text, name in (("", "actions"), ("input: commanded\n", "actions.commanded")):
        problem.write_text(problem.read_text() + text)
        assert (load(problem).trajectories.actions == stored[name][~stored["terminals"]]).all()
    assert main(["data", "inputs", str(problem)]) == 0
    assert "input to trust is 'commanded'" in capsys.readouterr().out


def test_inputs_that_are_not_there(
    problem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One command alone is refused, and a name that the data do not hold."""
    assert main(["data", "inputs", str(problem)]) == 2
    assert (
        "knows one command alone. An import keeps several: map them under `inputs`."
        in capsys.readouterr().err
    )
    arm = logged_arm(tmp_path)
    arm.write_text(arm.read_text() + "input: currant\n")
    assert main(["fit", str(arm)]) == 2
    assert (
        "actions.currant: expected an array of that name, got only actions.commanded, "
        "actions.current"
    ) in capsys.readouterr().err


def test_unknown_targets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "check", "cube-tos"]) == 2
    assert (
        capsys.readouterr().err
        == "dropo: No data and no problem called 'cube-tos'. Did you mean 'cube-toss'?\n"
    )
    assert main(["data", "describe", "none.npz"]) == 2
    wanted = "an .npz file, a folder of .npy files or a Minari data set"
    assert capsys.readouterr().err == f"dropo: none.npz: expected {wanted}, got no such file.\n"


MAP = (
    "time: {column: t}\n"
    "qpos: {slide: {column: x, unit: m}}\n"
    "qvel: {slide: {column: v, unit: m/s}}\n"
    "ctrl: {push: {column: f, unit: N}}\n"
)


@pytest.fixture
def log(problem: Path) -> Path:
    """log.csv beside robot.xml and map.yaml: the cart under a sine, 4 s at 100 Hz, and no problem
    file.
    """
    model = mujoco.MjModel.from_xml_path(str(problem.parent / "robot.xml"))
    data = mujoco.MjData(model)
    lines = ["t,x,v,f"]
    for i in range(400):
        data.ctrl[0] = np.sin(3 * 0.01 * i)
        lines.append(
            f"{0.01 * i:.6f},{data.qpos[0]!r},{data.qvel[0]!r},{data.ctrl[0]!r}".replace(
                "np.float64(", ""
            ).replace(")", "")
        )
        mujoco.mj_step(model, data)
    for name in ("problem.yaml", "data.npz"):
        (problem.parent / name).unlink()
    (problem.parent / "map.yaml").write_text(MAP)
    (problem.parent / "log.csv").write_text("\n".join(lines) + "\n")
    return problem.parent / "log.csv"


def test_import_check_and_fit(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A log becomes a problem that passes the check and, once a parameter is declared, is fitted:
    the true mass is 2 kg.
    """
    raw = ["--map", str(log.parent / "map.yaml"), "--model", str(log.parent / "robot.xml")]
    assert main(["data", "check", str(log), *raw]) == 0
    assert capsys.readouterr().out == "Nothing looks odd.\n"
    assert main(["data", "import", str(log), *raw, "--out", str(log.parent / "data.npz")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(
        "400 rows in 1 trajectories of 1 runs, every 10 ms (1 physics steps); of 400 rows "
        "read, 0 were dropped; 0 rows are"
    )
    path = log.parent / "problem.yaml"
    assert main(["data", "check", str(path)]) == 0
    path.write_text(
        path.read_text()
        + "parameters: {mass: {field: body_mass, name: cart, low: 1, high: 4, unit: kg}}\n"
    )
    assert main(["fit", str(path), "--transitions", "200", "--json"]) == 0
    captured = capsys.readouterr().out
    fitted = json.loads(captured[captured.index("{") :])
    assert fitted["parameters"]["mass"]["mean"] == pytest.approx(2.0, abs=0.01)


def test_refused_imports_write_nothing(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and one sentence."""
    raw = [
        "--map",
        str(log.parent / "map.yaml"),
        "--model",
        str(log.parent / "robot.xml"),
        "--out",
        str(log.parent / "out" / "data.npz"),
    ]
    (log.parent / "map.yaml").write_text(MAP.replace("column: v", "column: vel"))
    assert main(["data", "import", str(log), *raw]) == 2
    wanted = f"expected a column of {log} (the nearest is 'v'), got 'vel'."
    assert (
        capsys.readouterr().err
        == f"dropo: {log.parent / 'map.yaml'}: qvel.slide.column: {wanted}\n"
    )
    (log.parent / "map.yaml").write_text(MAP.replace("unit: m/s", "unit: m/s, sign: -1"))
    assert main(["data", "import", str(log), *raw]) == 2
    assert (
        "qvel.slide: it has the opposite sign of the change of qpos.slide"
        in capsys.readouterr().err
    )
    assert main(["data", "check", str(log), *raw[:4]]) == 2
    assert main(["data", "check", str(log), *raw[:2]]) == 2
    assert not (log.parent / "out").exists()


def test_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Positions with noise and guessed velocities become a problem with better ones, by a smoother
    or, worse, by a filter.
    """
    truth = write_swing(tmp_path)
    errors = []
    for how in ([], ["--causal"]):
        out = tmp_path / f"states{len(how)}"
        assert (
            main(
                [
                    "data",
                    "states",
                    str(tmp_path / "swing.yaml"),
                    "--unmeasured",
                    "qvel.hinge",
                    "--out",
                    str(out),
                    "--json",
                    *how,
                ]
            )
            == 0
        )
        told = json.loads(capsys.readouterr().out)
        assert told["causal"] is bool(how)
        assert told["signals"]["qvel.hinge"]["measured_sd"] is None
        assert told["signals"]["qpos.hinge"]["measured_sd"] == pytest.approx(5e-3, rel=0.25)
        found = load(out / "problem.yaml").trajectories.observations
        errors.append(np.sqrt(np.mean((found - truth)[20:] ** 2, axis=0)))
    guess = load(tmp_path / "swing.yaml").trajectories.observations
    assert (errors[0] < 0.5 * np.sqrt(np.mean((guess - truth) ** 2, axis=0))).all()
    assert (errors[0] < errors[1]).all()
    assert (
        main(
            [
                "data",
                "states",
                str(tmp_path / "swing.yaml"),
                "--unmeasured",
                "qvel.hing",
                "--out",
                str(tmp_path / "no"),
            ]
        )
        == 2
    )
    assert "Did you mean 'qvel.hinge'?" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def write_swing(folder: Path) -> np.ndarray:
    """A pendulum under random torques, measured with 5 mrad of noise, velocities by differences;
    the true states (299, 2).
    """
    xml = """<mujoco><option timestep="0.005"/><worldbody><body>
      <joint name="hinge" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
      <actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
    (folder / "swing.xml").write_text(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    rng = np.random.default_rng(0)
    state = mujoco.MjData(model)
    states = []
    commands = np.cumsum(rng.normal(0, 0.1, 300))
    for torque in commands:
        states.append([state.qpos[0], state.qvel[0]])
        state.ctrl[0] = torque
        mujoco.mj_step(model, state, 2)
    truth = np.array(states)
    angle = truth[:, 0] + rng.normal(0, 5e-3, 300)
    seen = np.stack([angle, np.gradient(angle, 0.01)], axis=1)
    np.savez(
        folder / "swing.npz",
        observations=seen,
        actions=commands[:, None],
        terminals=np.arange(300) == 299,
    )
    (folder / "swing.yaml").write_text("model: swing.xml\nframe_skip: 2\ndata: swing.npz\n")
    return truth[:-1]


SERVO = '<position name="push" joint="slide" kp="400" kv="40"/>'


def write_demonstration(folder: Path, actuator: str = "") -> np.ndarray:
    """states.yaml, a cart's motion without actions, beside its model; the true actions (60, 1)."""
    xml = (folder / "robot.xml").read_text()
    if actuator:
        start = xml.index("<motor")
        xml = xml[:start] + actuator + xml[xml.index("/>", start) + 2 :]
        (folder / "robot.xml").write_text(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    rows = []
    actions = 0.5 * np.sin(0.2 * np.arange(60))
    for action in actions:
        rows.append([data.qpos[0], data.qvel[0]])
        data.ctrl[0] = action
        mujoco.mj_step(model, data, 5)
    rows.append([data.qpos[0], data.qvel[0]])
    np.savez(folder / "states.npz", observations=rows, terminals=np.arange(61) == 60)
    text = (folder / "problem.yaml").read_text().replace("data.npz", "states.npz")
    (folder / "states.yaml").write_text(f"frame_skip: 5\n{text}")
    return actions[:, None]


def test_actions_of_a_demonstration(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The forces that moved the cart come back and replay the motion; a fit takes the new data.

    The controls: without the actions the problem is refused, and a model of another mass gives
    other forces.
    """
    folder = problem.parent
    truth = write_demonstration(folder)
    assert main(["fit", str(folder / "states.yaml")]) == 2
    assert "actions: expected an array of that name" in capsys.readouterr().err
    command = ["data", "actions", str(folder / "states.yaml"), "--json", "--out"]
    assert main([*command, str(folder / "whole.npz")]) == 0
    found = json.loads(capsys.readouterr().out)
    stored = np.load(folder / "whole.npz")
    np.testing.assert_allclose(stored["actions"], truth, atol=1e-6)
    assert found["transitions"] == 60
    assert found["actions"]["ctrl.push"]["max"] == pytest.approx(truth.max())
    assert found["unexplained"]["slide"]["largest"] < 1e-6
    for signal in ("qpos.slide", "qvel.slide"):
        assert (
            found["replay"][signal]["rmse"]["10"] < 1e-6 * found["replay"][signal]["change"]["10"]
        )
    text = (folder / "states.yaml").read_text()
    (folder / "whole.yaml").write_text(text.replace("states.npz", "whole.npz"))
    assert main(["fit", str(folder / "whole.yaml"), "--quiet"]) == 0
    xml = (folder / "robot.xml").read_text()
    (folder / "robot.xml").write_text(xml.replace('mass="2"', 'mass="1.5"'))
    assert main([*command, str(folder / "light.npz")]) == 0
    assert np.abs(np.load(folder / "light.npz")["actions"] - truth).max() > 0.05


def test_actions_of_controllers(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Set points come back as modelled; ideal controllers are near them, and replay the motion
    worse.
    """
    folder = problem.parent
    truth = write_demonstration(folder, SERVO)
    errors = {}
    for controllers in ("modelled", "ideal"):
        out = folder / f"{controllers}.npz"
        command = ["data", "actions", str(folder / "states.yaml"), "--out", str(out)]
        assert main([*command, "--controllers", controllers, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["controllers"] == controllers
        errors[controllers] = found["replay"]["qpos.slide"]["rmse"]["1"]
        tolerance = 1e-6 if controllers == "modelled" else 0.2
        np.testing.assert_allclose(np.load(out)["actions"], truth, atol=tolerance)
    assert errors["modelled"] < 1e-8
    assert errors["ideal"] > 1e-4
    assert main([*command[:4], str(folder / "text.npz")]) == 0
    assert "Replay from measured states" in capsys.readouterr().out


def test_actions_of_positions_alone(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Velocities are estimated for it; the data keep the columns that the problem names."""
    folder = problem.parent
    truth = write_demonstration(folder)
    states = dict(np.load(folder / "states.npz"))
    np.savez(folder / "states.npz", **(states | {"observations": states["observations"][:, :1]}))
    text = "observation: [qpos]\n" + (folder / "states.yaml").read_text()
    (folder / "states.yaml").write_text(text)
    out = folder / "whole.npz"
    assert main(["data", "actions", str(folder / "states.yaml"), "--out", str(out), "--quiet"]) == 0
    stored = np.load(out)
    assert stored["observations"].shape == (60, 1)
    assert np.sqrt(np.mean((stored["actions"] - truth) ** 2)) < 0.1 * truth.std()
    (folder / "states.yaml").write_text(text.replace("states.npz", "whole.npz"))
    assert main(["fit", str(folder / "states.yaml"), "--quiet"]) == 0


def test_refused_actions_write_nothing(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and the reason: no controllers, no whole states, a place that is taken or of another
    kind.
    """
    folder = problem.parent
    write_demonstration(folder)
    before = sorted(folder.iterdir())
    command = ["data", "actions", str(folder / "states.yaml"), "--out"]
    refused = {
        "'push' is no position or velocity controller": [
            str(folder / "a.npz"),
            "--controllers",
            "ideal",
        ],
        "--out: expected a file that ends in .npz, got '.csv'.": [str(folder / "a.csv")],
        "so that no data of": [str(folder / "states.npz")],
    }
    for message, rest in refused.items():
        assert main([*command, *rest]) == 2
        assert message in capsys.readouterr().err
    assert main(["data", "actions", "hopper", "--out", str(folder / "a.npz")]) == 2
    assert "inferred from whole states, and qpos[0] is not observed" in capsys.readouterr().err
    np.savez(folder / "states.npz", terminals=np.ones(3, dtype=bool))
    assert main([*command, str(folder / "a.npz")]) == 2
    assert (
        "observations: expected an array of that name, got only terminals."
        in capsys.readouterr().err
    )
    assert sorted(folder.iterdir()) == before
