"""Input that means harm, or that a tool broke: refused in one short line that names the place."""

from pathlib import Path

import numpy as np
import pytest

from dropo.cli.main import main

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom name="box" size="0.1" mass="2"/></body>
  </worldbody>
  <actuator><motor name="push" joint="slide"/></actuator>
</mujoco>
"""
TEXT = """model: robot.xml
data: data.npz
parameters:
  mass: {field: body_mass, name: cart, low: 1, high: 4, unit: kg}
epsilon: 1e-8
"""
BOMB = "".join(
    f"  a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 9)}]\n" for i in range(12)
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """problem.yaml, robot.xml and data.npz, and the working directory beside them."""
    rng = np.random.default_rng(0)
    states = np.cumsum(rng.normal(0, 0.01, (21, 2)), axis=0)
    np.savez(
        tmp_path / "data.npz",
        observations=states[:-1],
        next_observations=states[1:],
        actions=rng.normal(0, 1, (20, 1)),
        terminals=np.arange(20) == 19,
    )
    (tmp_path / "robot.xml").write_text(XML)
    (tmp_path / "problem.yaml").write_text(TEXT)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refusal(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    """The one short line of a command that is refused at once and writes nothing."""
    before = sorted(Path().iterdir())
    assert main(list(command or ("fit", "problem.yaml", "--out", "out"))) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("dropo: ")
    assert err.count("\n") == 1
    assert len(err) < 400
    assert sorted(Path().iterdir()) == before
    return err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"{TEXT}motors:\n{BOMB}", "line 12: expected at most 100000 entries, aliases counted"),
        (f"{TEXT}effects: {'[' * 5000}", "line 6: expected lists and mappings at most 50 deep"),
        (f"{TEXT}motors: {'{a: ' * 5000}", "line 6: expected lists and mappings at most 50 deep"),
        (TEXT.replace("data.npz", "!!binary aGVsbG8="), "line 2: expected no tag, got '!!binary'"),
        (TEXT.replace("1e-8", "!!float 1e-8"), "line 5: expected no tag, got '!!float'"),
        (
            TEXT.replace("data.npz", "!!python/object/apply:os.system ['touch hacked']"),
            "line 2: expected no tag, got '!!python/object/apply:os.system'",
        ),
        (TEXT.replace("data.npz", "!own x"), "line 2: expected no tag, got '!own'"),
        (f"{TEXT}# {'x' * 2**22}", "a problem file of at most 4194304 bytes, got 4194"),
        (
            f"{TEXT}frame_skip: 1000000000\n",
            "frame_skip: expected a whole number from 1 to 100000",
        ),
        (
            TEXT.replace("low: 1", "low: -1"),
            "parameters.mass: The 'low' of Parameter 'mass' must be 0 or more, since a body_mass "
            "is never negative. Got -1.0 instead.",
        ),
        (
            TEXT.replace("low: 1, high: 4", "low: -1, high: 2, target: relative"),
            "must be 0 or more, since a body_mass is never negative",
        ),
    ],
)
def test_problem_files(
    folder: Path, text: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "problem.yaml").write_text(text)
    found = refusal(capsys)
    assert found.startswith("dropo: problem.yaml: ")
    assert told in found


def test_aliases_that_say_little_are_read(folder: Path) -> None:
    from dropo.core.services.files.strict_yaml import read_yaml

    (folder / "a.yaml").write_text("a: &one [1, 2]\nb: *one\nc: [*one, *one]\n")
    assert read_yaml(folder / "a.yaml", "a file")["c"] == [[1, 2], [1, 2]]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('mass="2"', 'mass="nan"', "robot.xml: line 6: expected a number, got nan"),
        ('damping="0.5"', 'damping="NaN"', "robot.xml: line 5: expected a number, got NaN"),
        ('"0.01"', '"nan"', "robot.xml: line 3: expected a number, got nan"),
        ('"0.01"', '"0"', "robot.xml: timestep: expected 1e-09 to 1000 s, got 0"),
        ('"0.01"', '"1e308"', "robot.xml: timestep: expected 1e-09 to 1000 s, got 1e+308"),
        ('"0.01"', '"1e-300"', "robot.xml: timestep: expected 1e-09 to 1000 s, got 1e-300"),
        ('"0.01"', '"0.01" gravity="0 0 -nan"', "robot.xml: line 3: expected a number, got -nan"),
    ],
)
def test_models_with_impossible_numbers(
    folder: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """By file and line or name; no log of MuJoCo's is left."""
    (folder / "robot.xml").write_text(XML.replace(old, new))
    assert told in refusal(capsys)


def test_names_with_nan_are_names(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("robot.xml", "problem.yaml"):
        path = folder / name
        path.write_text(path.read_text().replace("cart", "nan"))
    assert main(["data", "describe", "problem.yaml"]) == 0


@pytest.mark.parametrize(
    ("key", "signal"),
    [("observations", "qvel.slide"), ("next_observations", "qvel.slide"), ("actions", "ctrl.push")],
)
def test_a_sentinel_in_the_data(
    folder: Path, key: str, signal: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Named by row and signal, by a fit, and by `dropo data check` as an error."""
    with np.load(folder / "data.npz") as kept:
        arrays = dict(kept)
    arrays[key][5, -1] = 1e30
    np.savez(folder / "data.npz", **arrays)
    found = refusal(capsys)
    assert f"data: {signal}: a number beyond 1e+10 is no measurement" in found
    assert "row 5" in found
    assert "1e+30" in found
    assert main(["data", "check", "problem.yaml"]) == 2
    assert f"error: {signal}: a number beyond" in capsys.readouterr().out
    arrays[key][5, -1] = -9999
    np.savez(folder / "data.npz", **arrays)
    for command in ("fit", "diagnose"):
        told = refusal(capsys, command, "problem.yaml")
        assert f"data: {signal}: -9999" in told
        assert "of 1 the first is in row 5 at" in told
    assert main(["data", "check", "problem.yaml"]) == 2
    assert f"error: {signal}: -9999" in capsys.readouterr().out


def test_a_sentinel_in_a_log(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "map.yaml").write_text(
        "time: {column: t, unit: s}\nqpos: {slide: {column: q, unit: m}}\n"
        "ctrl: {push: {column: u, unit: N}}\n"
    )
    rows = [f"{i / 100},{0.01 * i**2},{i % 3}" for i in range(30)]
    rows[7] = "0.07,1e30,1"
    (folder / "log.csv").write_text("\n".join(["t,q,u", *rows]) + "\n")
    command = ["data", "check", "log.csv", "--map", "map.yaml", "--model", "robot.xml"]
    assert main(command) == 2
    assert "error: qpos.slide: a number beyond 1e+10" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("option", "value"), [("--draws", "10000000"), ("--threads", "100000"), ("--budget", "1" * 30)]
)
def test_options_beyond_all_bounds(
    folder: Path, option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refusal(capsys, "fit", "problem.yaml", option, value)
    assert f"Argument {option}: expected a whole number" in told
    assert "at most 10" in told


def test_names_that_are_no_text(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A flipped byte in a joint's name, which MuJoCo reads; one in a comment does no harm."""
    model = folder / "robot.xml"
    model.write_bytes(XML.encode().replace(b'name="slide"', b'name="sl\xfade"'))
    motors = "motors: {slide: {rotor_inertia: 1e-5, gear_ratio: 2}}\n"
    (folder / "problem.yaml").write_text(TEXT + motors)
    assert "robot.xml: expected names of joints in UTF-8" in refusal(capsys)
    model.write_bytes(XML.encode().replace(b"<worldbody>", b"<worldbody><!-- \xfa -->"))
    main(["data", "check", "problem.yaml"])
    assert "UTF-8" not in capsys.readouterr().err
