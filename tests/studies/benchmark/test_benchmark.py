"""The benchmark: frozen sets, files with the truth apart, and the score of anyone's answers."""

import hashlib
import json
from copy import deepcopy
from functools import cache

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.core.services.errors import BadArgument, BadFile, UnknownName
from dropo.core.services.registry import names
from dropo.problems.loading import load
from dropo.studies.benchmark import sets, study
from dropo.studies.benchmark.answers import read_answers
from dropo.studies.benchmark.score import evaluate_answer
from dropo.studies.benchmark.sets import KINDS, VERSION, make_set, set_names, write_sets
from dropo.studies.engine.work import Work

COUNT = 3
made_once = cache(make_set)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The first sets of one arm as files, and their protocol."""
    folder = tmp_path_factory.mktemp("benchmark")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sets, "make_set", made_once)
        return folder, write_sets(Work(threads=1), folder, ["torque-arm"], COUNT)


@pytest.fixture
def perfect(written):
    """Answers that name every effect with its sizes."""
    folder, _ = written
    truths = json.loads((folder / "truth.json").read_text())["sets"]
    answers = {
        name: [{key: truth[key] for key in ("effect", "target", "sizes")}] * (number > 0)
        for number, (name, truth) in enumerate(truths.items())
    }
    return {"version": VERSION, "name": "perfect", "answers": answers}


def test_sets_are_frozen():
    """The first sets of an arm are what they were when the benchmark was made: anything else is
    another version of it.
    """
    first = made_once("torque-arm", 1)
    assert (first.truth["effect"], first.truth["target"]) == ("joint_friction", "shoulder")
    assert first.truth["sizes"]["frictionloss"] == pytest.approx(0.08353314909016156, rel=1e-9)
    nothing = make_set("torque-arm", 0)
    assert nothing.truth["effect"] is None
    again = made_once("torque-arm", 0).problem.trajectories
    assert np.array_equal(nothing.problem.trajectories.observations, again.observations)
    assert set(KINDS) <= set(names("effects"))


def test_data_are_of_another_integrator_and_finer_steps():
    """Where nothing is hidden, the model that is handed out misses the data by more than the noise,
    for that reason alone.
    """
    made = made_once("torque-arm", 0)
    simulator = made.problem.simulator
    assert simulator.model.opt.timestep == 0.005
    assert len(simulator.space) == 0
    predicted = simulator.predict(np.empty((1, 0)), made.problem.segments)[0]
    left = (made.problem.segments.targets - predicted).std(axis=0)
    assert (left[2:] > 3 * made.truth["noise"]).any()
    assert made.truth["integrator_nats"] > 100


def test_files_hold_no_truth_and_have_checksums(written):
    """Problem files load as they are; only truth.json says what is hidden."""
    folder, protocol = written
    sums = json.loads((folder / "checksums.json").read_text())
    assert len(sums) == 3 * COUNT + 1
    for name, expected in sums.items():
        content = (folder / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == expected
        assert b"joint_friction" not in content or name == "protocol.json"
    assert "truth" not in json.dumps(protocol)
    for own in protocol["sets"]:
        assert len(load(folder / "sets" / own / "problem.yaml").trajectories) == 1248


def test_right_answers_have_the_full_score(written, perfect, tmp_path, capsys):
    """By the command, as text and JSON; answers without causes, the control, name nothing."""
    folder, _ = written
    path = tmp_path / "answers.json"
    path.write_text(json.dumps(perfect))
    assert main(["benchmark", "score", str(folder), str(path)]) == 0
    assert "2/2" in capsys.readouterr().out
    silent = {**perfect, "answers": {name: [] for name in perfect["answers"]}}
    path.write_text(json.dumps(silent))
    assert main(["benchmark", "score", str(folder), str(path), "--json"]) == 0
    judged = json.loads(capsys.readouterr().out)["data"]["sets"]
    assert [one["named"] for one in judged.values()] == [False] * COUNT
    assert [one["silent"] for one in judged.values()] == [True] * COUNT


def test_an_answer_is_judged_by_effect_and_place():
    """Another place is another cause; what no data tell from the truth is right; sets without an
    answer are not named.
    """
    truth = {
        "effect": "joint_armature",
        "target": "shoulder",
        "sizes": {"armature": 0.02},
        "same": [["joint_armature", "shoulder"], ["body_inertia", None]],
    }
    right = {"effect": "joint_armature", "target": "shoulder", "sizes": {"armature": 0.03}}
    elsewhere = {"effect": "joint_armature", "target": "elbow"}
    found = evaluate_answer(truth, [right])
    assert (found.named, found.others, found.error) == (True, False, pytest.approx(0.5))
    assert evaluate_answer(truth, [{"effect": "body_inertia"}]).named
    assert not evaluate_answer(truth, [elsewhere]).named
    assert evaluate_answer(truth, [right, elsewhere]).others
    assert evaluate_answer(truth, [{**elsewhere, "or": [["joint_armature", "shoulder"]]}]).among
    assert not evaluate_answer(truth, None).answered


def change(perfect, path, value):
    """Answers with one entry exchanged."""
    out = deepcopy(perfect)
    place = out
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return out


ONE = ("answers", "torque-arm-001")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("version",), "2020-01", "version: expected '2026-11', got '2020-01'"),
        (("name",), "", "name: expected the method's name"),
        (("answer",), {}, "Did you mean 'answers'"),
        (("answers",), [], "answers: expected a mapping"),
        (("answers", "torque-arm-01"), [], "Did you mean 'torque-arm-001'"),
        (ONE, {}, r"answers.torque-arm-001: expected a list of causes"),
        (ONE, [{"target": "elbow"}], "torque-arm-001.0.effect: expected an entry, got none"),
        (ONE, [{"effect": "joint_fricton"}], "Did you mean 'joint_friction'"),
        (ONE, [{"effect": "joint_damping", "target": "elbo"}], "Did you mean 'elbow'"),
        (ONE, [{"effect": "gravity_tilt", "target": "elbow"}], "is of the whole machine"),
        (ONE, [{"effect": "gravity_tilt", "size": {}}], "Did you mean 'sizes'"),
        (ONE, [{"effect": "gravity_tilt", "sizes": {"x": "1"}}], "sizes: expected a mapping"),
        (ONE, [{"effect": "gravity_tilt", "or": ["wind"]}], r"or.0: expected \[effect, target\]"),
        (ONE, [{"effect": ["wind"]}], "an effect of this machine"),
    ],
)
def test_bad_answers_are_refused(written, perfect, tmp_path, path, value, message):
    file = tmp_path / "answers.json"
    file.write_text(json.dumps(change(perfect, path, value)))
    with pytest.raises(BadFile, match=message):
        read_answers(file, written[1])


def test_bad_requests_are_refused(tmp_path, capsys):
    """A machine that the benchmark has not, more sets than it has, a folder that is none."""
    with pytest.raises(UnknownName, match="Did you mean 'torque-arm'"):
        set_names(["torque-arms"], 1)
    with pytest.raises(
        UnknownName, match=r"No machine or data set called 'hopper-03'\. Did you mean"
    ):
        study.chosen_sets(["hopper-03"], 1)
    assert study.chosen_sets(["hopper-003", "walker2d"], 1) == [("hopper", 3), ("walker2d", 0)]
    with pytest.raises(BadArgument, match="from 1 to 40"):
        set_names(["hopper"], 41)
    assert main(["benchmark", "answer", str(tmp_path), "--out", str(tmp_path / "a.json")]) == 2
    assert "protocol.json" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_study_scores_what_is_answered(monkeypatch):
    """Its tables from answers that are made up: right where there is an effect, wrong elsewhere."""
    cause = {"effect": "joint_friction", "target": "shoulder", "sizes": {}, "or": []}
    answer = {"causes": [cause], "verdict": "explained", "steps": 1}
    monkeypatch.setattr(study, "answer_of", lambda problem: answer)
    monkeypatch.setattr(study, "make_set", made_once)
    found = study.benchmark(Work(threads=1), 2, problems=["torque-arm"])
    rows = {row[0]: row for row in found.tables[0].rows}
    assert rows["all"][3] == "1/1"
    assert found.tables[2].rows[-1][3] == "0/1"
    assert found.data["runs"][1]["name"] == "torque-arm-001"
