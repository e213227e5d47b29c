"""Gymnasium's Hopper-v5 against the published data: what is different, and the study's tables."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import BODIES, hopper_model
from dropo.problems.hopper.v5 import differences, hopper_v5
from dropo.studies.engine.work import Work
from dropo.studies.hidden_effects.hopper_v5 import hopper_v5_study


def test_the_differences_are_those_of_the_two_models(monkeypatch):
    """Added to Gymnasium's numbers they give the hopper's; the problem's model has none of them."""
    data, _ = simulate(4, 1, rng=0)
    monkeypatch.setattr("dropo.problems.hopper.v5.published", lambda which: data)
    problem = hopper_v5(threads=1)
    stock = problem.simulator.model
    true = hopper_model()
    found = differences()
    assert len(found) == 2 * len(BODIES) + 1
    for body in BODIES:
        added = stock.body(body).mass[0] + found["body_mass", body]
        assert added == pytest.approx(true.body(body).mass[0])
        grown = stock.body(body).inertia.max() * (1 + found["body_inertia", body])
        assert grown == pytest.approx(true.body(body).inertia.max())
    margin = true.geom("foot_geom").margin[0] - stock.geom("foot_geom").margin[0]
    assert found["contact_stiffness", None] == pytest.approx(2 * margin)
    assert len(problem.space) == 0
    assert problem.task is not None
    assert np.array(problem.simulator.nominal).size == 0


def cause(effect, target, value):
    """A cause as diagnosis.json has it."""
    return {
        "effect": effect,
        "target": target,
        "estimate": {"size": {"value": value, "se": 0.01, "unit": "kg"}},
    }


def test_causes_stand_beside_what_is_different(monkeypatch):
    """One that is right, one that is not there, and all that were missed; errors before and after
    by horizon.
    """
    horizons = [{"steps": 1, "rmse": 0.4}, {"steps": 5, "rmse": 0.9}]
    after = [{"steps": 1, "rmse": 0.1}, {"steps": 5, "rmse": 0.3}]
    answer = {
        "verdict": "partly",
        "simulator_steps": 12_345,
        "causes": [cause("body_mass", "torso", -0.13), cause("joint_damping", "foot_joint", 0.2)],
        "baseline": {"horizons": horizons},
        "extended": {"horizons": after},
    }
    monkeypatch.setattr(Work, "map", lambda self, task, items: [answer])
    study = hopper_v5_study(Work(threads=1))
    causes, errors = study.tables
    true = differences()
    rows = {row[:2]: row[2:] for row in causes.rows}
    assert rows["body_mass", "torso"][1:] == ("-0.13", "0.01", "kg")
    shown = float(rows["body_mass", "torso"][0])
    assert shown == pytest.approx(true["body_mass", "torso"], rel=1e-5)
    assert rows["joint_damping", "foot_joint"][0] == "-"
    missed = [row for row in causes.rows if row[3] == "-"]
    assert len(missed) == len(true) - 1
    assert ("contact_stiffness", "all") in {row[:2] for row in missed}
    assert errors.rows == (("1", "0.4", "0.1", "4"), ("5", "0.9", "0.3", "3"))
    assert study.remarks == ("Verdict: partly.", "12,345 simulator steps.")
    with pytest.raises(BadArgument, match="1, as there is one data set"):
        hopper_v5_study(Work(), 2)
