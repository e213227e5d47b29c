"""A diagnosis that is cut off goes on from its records to the same bits; one that is interrupted
ends with what it found so far.
"""

import json

import pytest

from dropo import Diagnose, Diagnosis
from dropo.core.services.errors import InvalidInput
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.files.journal import Journal, read_lines
from dropo.diagnosis.far_off.output_error import OutputError
from dropo.diagnosis.far_off.search import FarOffSearch
from dropo.diagnosis.search.confirmation import SelectionSettings
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.screening import ScreeningSettings
from dropo.diagnosis.settings import DiagnosisSettings
from tests.models.far_off import SETTINGS as FAR_OFF
from tests.models.far_off import torque_arm
from tests.models.hidden_in_arm import UPPER, problem

COARSE = ScreeningSettings(finalists=4, coarse_stride=2, coarse_windows=4)
SEARCH = Diagnose(
    ("joint_damping", "joint_friction", "actuator_gain"),
    length=5,
    windows=10,
    disturbances=False,
    settings=DiagnosisSettings(selection=SelectionSettings(screening=COARSE)),
)


@pytest.fixture(scope="module")
def arm():
    """An arm with damping and friction that its model lacks."""
    hidden = [("joint_damping:elbow", [0.05]), ("joint_friction:shoulder", [0.05])]
    return problem(hidden, parameters=(UPPER,), episodes=16, steps=30)


@pytest.fixture(scope="module")
def undisturbed(arm, tmp_path_factory):
    """What is found, how much was predicted for it, and the lines of the records."""
    path = tmp_path_factory.mktemp("undisturbed") / "search.jsonl"
    with pytest.MonkeyPatch.context() as patch:
        counted = count_predictions(patch)
        found = content(SEARCH.run(arm, evaluation_log=EvaluationLog(path, {})))
    return found, sum(counted), path.read_bytes().splitlines(keepends=True)


def content(found: Diagnosis):
    """Everything that a diagnosis says but how long it took."""
    return json.dumps({**found.to_json(), "wall_time_s": None})


def count_predictions(patch):
    """How many parameter vectors are simulated, call by call."""
    counted: list[int] = []
    predict = Library.predict

    def counting(library, values, *given):
        counted.append(len(values))
        return predict(library, values, *given)

    patch.setattr(Library, "predict", counting)
    return counted


def interrupting(text, after=0):
    """A progress that interrupts where it is told a text, after it was told it before."""
    told = 0

    def progress(_, now):
        nonlocal told
        told += text in now
        if text in now and told == after + 1:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("part", [0.4, 1.0])
def test_it_goes_on_to_the_same_bits(arm, undisturbed, tmp_path, monkeypatch, part):
    """With any part of the records, the last of them torn: the same, its cost too; with all of
    them for a quarter fewer simulations, although most of these are of figures after the search.
    """
    whole, predictions, lines = undisturbed
    kept = round(part * len(lines))
    path = tmp_path / "search.jsonl"
    torn = b"".join(lines[kept : kept + 1])[:-9]
    path.write_bytes(b"".join(lines[:kept]) + torn)
    counted = count_predictions(monkeypatch)
    assert content(SEARCH.run(arm, evaluation_log=EvaluationLog(path, {}))) == whole
    assert len(read_lines(path, "")) == len(lines)
    if part == 1.0:
        assert sum(counted) < predictions * 3 / 4
    assert sum(map(len, lines)) < 100_000


def test_records_of_another_search_are_refused(arm, undisturbed, tmp_path):
    """One number that the first fit begins with is another, by more than rounding."""
    path = tmp_path / "search.jsonl"
    path.write_bytes(b"".join(undisturbed[2]))
    entries = read_lines(path, "")[1:]
    entries[0]["points"][0][0] += 1e-6
    journal = Journal(tmp_path / "other.jsonl", {}, "")
    for entry in entries:
        journal.append(entry)
    with pytest.raises(InvalidInput, match="another version"):
        SEARCH.run(arm, evaluation_log=EvaluationLog(tmp_path / "other.jsonl", {}))


@pytest.mark.parametrize(
    ("text", "after", "causes"),
    [("screening", 1, 1), ("what remains", 0, 2)],
)
def test_an_interruption_leaves_the_best_so_far(arm, tmp_path, undisturbed, text, after, causes):
    """The causes accepted until then, said to be so far; what was recorded is what the whole search
    records, from any part of which it goes on (above).
    """
    path = tmp_path / "search.jsonl"
    log = EvaluationLog(path, {})
    found = SEARCH.run(arm, evaluation_log=log, progress=interrupting(text, after))
    whole = json.loads(undisturbed[0])
    assert found.interrupted
    assert (found.to_json()["status"], whole["status"]) == ("interrupted", "done")
    assert "Interrupted: these are the causes so far" in found.headline()
    assert "Interrupted" not in whole["headline"]
    assert [one.effect for one in found.causes] == [one["effect"] for one in whole["causes"]][
        :causes
    ]
    if causes == 1:
        lines = path.read_bytes().splitlines(keepends=True)
        assert 1 < len(lines) < len(undisturbed[2])
        assert lines == undisturbed[2][: len(lines)]


def test_before_the_first_fit_there_is_nothing(arm):
    """The interruption is passed on."""
    with pytest.raises(KeyboardInterrupt):
        SEARCH.run(arm, progress=interrupting("fitting the model"))


def test_a_model_that_is_far_off(tmp_path):
    """Whole motions are fitted on from any Jacobian to the same bits and cost."""
    path = tmp_path / "search.jsonl"
    whole = FarOffSearch(FAR_OFF, lambda *_: None, EvaluationLog(path, {})).run(
        torque_arm("actuator_gain")
    )
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[: len(lines) // 2]))
    again = FarOffSearch(FAR_OFF, lambda *_: None, EvaluationLog(path, {})).run(
        torque_arm("actuator_gain")
    )
    assert again.model.theta.tobytes() == whole.model.theta.tobytes()
    assert again.errors.tobytes() == whole.errors.tobytes()
    assert again.simulator_steps == whole.simulator_steps
    assert not whole.interrupted


def test_far_off_and_interrupted(monkeypatch):
    """With what was fitted to rough motions, by one Jacobian at least; nothing before that."""
    model = torque_arm("actuator_gain")
    found = FarOffSearch(FAR_OFF, interrupting("joint_armature")).run(model)
    assert found.interrupted
    assert [one.label for one, _ in found.model.numbers] == ["actuator_gain", "payload:fore"]
    with pytest.raises(KeyboardInterrupt):
        FarOffSearch(FAR_OFF, interrupting("to windows")).run(model)
    made: list[list[float]] = []
    step = OutputError._step_on

    def second(error, theta, free):
        if made:
            raise KeyboardInterrupt
        after = step(error, theta, free)
        made.append(after[:-1].tolist())
        return after

    monkeypatch.setattr(OutputError, "_step_on", second)
    found = FarOffSearch(FAR_OFF, lambda *_: None).run(model)
    assert found.interrupted
    assert found.model.theta.tolist() == made[0] != model.theta.tolist()
