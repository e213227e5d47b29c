"""Figure 6.3 in small: distributions found with the torso too light, policies under them, and the
paired tests.
"""

import json

import numpy as np
import pytest
from scipy import stats

from dropo.studies.engine.pages import picture
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021 import figure_6_3, light_torso
from dropo.studies.tiboni_2021.figure_6_3 import ReturnStudySize, difference
from dropo.studies.tiboni_2021.light_torso import (
    EXTENDED,
    PUBLISHED,
    TRUTH,
    UNIFORM,
    Training,
    extended_model,
    found,
    trained,
    whole,
)

TINY = Training(updates=1, episodes=4, steps=40)


@pytest.fixture(autouse=True)
def _without_external_data(monkeypatch):
    """The authors' data are left out: these tests need no files, and are the same everywhere."""
    monkeypatch.setattr(figure_6_3, "at_hand", lambda: False)


def test_two_distributions(tmp_path):
    """A policy of each distribution, kept as tasks that name it and the seed; tables, picture."""
    path = tmp_path / "kept.jsonl"
    size = ReturnStudySize(transitions=20, bounds=2, distributions=(TRUTH, UNIFORM), training=TINY)
    study = figure_6_3.figure_6_3(Work(threads=1, path=path), 1, size=size)
    entries = [json.loads(line)["entry"] for line in path.read_text().splitlines()]
    asked = [json.loads(entry[0]) for entry in entries if isinstance(entry, list)]
    policies = [item for task, item in asked if task.endswith("trained")]
    assert {(item["law"], item["number"], item["seed"]) for item in policies} == {
        (TRUTH, 0, 0),
        (UNIFORM, 0, 0),
        (UNIFORM, 1, 0),
    }
    assert [row[0] for row in study.tables[0].rows] == [
        TRUTH,
        UNIFORM,
        "  its best bounds",
        "  its worst bounds",
    ]
    assert "<svg" in picture(study.draw)


def test_the_same_seed_gives_the_same_policy():
    """A task's answer depends on its item alone; another seed gives another."""
    item = {"law": UNIFORM, "number": 0, "seed": 0, "training": vars(TINY)}
    item |= found({"law": UNIFORM, "number": 0, "data": "6.1", "transitions": 20, "droid": 16})
    assert trained(item) == trained(item)
    assert trained(item)["return"] != trained(item | {"seed": 1})["return"]


def test_the_extended_model_has_the_torso_back():
    """What is missing of the torso as an effect makes the target's motion; the control: without it
    the motion is another.
    """
    target = whole()
    right = extended_model([["body_mass", "body_mass:torso", [1.0]]])
    rows = [
        problem.simulator.predict(values[None], target.segments)
        for problem, values in _true_masses(target, right, extended_model([]))
    ]
    np.testing.assert_allclose(rows[1], rows[0], atol=1e-6)
    assert np.abs(rows[2] - rows[0]).max() > 1e-4


def _true_masses(*problems):
    return [(problem, light_torso.MEAN[-len(problem.space) :]) for problem in problems]


def test_a_fit_goes_to_training_as_it_is():
    """The point estimate of the three masses, found with the light torso, is the distribution that
    a policy is trained under.
    """
    item = {"law": "least squares", "number": 0, "data": "6.1", "transitions": 20, "droid": 16}
    one = found(item)
    assert one["family"] == "point"
    assert len(one["mean"]) == 3
    assert np.abs(np.array(one["mean"]) - light_torso.MEAN[1:]).max() > 0.1


def test_paired_differences():
    """As scipy has the paired t test, with bounds averaged; seeds that agree need no luck; one seed
    tests nothing.
    """
    rng = np.random.default_rng(0)
    one = 5 + rng.standard_normal((1, 6))
    other = rng.standard_normal((3, 6))
    gap = difference(one, other)
    test = stats.ttest_rel(one[0], other.mean(axis=0))
    assert gap.p == pytest.approx(test.pvalue)
    low, high = test.confidence_interval()
    assert (gap.mean - gap.half, gap.mean + gap.half) == pytest.approx((low, high))
    assert difference(one, one).p == 1
    assert np.isnan(difference(one[:, :1], other[:, :1]).p)


@pytest.mark.study
def test_the_diagnosis_finds_the_torso():
    """With the torso fixed 1 kg too light and the other masses fitted beside, its mass is named,
    and the extended fit has the truth.
    """
    one = found({"law": EXTENDED, "number": 0, "data": "6.1", "transitions": 1000, "droid": 16})
    assert [label for _, label, _ in one["effects"]] == ["body_mass:torso"]
    assert one["effects"][0][2][0] == pytest.approx(1, abs=1e-4)
    np.testing.assert_allclose(one["mean"], light_torso.MEAN[1:], atol=1e-4)


def around(mean, seed):
    """Returns of one policy for each of six seeds, near a mean."""
    return mean + np.random.default_rng(seed).standard_normal((1, 6))


def test_claims_are_confirmed_contradicted_or_not_decided():
    """Of three laws: one far above, one far below what is claimed, one about the same; claims of
    laws that were not trained are left out.
    """
    returns = {
        TRUTH: around(100, 0),
        PUBLISHED: around(100, 1),
        "droid": around(50, 2),
        EXTENDED: around(20, 3),
    }
    rows = figure_6_3._verdicts(returns, figure_6_3.ComparisonSettings()).rows
    assert {(row[0], row[1]): row[-1] for row in rows} == {
        ("thesis", f"{TRUTH} > {PUBLISHED}"): "not decided",
        ("thesis", f"{PUBLISHED} > droid"): "confirmed",
        ("ours", f"{EXTENDED} > {PUBLISHED}"): "contradicted",
        ("ours", f"{EXTENDED} > droid"): "contradicted",
    }
    (sentence,) = figure_6_3._best(returns)
    assert "return not as much as those of the best other law" in sentence
    assert PUBLISHED in sentence
    (sentence,) = figure_6_3._best(returns | {EXTENDED: around(120, 4)})
    assert "return more than those of" in sentence
    assert figure_6_3._best({TRUTH: around(1, 0), EXTENDED: around(2, 1)}) == []


def law(name, mean, sd=0.1, effects=(), **more):
    """What is kept of a distribution of three masses."""
    sds = [sd] * 3
    return {"law": name, "mean": list(mean), "sd": sds, "effects": effects, "steps": 0} | more


def test_what_is_said_of_the_laws():
    """The torso has back what an effect adds; fits that are one law are called so; the diagnosis is
    quoted.
    """
    masses = light_torso.MEAN[1:]
    extended = law(
        EXTENDED,
        masses,
        effects=[["body_mass", "body_mass:torso", [0.75]], ["wind", "wind.x", [3.0]]],
        verdict="explained",
        causes=["body mass at torso"],
    )
    laws = [
        extended,
        law("droid", masses + 0.5),
        law(PUBLISHED, masses),
        law("least squares", masses),
    ]
    rows = {row[0]: row for row in figure_6_3._distributions(laws).rows}
    torso = light_torso.MEAN[0] - figure_6_3.MISSING
    assert float(rows[EXTENDED][1]) == pytest.approx(torso + 0.75, abs=1e-3)
    assert float(rows["droid"][1]) == pytest.approx(torso, abs=1e-3)
    settings = figure_6_3.ComparisonSettings()
    (said,) = figure_6_3._same(laws, settings)
    assert f": {PUBLISHED}, least squares." in said
    assert figure_6_3._same(laws[:3], settings) == []
    (said,) = figure_6_3._diagnosed(laws)
    assert said.endswith("with the light torso: explained; body mass at torso.")


def test_laws_that_are_printed_are_taken_as_they_are():
    """The true masses, and those of the thesis, for the model with the light torso."""
    item = {"number": 0, "data": "6.1", "transitions": 20, "droid": 16}
    true = found(item | {"law": light_torso.AS_IT_IS})
    assert (true["family"], true["mean"], true["steps"]) == ("point", [*light_torso.MEAN[1:]], 0)
    printed = found(item | {"law": "thesis, dropo"})
    mean, scale = light_torso.THESIS["thesis, dropo"]
    assert printed["family"] == "truncated_gaussian"
    assert printed["mean"] == pytest.approx(mean, abs=0.05)
    assert (np.array(printed["sd"]) <= np.array(scale) * 1.001).all()
