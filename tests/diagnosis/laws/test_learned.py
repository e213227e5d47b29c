"""Forces that are learned from what nothing explains: what they gain, where they act, when not."""

import json

import numpy as np
import pytest

from dropo import Diagnose
from dropo.cli.main import main
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.diagnosis.laws.learned import learn_forces
from dropo.diagnosis.settings import DiagnosisSettings
from dropo.diagnosis.setup import DiagnosisTask
from dropo.effects.law import law_instance
from dropo.effects.support.formula_values import evaluate
from dropo.problems.file.plain_model import write_extended
from dropo.problems.file.verification import verify
from dropo.problems.loading import load
from dropo.problems.simulated.robots import simulated_robot
from dropo.report.pages.diagnosis_page import _learned
from tests.models.hidden_in_arm import problem

FORMULA = "-c * sin(3 * q) * tanh(v / w)"
"""A friction that comes and goes along the way: no term of laws is like it."""
SIZES = {"c": 0.5, "w": 1.0}


def hidden(*effects):
    """An arm that has these, and no declared parameters."""
    return problem(list(effects), episodes=24, steps=60)


@pytest.fixture(scope="module")
def strange():
    """An arm that follows a law which no formula of the search can be."""
    context = simulated_robot("torque-arm").simulator.effect_context
    law = law_instance(context, "elbow", FORMULA, typical=SIZES)
    return hidden((law, np.array([SIZES[one.name] for one in law.quantities])))


@pytest.fixture(scope="module")
def found(strange):
    """Its diagnosis, by laws alone."""
    return Diagnose(["law"], windows=60).run(strange)


def test_a_force_that_no_formula_is_is_learned(found):
    """At the joint where it acts, of its position and speed, by more than half; it is no cause."""
    learned = found.learned
    (force,) = learned.forces
    assert force.joint == "elbow"
    assert set(force.variables) == {"q", "v"}
    assert learned.used
    assert learned.share > 0.5
    assert learned.gain > 5 * learned.gain_se > 0
    assert not found.causes
    assert found.verdict == "unexplained"
    assert "Learned, not named: a force at elbow" in found.headline()


def test_its_size_is_that_of_the_law(found):
    """Its largest size in the data is about the law's, whose largest is c."""
    (force,) = found.learned.forces
    assert 0.7 * SIZES["c"] < force.largest < 2 * SIZES["c"]


def test_the_errors_printed_are_those_with_it(found):
    """They are smaller than without, after every horizon."""
    pairs = zip(found.baseline.horizons, found.extended.horizons, strict=True)
    assert all(after.rmse < 0.75 * before.rmse for before, after in pairs)
    assert "with what was found" in str(found)


def test_it_is_bounded_and_fades_outside_the_data(found):
    """Ten times as far out as the data go, it is nothing; nowhere is it more than all weights."""
    ((law, sizes),) = found.problem.simulator.fixed
    weights = [
        size for one, size in zip(law.quantities, sizes, strict=True) if one.name.startswith("c")
    ]
    names = [signal.name for signal in found.problem.simulator.signals]
    observed = found.problem.trajectories.observations.T
    q = observed[names.index("qpos.elbow")]
    v = observed[names.index("qvel.elbow")]
    program = law.force.args[-1]

    def force(scale):
        """The force where position and speed are so many times those of the data."""
        values = {("q", ""): scale * q, ("v", ""): scale * v}
        return evaluate(program, values, sizes, {})

    inside = np.abs(force(1.0))
    assert inside.max() <= np.abs(weights).sum()
    outside = np.abs(force(10.0)[np.abs(v) > np.median(np.abs(v))])
    assert outside.max() < 1e-5 * inside.max()


def test_files(found, tmp_path):
    """diagnosis.json says what it is, the page too; plain MuJoCo has the announced errors."""
    found.save(tmp_path)
    write_extended(found.problem, found.parameters, tmp_path / "extended")
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert content["learned"] == found.learned.to_json()
    assert "elbow" in _learned(content).body
    ((law, _),) = load(tmp_path / "extended" / "problem.yaml", threads=1).simulator.fixed
    assert law.formula == found.learned.forces[0].formula
    assert verify(tmp_path).holds


def test_nothing_is_learned_where_nothing_is_missing():
    """A control: of an arm without anything hidden, even if asked for."""
    found = Diagnose(["law"], windows=60, learned=True).run(hidden())
    assert found.verdict == "consistent"
    assert found.learned is None


def test_noise_is_not_learned():
    """Of noise alone no force is learned, even where nobody asked whether anything remains."""
    diagnose = Diagnose(["law"], windows=60)
    learned = []
    for seed in range(5):
        clean = problem([], episodes=24, steps=60, seed=seed)
        setup = search_of(diagnose, clean)
        first = setup.first()
        limits = DiagnosisSettings().horizons
        rng = np.random.default_rng(seed)
        learned.append(learn_forces(clean, setup.selection, first, first, rng, limits, asked=True))
    assert learned == [None] * 5


def search_of(diagnose, data):
    """What a search works on."""
    task = DiagnosisTask(data, data, np.random.default_rng(0), EvaluationLog())
    return diagnose._set_up(task, None, lambda share, text: None)


def test_regression_alone_learns_nothing(capsys):
    """The options do not go together."""
    assert main(["diagnose", "hopper", "--quick", "--learned"]) != 0
    assert "--learned belongs to the search by simulation" in capsys.readouterr().err
