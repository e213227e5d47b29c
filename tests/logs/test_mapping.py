"""The mapping file: what it may say, and the refusals of what it must not."""

from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.logs.mapping import Mapping, read_mapping
from dropo.logs.recordings import read_runs
from dropo.mjmodel.joints import load_model_joints

BODIES = """
<mujoco>
  <worldbody>
    <body name="cube"><freejoint/><geom size="0.1"/></body>
    <body name="head" pos="2 0 0"><joint name="neck" type="ball"/><geom size="0.1"/></body>
    <body name="cart" pos="4 0 0"><joint name="rail" type="slide"/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def mapping(folder: Path, text: str, model: str = "robot.xml") -> Mapping:
    """The mapping that a text is."""
    (folder / "map.yaml").write_text(text)
    return read_mapping(folder / "map.yaml", load_model_joints(folder / model))


def refusal(folder: Path, text: str, model: str = "robot.xml") -> str:
    """The sentence with which a text is refused, without the folder."""
    with pytest.raises(BadFile) as caught:
        mapping(folder, text, model)
    return str(caught.value).replace(f"{folder}/", "").removeprefix("map.yaml: ")


def test_units_signs_and_offsets(folder: Path) -> None:
    """value = unit (sign column + offset): the offset is in the column's own unit."""
    text = (
        "time: {column: t, unit: ms}\n"
        "qpos: {elbow: {column: q2, unit: deg, sign: -1, offset: 90}}\n"
        "ctrl: {m1: {column: u, unit: mN m}}"
    )
    np.savez(
        folder / "log.npz", t=[0.0, 500.0, 1500.0], q2=[0.0, 90.0, 180.0], u=[0.0, 1000.0, 2000.0]
    )
    (run,) = read_runs([folder / "log.npz"], mapping(folder, text), lambda share, what: None)
    elbow, torque = run.series
    np.testing.assert_allclose(elbow.time, [0, 0.5, 1.5])
    np.testing.assert_allclose(elbow.values[:, 0], [np.pi / 2, 0, -np.pi / 2], atol=1e-15)
    np.testing.assert_allclose(torque.values[:, 0], [0, 1, 2])


def test_joints_of_several_numbers(folder: Path) -> None:
    """Free and ball joints take `columns`, a list or a slice; a joint without a name goes by its
    body's.
    """
    (folder / "bodies.xml").write_text(BODIES)
    text = """
qpos:
  cube: {columns: [x, y, z, 'quat[0:4]'], unit: mm}
  neck: {columns: 'head[0:4]'}
  rail: {column: s, unit: cm}
qvel:
  cube: {columns: 'v[0:6]', unit: [mm/s, deg/s]}
"""
    found = mapping(folder, text, "bodies.xml")
    cube, neck, rail, speed = found.channels
    assert cube.columns == ("x", "y", "z", "quat[0]", "quat[1]", "quat[2]", "quat[3]")
    assert cube.factors == (1e-3, 1e-3, 1e-3, 1, 1, 1, 1)
    assert neck.units == ("",) * 4
    assert rail.factors == (1e-2,)
    assert speed.factors == pytest.approx((1e-3,) * 3 + (np.pi / 180,) * 3)
    assert (
        refusal(folder, "qpos: {cube: {columns: 'p[0:6]'}}", "bodies.xml")
        == "qpos.cube.columns: expected 7 columns, got 6."
    )
    assert refusal(folder, "qpos: {rail: {column: s, unit: deg}}", "bodies.xml") == (
        "qpos.rail.unit: expected a unit (there is cm, m, mm), got 'deg'."
    )


def test_candidates(folder: Path) -> None:
    """Several inputs have names; each holds the same actuators."""
    head = "qpos: {elbow: {column: q2}}\n"
    found = mapping(
        folder, head + "inputs: {commanded: {m1: {column: a}}, current: {m1: {column: b}}}"
    )
    assert found.candidates == ("commanded", "current")
    assert [channel.label for channel in found.of("ctrl", "current")] == ["inputs.current.m1"]
    assert mapping(folder, head + "ctrl: {m1: {column: a}}").candidates == ("command",)
    assert mapping(folder, head).candidates == ()
    uneven = head + "inputs: {commanded: {m1: {column: a}}, current: {m2: {column: b}}}"
    assert (
        refusal(folder, uneven)
        == "inputs: expected the same actuators in every candidate, got commanded: m1; current: m2."
    )
    both = head + "ctrl: {m1: {column: a}}\ninputs: {current: {m1: {column: b}}}"
    assert (
        refusal(folder, both)
        == "inputs: expected either `ctrl` or, for several candidates, `inputs`, got both."
    )


REFUSED = {
    "qpos: {elbo: {column: q}}": (
        "qpos.elbo: expected the name of a joint of the model (the nearest is 'elbow'), got 'elbo'."
    ),
    "qpos: {elbow: {column: q}}\nctrl: {m3: {column: u}}": (
        "ctrl.m3: expected the name of an actuator of the model (the nearest is 'm1'), got 'm3'."
    ),
    "qpos: {elbow: {colum: q}}": (
        "qpos.elbow.colum: expected a known key (the nearest is 'column'), got 'colum'."
    ),
    "qpos: {elbow: {column: q, unit: degrees}}": (
        "qpos.elbow.unit: expected a unit (the nearest is 'deg'), got 'degrees'."
    ),
    "qpos: {elbow: {column: q, sign: 2}}": "qpos.elbow.sign: expected 1 or -1, got 2.",
    "qpos: {elbow: {column: q, offset: x}}": "qpos.elbow.offset: expected a number, got 'x'.",
    "qpos: {elbow: {}}": "qpos.elbow.column: expected the name of a column, got nothing.",
    "time: {column: t, unit: min}\nqpos: {elbow: {column: q}}": (
        "time.unit: expected a unit of time (there is ms, ns, s, us), got 'min'."
    ),
    "qpos: {elbow: {column: q}}\nqvel: {shoulder: {column: v}}": (
        "qvel: expected velocities of joints whose positions are mapped, got shoulder without one."
    ),
    "rate: 100": "qpos: expected at least one joint by name, got none.",
    "qpos: {elbow: {column: q}}\nrate: 0": (
        "rate: expected the control steps of a second [Hz], above 0, got 0."
    ),
    "qpos: {elbow: {column: q}}\nrun: {only: a}": (
        "run.only: expected names of runs, or patterns such as 'A0_*', got 'a'."
    ),
    "poss: {}": "poss: expected a known key (the nearest is 'qpos'), got 'poss'.",
}


@pytest.mark.parametrize("text", REFUSED)
def test_refusals(folder: Path, text: str) -> None:
    assert refusal(folder, text) == REFUSED[text]


def test_a_missing_column_gives_the_nearest(folder: Path) -> None:
    np.savez(folder / "log.npz", stamp=np.arange(3.0), q_elbow=np.arange(3.0))

    def reading(text: str) -> str:
        with pytest.raises(BadFile) as caught:
            read_runs([folder / "log.npz"], mapping(folder, text), lambda share, what: None)
        return str(caught.value).replace(f"{folder}/", "")

    assert reading("time: {column: stamp}\nqpos: {elbow: {column: q_elbo}}") == (
        "map.yaml: qpos.elbow.column: expected a column of log.npz (the nearest is "
        "'q_elbow'), got 'q_elbo'."
    )
    assert reading("time: {column: stam}\nqpos: {elbow: {column: q_elbow}}") == (
        "map.yaml: time.column: expected a column of log.npz (the nearest is 'stamp'), got 'stam'."
    )
    assert reading(
        "time: {column: stamp}\nqpos: {elbow: {column: q_elbow}}\nrun: {column: xyz}"
    ) == (
        "map.yaml: run.column: expected a column of log.npz (there is q_elbow, stamp), got 'xyz'."
    )


def test_a_model_that_is_none(folder: Path) -> None:
    (folder / "bad.xml").write_text("<mujoco><worldbdy/></mujoco>")
    with pytest.raises(BadFile, match=r"bad.xml: expected a model that compiles, got"):
        load_model_joints(folder / "bad.xml")
    with pytest.raises(BadFile, match=r"none.xml: expected an MJCF file, got no such file"):
        load_model_joints(folder / "none.xml")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "qpos: {neck: {column: head}}",
            "qpos.neck.columns: expected a list of 4 columns, or a slice such as 'pose[0:4]'",
        ),
        ("qpos: {rail: {column: s, unit: [m, m]}}", "qpos.rail.unit: expected "),
        (
            "qpos: {cube: {columns: 'p[0:7]', unit: [m, m, m, m, m, m, m]}}",
            "qpos.cube.unit: expected ",
        ),
    ],
)
def test_units_and_columns_that_do_not_fit_a_joint(folder: Path, text: str, told: str) -> None:
    (folder / "bodies.xml").write_text(BODIES)
    assert refusal(folder, text, "bodies.xml").startswith(told)


def test_columns_that_are_no_numbers(folder: Path) -> None:
    """Texts as numbers or as stamps, and runs to choose where a log is one run."""
    words = np.array(["a", "b", "c"])
    np.savez(folder / "log.npz", t=np.arange(3.0), q=np.arange(3.0), word=words)

    def reading(text: str) -> str:
        with pytest.raises(BadFile) as caught:
            read_runs([folder / "log.npz"], mapping(folder, text), lambda share, what: None)
        return str(caught.value).replace(f"{folder}/", "")

    assert reading("time: {column: t}\nqpos: {elbow: {column: word}}") == (
        "log.npz: column 'word': expected numbers, got texts."
    )
    assert reading("time: {column: word}\nqpos: {elbow: {column: q}}") == (
        "log.npz: column 'word': expected time stamps: numbers or dates, got texts."
    )
    assert reading("time: {column: t}\nqpos: {elbow: {column: q}}\nrun: {only: [A]}") == (
        "map.yaml: run.only: expected a log with several runs, got log.npz, which is one "
        "(`run: {column: ...}` tells them apart)."
    )
