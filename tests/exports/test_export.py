"""Exports from folders and from Python: what is refused, what is never overwritten."""

import errno
import json
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import dropo
from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile, Incompatible, UnknownName
from dropo.core.services.registry import is_name, names, register
from dropo.exports.effect import effect
from dropo.exports.export import export
from dropo.exports.support.subject import Written
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.exports.conftest import MASS, PARAMETERS, arm_problem, known_fit
from tests.models.linear_mass import Mass


def test_what_has_no_law_is_no_effect(arm, tmp_path):
    """The target `effect` refuses a fit without a law, and writes nothing."""
    problem, fit = arm
    with pytest.raises(Incompatible, match="has no law"):
        fit.export("effect", tmp_path / "plugin", problem=problem)
    assert list(tmp_path.iterdir()) == []


def test_laws_have_names_of_their_own():
    """Places that differ in what no name of an effect can have are told apart."""
    size = Quantity("c", "N", -1.0, 1.0, (0.1,))
    places = ("Arm.Elbow-1", "arm elbow 1", "wrist")
    laws = [EffectInstance("law", place, (size,), formula="c * v") for place in places]
    subject = SimpleNamespace(name="arm", around=[(law, np.array([0.5])) for law in laws])
    files = effect(subject).files
    assert sorted(files) == ["law_arm_elbow_1.py", "law_arm_elbow_1_too.py", "law_wrist.py"]
    for file, text in files.items():
        name = file.removesuffix(".py")
        assert is_name("effects", name)
        assert f'register("effects", {name!r}, {name})' in text


@pytest.mark.parametrize("target", [one for one in names("exports") if one != "effect"])
def test_one_line_from_a_fit(arm, target, tmp_path, monkeypatch):
    """`fit.export(target)` writes into a folder of that name, and again into its own folder."""
    monkeypatch.chdir(tmp_path)
    problem, fit = arm
    found = fit.export(target, problem=problem)
    assert all(path.is_file() for path in found.files)
    assert {path.parent.name for path in found.files} == {target}
    record = json.loads((tmp_path / target / "export.json").read_text())
    assert record["files"] == [path.name for path in found.files]
    assert record["left_out"] == found.to_json()["left_out"]
    before = {path: path.read_bytes() for path in found.files}
    assert fit.export(target, problem=problem) == found
    assert {path: path.read_bytes() for path in found.files} == before
    assert str(found).splitlines()[: len(found.files)] == [str(path) for path in found.files]


def test_a_fit_knows_its_problem(tmp_path):
    """Of `dropo.load`, in memory; one made in Python asks for it."""
    problem = dropo.load("hopper", threads=1).using(transitions=20)
    fit = dropo.fit(problem, "uniform-randomization")
    assert fit.source == "hopper"
    found = fit.export("mjx", tmp_path)
    text = found.files[0].read_text()
    assert "('body', 'torso', (0,)" in text
    assert "KIND = 'uniform'" in text
    nameless = replace(fit, source="")
    with pytest.raises(Incompatible, match=r"does not say what it was fitted to.*--problem"):
        nameless.export("mjx", tmp_path / "other")
    assert not (tmp_path / "other").exists()
    nameless.export("mjx", tmp_path / "third", problem="hopper")


def test_the_main_file_by_its_name(arm, tmp_path):
    """A path with an ending names the main file; the others lie beside it."""
    problem, fit = arm
    found = export(fit, "isaac-lab", tmp_path / "robots" / "arm.yaml", problem=problem)
    assert [path.name for path in found.files] == ["arm.yaml", "model.xml"]
    assert sorted(path.name for path in (tmp_path / "robots").iterdir()) == [
        "arm.yaml",
        "export.json",
        "model.xml",
    ]


def test_files_of_others_stay(arm, tmp_path):
    """A file that no export to this target wrote is in the way; nothing is written."""
    problem, fit = arm
    (tmp_path / "model.xml").write_text("mine")
    with pytest.raises(BadFile, match=r"a new folder, or one of an earlier export to mjlab"):
        export(fit, "mjlab", tmp_path, problem=problem)
    assert [path.name for path in tmp_path.iterdir()] == ["model.xml"]
    export(fit, "mjlab", tmp_path / "own", problem=problem)
    with pytest.raises(BadFile, match=r"expected a new folder.*mjx.*got one with model\.xml"):
        export(fit, "mjx", tmp_path / "own", problem=problem)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BadFile, match="expected a folder, got a file"):
        export(fit, "mjx", tmp_path / "file", problem=problem)


def test_an_export_cut_off_is_made_again(arm, tmp_path, monkeypatch):
    """After a full disk the same export ends as one that nothing disturbed."""
    problem, fit = arm
    export(fit, "mujoco", tmp_path / "whole", problem=problem)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("dropo.exports.export.write_bytes", full)
        with pytest.raises(OSError, match="No space left"):
            export(fit, "mujoco", tmp_path / "cut", problem=problem)
    export(fit, "mujoco", tmp_path / "cut", problem=problem)
    for path in (tmp_path / "whole").iterdir():
        assert (tmp_path / "cut" / path.name).read_bytes() == path.read_bytes()


def test_refusals(arm, tmp_path):
    """A wrong target or folder, another problem, a model that is no MuJoCo model; no file left."""
    problem, fit = arm
    with pytest.raises(UnknownName, match="Did you mean 'isaac-lab'"):
        export(fit, "isaaclab", tmp_path, problem=problem)
    with pytest.raises(BadFile, match="no such folder"):
        export(tmp_path / "none", "mjx")
    with pytest.raises(BadFile, match=r"one without fit\.json and diagnosis\.json"):
        export(tmp_path, "mjx")
    with pytest.raises(Incompatible, match=r"and problem 'arm' has mass\. Name the problem"):
        export(fit, "mjx", tmp_path, problem=arm_problem((MASS,)))
    moved = (replace(PARAMETERS[0], element="lower"), *PARAMETERS[1:])
    with pytest.raises(Incompatible, match="'mass' is at another place of a model"):
        export(fit, "mjx", tmp_path, problem=arm_problem(moved))
    with pytest.raises(Incompatible, match="Mass of problem 'arm' has no MuJoCo model to export"):
        export(fit, "mjx", tmp_path, problem=_of(Mass()))
    assert list(tmp_path.iterdir()) == []


def _of(simulator):
    """A problem of another simulator, of which nothing else matters."""
    problem = arm_problem()
    bare = object.__new__(dropo.Problem)
    vars(bare).update({**vars(problem), "simulator": simulator})
    return bare


def test_a_target_of_ones_own(arm, tmp_path):
    """A registered function gives the files and the sentences."""

    def table(subject):
        """A table of means."""
        text = "\n".join(f"{name} {subject.mean(name):g}" for name in subject.distribution.names)
        return Written({"means.txt": text}, ("Spreads are left out.",))

    register("exports", "table", table)
    found = arm[1].export("table", tmp_path, problem=arm[0])
    assert found.left_out == ("Spreads are left out.",)
    assert found.files[0].read_text().startswith("mass 1.3\ndamping 0.4")
    assert [path.name for path in found.files] == ["means.txt"]


def test_names_that_the_model_does_not_give(tmp_path):
    """An unnamed joint: MJX finds it by its place, the others leave it out by name."""
    slide = FieldParameter("rod", 0.01, 1.0, field="dof_damping", element="cart")
    text = """<mujoco><worldbody><body name="cart"><joint type="slide" axis="1 0 0"/>
      <geom size="0.1"/></body></worldbody></mujoco>"""
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(text), [slide], action=[], threads=1)
    rows = np.zeros((4, 2))
    data = Trajectories(rows, np.zeros((4, 0)), rows, np.arange(4) % 2 == 1)
    problem = Problem("cart", simulator, data)
    fit = known_fit(problem, np.array([0.3]), np.array([0.05]), np.array([0.01]))
    fit.export("mjx", tmp_path / "mjx", problem=problem)
    code = (tmp_path / "mjx" / "domain_randomize.py").read_text()
    assert "(None, None, (0,), 0.3, [1.0])" in code
    for target in ("mjlab", "isaac-lab"):
        found = fit.export(target, tmp_path / target, problem=problem)
        said = "The spread of rod is left out: dof_damping is of what has no name."
        assert found.left_out == (said,)
