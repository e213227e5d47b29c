"""The study of the related methods in small, and its callbacks."""

import numpy as np
import pytest

from dropo.problems.hopper.model import FRAME_SKIP
from dropo.studies.engine.work import Work
from dropo.studies.related_methods import study as related_methods
from dropo.studies.related_methods.fits import (
    METHODS,
    TRUTH,
    RelatedStudySize,
    TargetRobot,
    fitted,
    item,
)
from dropo.studies.tiboni_2021.hopper_sets import MEAN, SPREAD, data_set

SETTINGS = {
    "simopt": {"iterations": 2, "updates": 2, "samples": 20, "draws": 20},
    "npe": {"simulations": 50, "rounds": 1, "draws": 100},
    "epopt": {"particles": 40, "rounds": 2},
    "bayrn": {"first": 2, "budget": 3, "draws": 20},
    "adr": {"budget": 4, "buffer": 1, "draws": 20},
    "uniform randomization": {"draws": 20},
}
SMALL = RelatedStudySize(
    transitions=20,
    seeds=1,
    published=(3, 12, 4),
    droid=16,
    settings=SETTINGS,
    updates=1,
    steps=10,
    episodes=2,
    probe=10,
)


def test_every_method_has_its_row(monkeypatch):
    """On one table: costs, errors and a return each; dropo's means are nearer than those of random
    bounds.
    """
    pytest.importorskip("sbi", reason="needs the extra sbi")
    pytest.importorskip("botorch", reason="needs the extra bo")
    monkeypatch.setattr(related_methods, "TABLES", {"6.1": "masses that do not vary"})
    study = related_methods.related_methods(Work(threads=1), size=SMALL)
    (table,) = study.tables
    assert [row[0].removesuffix(" (online)") for row in table.rows] == [*METHODS, TRUTH]
    assert table.header[-1] == "return"
    rows = study.data["6.1"]["summary"]
    assert rows["dropo"]["mean"] < 0.3 * rows["uniform randomization"]["mean"]
    used = {method: row["transitions"] for method, row in rows.items()}
    assert used == {
        **dict.fromkeys(METHODS, 20),
        "dropo, published": 5,
        "bayrn": 60,
        "adr": 0,
        "uniform randomization": 0,
    }
    assert all(row["steps"] > 0 for row in rows.values())
    assert set(study.data["6.1"]["returns"]) == {*METHODS, TRUTH}


def test_without_training_there_are_no_returns(monkeypatch):
    """And no bayrn, which is nothing else."""
    monkeypatch.setattr(related_methods, "TABLES", {"6.1": "masses that do not vary"})
    size = RelatedStudySize(transitions=20, methods=("least squares", "bayrn"), updates=0)
    study = related_methods.related_methods(Work(threads=1), 1, size=size)
    assert [row[0] for row in study.tables[0].rows] == ["least squares"]
    assert "return" not in study.tables[0].header


def target(table="6.2"):
    return TargetRobot(table, data_set(table, "noisy", 0, 20)[0], SMALL)


def test_the_target_varies_as_its_table():
    """Its distribution has the table's mean and spread, within 4.5 standard errors of 4000 draws;
    another table's has not.
    """
    draws = target().distribution.sample(4000, 0)
    error = np.maximum(SPREAD["6.2"], 1e-4) / np.sqrt(4000)
    assert (np.abs(draws.mean(axis=0) - MEAN) < 4.5 * error).all()
    assert draws.std(axis=0) == pytest.approx(SPREAD["6.2"], abs=4.5 * 0.5 / np.sqrt(8000))
    assert target("6.1").distribution.sample(100, 0).std(axis=0).max() < 1e-6


def test_collected_data_carry_the_target_s_noise():
    """Replayed with the true masses, residuals have the variance 1e-5 of the noise, within 4.5
    standard errors of 1,100 numbers; a torso 30 % too heavy leaves more.
    """
    problem = target("6.1").problem
    data = target("6.1").collect(100)(None, np.random.default_rng(0))
    segments = problem.cut(data)
    residuals = (
        problem.simulator.predict(np.stack([MEAN, MEAN * [1.3, 1, 1, 1]]), segments)
        - segments.targets
    )
    assert len(data) == 100
    assert np.var(residuals[0]) == pytest.approx(1e-5, rel=4.5 * np.sqrt(2 / 1100))
    assert np.var(residuals[1]) > 2e-5


def test_a_heavy_hopper_falls():
    """ADR's performance is 1 at the true masses and 0 at twice those; the steps made are told."""
    one = TargetRobot("6.1", target("6.1").problem, RelatedStudySize(probe=250))
    well, badly = (one.performance(values, np.random.default_rng(0)) for values in (MEAN, 2 * MEAN))
    assert (well.value, badly.value) == (1.0, 0.0)
    assert well.steps == 250 * FRAME_SKIP > badly.steps


def test_returns_are_those_of_trained_policies():
    """The steps of the search are told; the same seed gives the same return."""
    one, same = (
        target().evaluate(target().distribution, np.random.default_rng(1)) for _ in range(2)
    )
    assert one == same
    assert one.transitions == 20
    assert one.steps == 2 * 16 * 10 * FRAME_SKIP


def test_errors_over_data_sets():
    """Root mean squares over masses and data sets, medians of costs; the standard error of one
    policy is over its episodes.
    """
    rows = [
        {"mean": (MEAN + off).tolist(), "sd": [0.0] * 4, "steps": s, "transitions": 5}
        for off, s in ((3, 1), (4, 9))
    ]
    found = related_methods.summary(rows, "6.1")
    assert found == {
        "mean": pytest.approx(np.sqrt(12.5)),
        "sd": 0.0,
        "steps": 5.0,
        "transitions": 5.0,
    }
    assert related_methods.over_data_sets([[1.0, 3.0]]) == {
        "mean": 2.0,
        "error": pytest.approx(1.0),
    }
    assert related_methods.over_data_sets([[1.0, 3.0], [6.0, 6.0]]) == {
        "mean": 4.0,
        "error": pytest.approx(2.0),
    }


def test_a_task_depends_on_its_item_alone():
    asked = item("6.2", 0, SMALL, method="simopt")
    first, second = (fitted(asked) for _ in range(2))
    assert first == second
