"""The study of noisy and unlogged states: its bound, and what it says of fits that miss it."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, UnknownName
from dropo.studies.engine.work import Work
from dropo.studies.unlogged_states.machines import MACHINES, simulate_log
from dropo.studies.unlogged_states.study import (
    CASES,
    DEFAULT,
    _remarks,
    replication,
    summary,
    unlogged_states,
)


def answer(error, width):
    """A fit whose errors and standard errors are so many optimal ones."""
    return {
        "error": [error, error],
        "width": [width, width],
        "inside": [abs(error) < 1.96 * width] * 2,
        "spread": [0.0, 0.02],
        "trusted": True,
        "likelihood": "trajectory",
        "steps": 1000,
    }


def test_what_is_outside_is_said():
    """Intervals that are too wide or too often wrong are remarked; control: good ones are not."""
    errors = np.random.default_rng(0).standard_normal(400)
    good = summary([answer(error, 1.0) for error in errors], DEFAULT)
    assert _remarks("good", good, DEFAULT) == []
    assert good["coverage_of_all"] == pytest.approx(0.95, abs=0.03)
    assert good["spread"] == 1.0
    narrow = summary([answer(error, 0.3) for error in errors], DEFAULT)
    assert "is not within" in _remarks("narrow", narrow, DEFAULT)[0]
    wide = summary([answer(error, 1.6) for error in errors], DEFAULT)
    assert any("more than 1.5 times" in text for text in _remarks("wide", wide, DEFAULT))


def test_logs_are_what_they_are_called():
    """Noise of the stated size, or steps of an encoder; seeds give the same log twice."""
    for machine, noise in (CASES[1], CASES[-1]):
        log = simulate_log(machine, noise, 3)
        again = simulate_log(machine, noise, 3)
        np.testing.assert_array_equal(
            log.problem.trajectories.observations, again.problem.trajectories.observations
        )
        assert bool(log.problem.estimated) == noise.startswith("positions")
        assert (log.optimum < 0.02 * log.truth).all()
        if noise == "positions, 12 bit":
            counts = log.problem.trajectories.observations[:, 0] / (2 * np.pi / 4096)
            np.testing.assert_allclose(counts, counts.round(), atol=1e-6)
    with pytest.raises(UnknownName, match="arm"):
        simulate_log("arn", "all noisy", 0)


def test_more_noise_is_worse():
    """The bound of positions alone is above that of positions and velocities."""
    alone = simulate_log("arm", "positions, white", 5).optimum
    both = simulate_log("arm", "all noisy", 5).optimum
    assert set(MACHINES) == {"arm", "spring-mass"}
    assert (alone > both).all()


def test_the_table_has_a_row_for_each_log_seeds_and_method(monkeypatch):
    """Answers come in the order in which they were asked; what is said of each is in its own row,
    and only fits as they come are remarked.
    """
    asked = []

    def given(self, task, items):
        asked.extend(items)
        method = {"as it comes": 1.0, "from measured states": 3.0}
        return [answer((-1) ** seed * method[name], 1.0) for _, _, name, seed in items]

    monkeypatch.setattr(Work, "map", given)
    cases = (("arm", "all noisy"), ("spring-mass", "all noisy"))
    study = unlogged_states(Work(threads=1), 4, cases=cases)
    first = DEFAULT.first_evaluation
    assert [item[3] for item in asked[:12]] == [
        *range(4),
        *range(first, first + 4),
        *range(first, first + 4),
    ]
    assert {tuple(item[:2]) for item in asked} == set(cases)
    (table,) = study.tables
    assert len(table.rows) == 6
    row = dict(zip(table.header, table.rows[1], strict=True))
    assert row["log"] == "arm, all noisy"
    assert (row["seeds"], row["fit"], row["logs"]) == ("evaluation", "as it comes", "4")
    assert row["bias"] == "+0.00 ± 0.58, +0.00 ± 0.58"
    assert (row["error"], row["coverage"], row["of all"]) == ("1, 1", "100%, 100%", "100.0%")
    control = dict(zip(table.header, table.rows[2], strict=True))
    assert control["fit"] == "from measured states"
    assert (control["error"], control["coverage"]) == ("3, 3", "0%, 0%")
    assert [text for text in study.remarks if "is not within 90% to 98%" in text] == [
        f"{machine}, {noise}, {seeds}: 100.0% is not within 90% to 98%."
        for machine, noise in cases
        for seeds in ("development", "evaluation")
    ]
    with pytest.raises(BadArgument, match="'seeds' of unlogged_states must be at least 2"):
        unlogged_states(Work(), 1)


def test_fits_that_take_measurements_for_states_are_remarked():
    """The share of them that found starts along runs is said; control: none is said of all."""
    own = [answer(0.5, 1.0) for _ in range(4)]
    own[0]["likelihood"] = "emulated"
    said = _remarks("name", summary(own, DEFAULT), DEFAULT)
    assert "name: 75% of the fits found starts along runs." in said
    said = _remarks("name", summary(own[1:], DEFAULT), DEFAULT)
    assert not any("starts along" in text for text in said)


def test_a_replication_is_in_optimal_standard_errors(monkeypatch):
    """Of a fit that is two of them off, with standard errors of one and a half."""
    asked = []

    class Off:
        def __init__(self, *, likelihood):
            asked.append(likelihood)

        def fit(self, problem, rng):
            log = simulate_log("arm", "all noisy", rng)
            ends = log.truth[:, None] + np.array([[-1.0, 1.0], [1.0, 3.0]]) * log.optimum[:, None]
            mean = log.truth + [2.0, -2.0] * log.optimum
            return SimpleNamespace(
                mean=mean,
                mean_se=1.5 * log.optimum,
                sd=0.02 * mean,
                interval=lambda: ends,
                trusted=None,
                likelihood="trajectory",
                simulator_steps=42,
            )

    monkeypatch.setattr("dropo.studies.unlogged_states.study.DROPO", Off)
    found = replication(["arm", "all noisy", "from measured states", 3])
    assert asked == ["emulated"]
    assert found["error"] == pytest.approx([2.0, -2.0])
    assert found["width"] == pytest.approx([1.5, 1.5])
    assert found["inside"] == [True, False]
    assert found["spread"] == pytest.approx([0.02, 0.02])
    assert (found["trusted"], found["steps"]) == (False, 42)
