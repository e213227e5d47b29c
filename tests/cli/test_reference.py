"""`dropo diagnose` with reference runs, from a problem file that marks them."""

import json

import mujoco
import numpy as np
import pytest

from dropo.cli.main import main
from dropo.problems.loading import load

XML = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.8"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""
TEXT = """
model: arm.xml
frame_skip: 2
data: data.npz
lambda: 5
reference: ["well *"]
"""
DAMPING = {"well 0": 0.2, "well 1": 0.202, "well 2": 0.199, "well 3": 0.201, "dry": 0.3}
"""Run -> damping [N m s/rad] of the machine, twice the model's in normal runs."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Five runs of one joint, whose lubrication fails in the last."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(XML)
    (folder / "problem.yaml").write_text(TEXT)
    rng = np.random.default_rng(4)
    model = mujoco.MjModel.from_xml_string(XML)
    rows, actions, group = [], [], []
    for number, damping in enumerate(DAMPING.values()):
        model.dof_damping[0] = damping
        data = mujoco.MjData(model)
        for step in range(150):
            if step % 10 == 0:
                data.ctrl[0] = rng.normal(0, 1.5)
            rows.append([*data.qpos, *data.qvel])
            actions.append(data.ctrl.copy())
            group.append(number)
            mujoco.mj_step(model, data, 2)
    noisy = np.array(rows) + 1e-4 * rng.standard_normal((len(rows), 2))
    np.savez(
        folder / "data.npz",
        observations=noisy,
        actions=actions,
        terminals=np.arange(len(rows)) % 150 == 149,
        group=group,
        run_names=list(DAMPING),
    )
    return folder / "problem.yaml"


def test_the_run_that_differs_is_named(file, tmp_path, capsys):
    """The damping of the last run, on top of what the normal runs have; all runs in runs.json."""
    out = tmp_path / "compared"
    effects = ["--effects", "joint_damping", "actuator_gain"]
    assert main(["diagnose", str(file), *effects, "--out", str(out), "--threads", "1"]) == 0
    assert "1 of 1 runs differ from the 4 reference runs." in capsys.readouterr().out
    runs = json.loads((out / "runs.json").read_text())["runs"]
    assert [run["run"] for run in runs] == list(DAMPING)
    (cause,) = runs[-1]["causes"]
    found = cause["estimate"]["damping"]
    assert (cause["effect"], cause["target"], found["unit"]) == (
        "joint_damping",
        "hinge",
        "N m s/rad",
    )
    assert abs(found["value"] - 0.1) < 4.5 * found["se"] < 0.05
    assert not any(run["causes"] for run in runs[:-1])
    assert main(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert page.count("<td>reference</td>") == 4
    assert "joint damping at hinge" in page
    broken = json.loads((out / "runs.json").read_text())
    broken["runs"][0].pop("p_value")
    (out / "runs.json").write_text(json.dumps(broken))
    assert main(["report", str(out)]) == 2


def test_names_follow_their_runs(file):
    """Runs held out come last, and their names with them; without `reference` none are read."""
    text = TEXT + "held_out: {runs: ['well 1']}\n"
    other = file.with_name("held_out.yaml")
    other.write_text(text)
    problem = load(other)
    assert problem.run_names == ("well 0", "well 2", "well 3", "dry", "well 1")
    assert problem.reference == ("well *",)
    other.write_text(text.replace('reference: ["well *"]\n', ""))
    assert load(other).run_names == ()


def test_the_first_transitions_alone(file, capsys):
    """Four runs are left, all of them normal, with their own names."""
    arguments = ["--transitions", "596", "--effects", "joint_damping", "--json", "--quiet"]
    assert main(["diagnose", str(file), *arguments, "--threads", "1"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["run"] for run in runs] == [name for name in DAMPING if name != "dry"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--reference", "wel 0"], "Did you mean 'well 0'?"),
        (["--reference", "well 0", "dry"], "at least 4 runs"),
        (["--effects", "external_forc"], "Did you mean 'external_force'?"),
        (["--reference", "well *", "--quick"], "--reference belongs to the search"),
    ],
)
def test_refusals_write_nothing(file, tmp_path, capsys, arguments, told):
    """Status 2 and a sentence."""
    out = tmp_path / "none"
    assert main(["diagnose", str(file), *arguments, "--out", str(out)]) == 2
    assert told in capsys.readouterr().err
    assert not out.exists() or not list(out.iterdir())


def test_a_pattern_that_no_run_fits_is_refused(file, capsys):
    """By file and key, with the nearest name."""
    other = file.with_name("wrong.yaml")
    other.write_text(TEXT.replace("well *", "dri"))
    assert main(["diagnose", str(other)]) == 2
    told = capsys.readouterr().err
    assert "wrong.yaml: reference: expected the name of a run (the nearest is 'dry')" in told
