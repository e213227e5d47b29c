"""Where a model lacks much a diagnosis begins with regression; simulation has the last word."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.far_off.model import FarOffModel
from dropo.diagnosis.far_off.start import FarOffLimits, FarOffStart, RegressionStart, start_of
from dropo.diagnosis.regression.quick import QuickSettings, sides
from dropo.diagnosis.setup import DiagnosisTask
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.problems.file.plain_model import write_extended
from dropo.problems.file.verification import verify
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.machines import problem_of
from dropo.studies.first_models.strangers import stranger
from tests.models.first_models import recorded_machine, unknown_rotor

WITHIN = 3.5
"""Standard errors that a number may be off by: of twelve, one in 200 logs is off by more."""
DESIGN = "arm, 3 joints"
SOME = ("joint_armature", "joint_damping", "joint_friction", "actuator_gain", "body_mass")
NONE = np.zeros(0, dtype=np.int64)


def started(problem, free=NONE):
    """What a search of the problem begins with."""
    return start_of(problem, free, FarOffLimits(), QuickSettings()).far_off


@pytest.fixture(scope="module")
def recording():
    """A machine of random numbers, its first model, and its log."""
    return recorded_machine(DESIGN, np.random.default_rng(31), seconds=5.0)


@pytest.fixture(scope="module")
def diagnosis(recording):
    """The diagnosis of its first model."""
    _, spec, data = recording
    problem = with_velocities(problem_of(DESIGN, spec, data))
    return Diagnose(windows=12, disturbances=False).run(problem)


def test_every_number_is_found_by_simulation(recording, diagnosis):
    """Each within its errors, which are small; nothing else is named."""
    truth = recording[0].numbers()
    found = {
        (cause.effect, cause.target, quantity): estimate
        for cause in diagnosis.causes
        for quantity, estimate in cause.estimate.items()
    }
    named = {key for key in found if key[0] != "payload" or key[2] == "mass"}
    assert named == set(truth)
    for key, value in truth.items():
        assert abs(found[key].value - value) < WITHIN * found[key].se, (key, found[key])
        assert found[key].se < 0.3 * abs(value), key


def test_the_model_as_it_came_is_far_off(diagnosis):
    """Errors on held-out data fall fifty-fold; what diverges is null, and JSON is strict."""
    content = json.loads(json.dumps(diagnosis.to_json(), allow_nan=False))
    after = {one["steps"]: one["rmse"] for one in content["extended"]["horizons"]}
    before = {one["steps"]: one["rmse"] for one in content["baseline"]["horizons"]}
    assert set(before) == set(after)
    assert after[20] < 0.02
    assert before[20] is None or before[20] > 50 * after[20]
    assert diagnosis.gain > 1


def test_what_physics_steps_do_is_no_cause(diagnosis):
    """All numbers are causes: what a model of steps four times longer leaves is said to be the
    steps'. The delay is the machine's; in the model's own steps it is 0.75 ms longer, half of what
    a command waits there.
    """
    assert diagnosis.verdict == "explained"
    assert diagnosis.stated == diagnosis.causes
    assert any('timestep="0.0005"' in text for text in diagnosis.numerics)
    (late,) = [cause for cause in diagnosis.causes if cause.effect == "actuator_delay"]
    assert abs(late.estimate["delay"].value - 0.006) < 3.5e-4


def test_the_extended_model_has_the_errors_announced(diagnosis, tmp_path):
    """In plain MuJoCo, in the steps that were found. Control: not in those it came with."""
    diagnosis.save(tmp_path)
    path = write_extended(diagnosis.problem, diagnosis.parameters, tmp_path / "extended")
    assert verify(tmp_path).holds
    model = path.with_name("model.xml")
    model.write_text(model.read_text().replace('timestep="0.0005"', 'timestep="0.002"'))
    assert not verify(tmp_path).holds


def test_declared_parameters_take_what_they_stand_for(recording):
    """Declared dampings begin where regression has them; no effect stands for them again."""
    machine, spec, data = recording
    parameters = [
        FieldParameter(f"d{i}", 0.0, 5.0, field="dof_damping", element=f"joint{i}")
        for i in range(3)
    ]
    frame_skip = problem_of(DESIGN, spec, data).simulator.frame_skip
    simulator = MujocoSimulator(
        spec, parameters, observation=["qpos"], frame_skip=frame_skip, threads=1
    )
    problem = replace(problem_of(DESIGN, spec, data), simulator=simulator)
    start = started(problem, np.arange(3)).model
    truth = [machine.numbers()["joint_damping", f"joint{i}", "damping"] for i in range(3)]
    np.testing.assert_allclose(start.declared, truth, rtol=0.2)
    effects = {instance.effect for instance, _ in start.numbers}
    assert "joint_damping" not in effects
    assert "joint_friction" in effects


def test_few_missing_numbers_are_left_to_the_search():
    """One hidden effect is no reason to begin with regression."""
    assert started(unknown_rotor()) is None


def test_a_single_joint_is_left_to_its_motions():
    """Rotor, damping and friction are fewer than four: whether that is all is asked of motions.

    Where the model has them, there is nothing to begin with.
    """
    lacking, truth = stranger(101)
    start = started(lacking)
    assert not start.sure
    assert len(truth) < FarOffLimits().numbers
    assert {(one.effect, one.target) for one, _ in start.model.numbers} >= {
        key[:2] for key in truth
    }
    assert started(stranger(101, missing=False)[0]) is None


def test_a_regression_that_motions_contradict_is_corrected(monkeypatch):
    """An absurd number to begin with: it is not named, and what is missing is found."""
    problem = unknown_rotor()
    effect = instances_of(problem.simulator.effect_context, "joint_damping", "shoulder")[0]
    size = np.array([0.9 * effect.quantities[0].high])
    fitted, checked = sides(problem, 0.2)
    divided = replace(problem, trajectories=fitted, held_out=checked)
    nominal = np.array(problem.simulator.nominal)
    absurd = FarOffModel(divided, nominal, NONE, [(effect, size)])
    monkeypatch.setattr(
        "dropo.diagnosis.diagnose.start_of",
        lambda *arguments: RegressionStart(
            (), FarOffStart(absurd, absurd.problem, sure=True, few=False)
        ),
    )
    found = Diagnose(length=5, windows=24, disturbances=False).run(problem)
    assert [(one.effect, one.target) for one in found.causes] == [("joint_armature", "elbow")]


@dataclass(frozen=True)
class Found:
    """What `Diagnose` asks of a diagnosis."""

    by: str
    verdict: str
    simulator_steps: int
    interrupted: bool = False


@pytest.mark.parametrize(
    ("motions", "causes", "few", "stands"),
    [
        ("partly", "explained", True, "causes"),
        ("partly", "explained", False, "motions"),
        ("explained", "explained", True, "motions"),
        ("partly", "partly", True, "motions"),
    ],
)
def test_a_few_causes_may_explain_what_motions_leave(monkeypatch, motions, causes, few, stands):
    """Of few numbers, and if they explain all; whatever stands, all simulator steps are counted."""
    asked = []

    def by_search(diagnose, task, explained, progress):
        asked.append(explained)
        spent = task.spent + 10
        by = "causes" if explained is None else "motions"
        return Found(by, causes if explained is None else motions, spent)

    start = RegressionStart((), FarOffStart(None, None, sure=True, few=few))
    monkeypatch.setattr("dropo.diagnosis.diagnose.start_of", lambda *arguments: start)
    monkeypatch.setattr(Diagnose, "_explained", lambda *arguments: ("a model", 5))
    monkeypatch.setattr(Diagnose, "_by_search", by_search)
    robot = unknown_rotor()
    task = DiagnosisTask(robot, robot, None, None)
    found = Diagnose()._run(task, lambda *arguments: None)
    assert found.by == stands
    assert found.simulator_steps == (25 if len(asked) == 2 else 15)
    assert len(asked) == (2 if few and motions == "partly" else 1)
