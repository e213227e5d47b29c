"""The study of hidden laws: when formulas are the same, its noise, and what its tables count."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.diagnosis.parts import Alternative
from dropo.problems.simulated.robots import simulated_robot
from dropo.studies.engine.work import Work
from dropo.studies.laws.study import (
    DEVELOPMENT,
    EVALUATION,
    FIRST_SEED,
    MACHINE,
    NOISE,
    NULLS,
    _noise,
    _with_noise,
    equivalent,
    laws,
    run,
)


def test_formulas_are_the_same_but_for_their_constants():
    """Sizes, names and order do not count; powers, places and shapes do."""
    pytest.importorskip("sympy")
    same = [
        ("-c * abs(v) * v", "-0.09 * v * abs(v)"),
        ("-c * v**3", "-c1 * v * v**2"),
        ("-c * max(q - a, 0)", "-c1 * max(q - x2, 0)"),
        ("-c * v.shoulder * v", "-w * v * v.shoulder"),
        ("-c * q**2 * v + a * q", "c1 * q - c2 * v * q**2"),
        ("-c * abs(motor) * dahl(x)", "-c * dahl(w) * abs(motor)"),
    ]
    for one, two in same:
        assert equivalent(one, two), (one, two)
    different = [
        ("-c * abs(v) * v", "-c * v**3"),
        ("-c * abs(v) * v", "-c * abs(v)"),
        ("-c * v.shoulder * v", "-c * v**2"),
        ("-c * max(q - a, 0)", "-c * max(a - q, 0)"),
        ("-c * v**3", "-c * v**3 - a * v"),
        ("c * sin(5 * q)", "c * sin(4 * q)"),
    ]
    for one, two in different:
        assert not equivalent(one, two), (one, two)


def test_every_law_of_the_study_is_itself_and_no_other():
    pytest.importorskip("sympy")
    texts = [text for _, text, _ in (*DEVELOPMENT.values(), *EVALUATION.values())]
    for i, one in enumerate(texts):
        assert [equivalent(one, two) for two in texts] == [i == j for j in range(len(texts))]


def test_each_kind_of_noise_is_what_it_is_called():
    """40,000 draws: standard deviation to 5 standard errors (t3: its quartiles, as its fourth
    moment is infinite), correlation of neighbours 0.5 for AR(1) and 0 for the others.
    """
    n = 40_000
    for kind in ("gaussian", "t3", "ar1"):
        drawn = _noise(kind, (n, 1), np.random.default_rng(1))[:, 0]
        lagged = np.corrcoef(drawn[1:], drawn[:-1])[0, 1]
        assert lagged == pytest.approx(0.5 if kind == "ar1" else 0.0, abs=5 / np.sqrt(n))
        if kind == "t3":
            quartile = 0.764892 / np.sqrt(3) * NOISE
            assert np.mean(np.abs(drawn) < quartile) == pytest.approx(0.5, abs=2.5 / np.sqrt(n))
        else:
            effective = n * (0.6 if kind == "ar1" else 1.0)
            assert drawn.std() == pytest.approx(NOISE, rel=5 / np.sqrt(2 * effective))


def test_noise_is_that_of_measurements():
    """A state that ends one transition and begins the next has one noise; steps of an encoder are
    four standard deviations, of all signals.
    """
    robot = simulated_robot(MACHINE)
    data = robot.record([], noise=1e-12, rng=np.random.default_rng(0))
    noisy = _with_noise(data, "gaussian", np.random.default_rng(0))
    assert np.std(noisy.observations - data.observations) == pytest.approx(NOISE, rel=0.1)
    for first, last in data.spans:
        np.testing.assert_array_equal(
            noisy.next_observations[first : last - 1], noisy.observations[first + 1 : last]
        )
    stepped = _with_noise(data, "quantised", np.random.default_rng(0))
    counts = stepped.next_observations / (4 * NOISE)
    np.testing.assert_allclose(counts, counts.round(), atol=1e-9)
    assert np.abs(stepped.observations - data.observations).max() <= 2.001 * NOISE


def recorded(kind, name, seed=1000, **answer):
    """What a run answers: right, and worth many nats, unless said otherwise."""
    own = {
        "set": kind,
        "name": name,
        "seed": seed,
        "verdict": "explained",
        "causes": [["law", "elbow", "-c * v**3"]],
        "acts_like": [None],
        "steps": 123_456,
    }
    if kind != "null":
        own |= {"hidden": "-c * v**3", "target": "elbow", "nats": 500.0, "share": 0.98}
        own |= {"right": True, "among": True}
    return own | answer


def test_tables_count_runs_that_are_worth_it(monkeypatch):
    """One law is right, one among the others, one wrong, and one too small to count; of two
    recordings with nothing hidden, one has a law proposed.
    """
    asked = []
    answers = [
        recorded("evaluation", "cubic spring"),
        recorded("evaluation", "tether", right=False, share=0.9),
        recorded("evaluation", "detent", right=False, among=False, share=0.2, causes=[]),
        recorded("evaluation", "torque ripple", right=False, nats=99.0, share=0.1),
        recorded("null", "t3", 2000, causes=[["law", "elbow", "-c * q"]], verdict="partly"),
        recorded("null", "ar1", 2000, causes=[["joint_damping", "elbow", ""]]),
    ]

    def given(self, task, items):
        asked.extend(items)
        return answers

    monkeypatch.setattr(Work, "map", given)
    study = laws(Work(threads=1), 2, names=("tether", "cubic drag"), nulls=("ar1",))
    assert asked == [
        *(["evaluation", "tether", FIRST_SEED["evaluation"] + i] for i in range(2)),
        *(["development", "cubic drag", FIRST_SEED["development"] + i] for i in range(2)),
        *(["null", "ar1", FIRST_SEED["null"] + i] for i in range(2)),
    ]
    totals, found, silent = study.tables
    assert totals.rows == (
        ("evaluation", "3", "1", "2", "0.9"),
        ("nothing hidden", "2", "1 laws proposed", "-", "-"),
    )
    assert [row[3] for row in found.rows] == ["yes", "among the others", "no", "among the others"]
    assert found.rows[0][1:3] == ("-c * v**3 at elbow", "-c * v**3 at elbow")
    assert found.rows[2][2] == "-"
    assert found.rows[0][-1] == "123,456"
    assert silent.rows == (
        ("t3", "2000", "-c * q at elbow", "partly"),
        ("ar1", "2000", "joint_damping at elbow", "explained"),
    )
    assert "4 recordings" in study.title
    assert "2 with nothing hidden" in study.title


def test_what_it_cannot_study_is_refused():
    with pytest.raises(BadArgument, match="'seeds' of laws must be at least 1"):
        laws(Work(), 0)
    with pytest.raises(UnknownName, match="cubic spring"):
        laws(Work(), names=("cubic sprin",))
    with pytest.raises(UnknownName, match="quantised"):
        laws(Work(), names=(), nulls=("quantized",))


def test_development_and_evaluation_share_no_seed_and_no_law():
    """Up to a thousand runs of each law; every kind of noise can be drawn."""
    assert not set(DEVELOPMENT) & set(EVALUATION)
    firsts = sorted(FIRST_SEED.values())
    assert min(np.diff(firsts)) >= 1000
    for kind in NULLS:
        assert _noise(kind, (3, 2), np.random.default_rng(0)).shape == (3, 2)


def told(formula, *others):
    """A diagnosis that names a law at the elbow, and others that it is confused with, by windows of
    five steps; its baseline is the model's own on the data.
    """

    class Told(Diagnose):
        def run(self, problem, rng):
            before = Diagnose(length=5, windows=12).baseline(problem)
            cause = SimpleNamespace(
                confused_with=tuple(Alternative("law", "elbow", "", "", None, o) for o in others),
                to_json=lambda rank: {
                    "effect": "law",
                    "target": "elbow",
                    "formula": formula,
                    "acts_like": None,
                },
            )
            return SimpleNamespace(
                causes=[cause],
                verdict="partly",
                window_steps=5,
                simulator_steps=7,
                baseline=SimpleNamespace(log_likelihood=before),
                extended=SimpleNamespace(log_likelihood=before + 0.5),
            )

    return Told


def test_a_run_hides_its_law_and_knows_what_it_is_worth(monkeypatch):
    """Whatever is said, the true law gains many nats on the recorded data; its formula counts as
    right where it is said, as among the others where it is what the cause is confused with.
    """
    pytest.importorskip("sympy")
    monkeypatch.setattr("dropo.studies.laws.study.WINDOWS", 12)
    item = ["development", "quadratic drag", 0]
    said = []
    for formula, *others in (
        ("-c1 * v * abs(v)",),
        ("-c1 * v", "-c1 * v**3", "-c2 * abs(v) * v"),
        ("-c1 * v**3", "-c1 * v"),
    ):
        monkeypatch.setattr("dropo.studies.laws.study.Diagnose", told(formula, *others))
        said.append(run(item))
    assert [(one["right"], one["among"]) for one in said] == [
        (True, True),
        (False, True),
        (False, False),
    ]
    first = said[0]
    assert (first["hidden"], first["target"]) == ("-c * abs(v) * v", "elbow")
    assert first["causes"] == [["law", "elbow", "-c1 * v * abs(v)"]]
    assert first["nats"] > 100
    assert first["share"] == pytest.approx(0.5 * 12 * 5 / first["nats"])
    assert {one["nats"] for one in said} == {first["nats"]}


def test_no_law_is_proposed_where_nothing_is_hidden(monkeypatch):
    """A whole run in small: one rival, a quarter of the windows."""
    pytest.importorskip("sympy")
    monkeypatch.setattr("dropo.studies.laws.study.WINDOWS", 12)
    monkeypatch.setattr("dropo.studies.laws.study.RIVALS", ("joint_damping",))
    answer = run(["null", "gaussian", 2000])
    assert answer["causes"] == answer["acts_like"] == []
    assert not {"hidden", "nats", "share"} & set(answer)
