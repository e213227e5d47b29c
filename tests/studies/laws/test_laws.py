"""The study of hidden laws: when formulas are the same, its noise, and what its tables count."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.diagnosis.parts import Alternative
from dropo.studies.engine.work import Work
from dropo.studies.laws.cases import DEVELOPMENT, EVALUATION, NULLS, REMOVED
from dropo.studies.laws.machines import MACHINES, law_machine
from dropo.studies.laws.study import (
    FIRST_SEED,
    RIVALS,
    STEP,
    _noise,
    _with_noise,
    equivalent,
    every_item,
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
    """Those of one joint, that is: another's may have the same formula."""
    pytest.importorskip("sympy")
    every = [*DEVELOPMENT.values(), *EVALUATION.values(), *REMOVED.values()]
    for one in every:
        same = [two for two in every if (two.machine, two.place) == (one.machine, one.place)]
        known = {two.formula for two in same if equivalent(one.formula, two.formula)}
        assert known == {one.formula}


def test_every_law_acts_on_its_machine():
    """Each has a size for each number of what is hidden, and is of the formula's place."""
    simulators = {name: law_machine(name).robot.simulator for name in MACHINES}
    for law in (*DEVELOPMENT.values(), *EVALUATION.values(), *REMOVED.values()):
        made, sizes = law.instance(simulators[law.machine])
        assert set(law.sizes) == {quantity.name for quantity in made.quantities}
        assert (made.effect == law.effect) if law.effect else (made.target == law.place)
        assert np.abs(sizes).max() > 0
    assert {law.effect for law in REMOVED.values()} - {"air_drag"} <= set(RIVALS)
    assert {law.machine for law in EVALUATION.values()} == set(MACHINES)


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
            quartile = 0.764892 / np.sqrt(3)
            assert np.mean(np.abs(drawn) < quartile) == pytest.approx(0.5, abs=2.5 / np.sqrt(n))
        else:
            effective = n * (0.6 if kind == "ar1" else 1.0)
            assert drawn.std() == pytest.approx(1.0, rel=5 / np.sqrt(2 * effective))


def test_noise_is_that_of_measurements():
    """A state that ends one transition and begins the next has one noise; steps of an encoder are
    four standard deviations, of all signals.
    """
    machine = law_machine("trolley")
    data = _with_noise(machine, "quantised", np.random.default_rng(0))
    counts = data.next_observations / (STEP * machine.noise)
    np.testing.assert_allclose(counts, counts.round(), atol=1e-7)
    noisy = _with_noise(machine, "gaussian", np.random.default_rng(0))
    off = (noisy.observations - data.observations) / machine.noise
    np.testing.assert_allclose(off.std(axis=0), np.sqrt(1 + STEP**2 / 12), rtol=0.1)
    for first, last in data.spans:
        np.testing.assert_array_equal(
            noisy.next_observations[first : last - 1], noisy.observations[first + 1 : last]
        )


def test_positions_alone_are_logged_where_it_is_said():
    """Then velocities are estimated; every machine's numbers are those of its recording."""
    for name in MACHINES:
        machine = law_machine(name)
        data = machine.record([], np.random.default_rng(1), 1.0)
        problem = machine.problem(name, data)
        assert bool(problem.estimated) == machine.positions
        assert problem.trajectories.observations.shape == data.observations.shape
        same = np.array_equal(problem.trajectories.observations, data.observations)
        assert same != machine.positions


def recorded(kind, name, seed=1000, **answer):
    """What a run answers: right and stated, and worth many nats, unless said otherwise."""
    own = {
        "set": kind,
        "name": name,
        "seed": seed,
        "machine": "pendulum",
        "verdict": "explained",
        "causes": [["law", "elbow", "-c * v**3"]],
        "stated": 1,
        "steps": 123_456,
        "steps_without": 61_728,
    }
    if kind != "null":
        own |= {"hidden": "-c * v**3", "target": "elbow", "nats": 500.0, "share": 0.98}
        own |= {"right": True, "among": True, "false": 0}
    return own | answer


def test_tables_count_runs_that_are_worth_it(monkeypatch):
    """One law is right, one among the others, one wrong, and one too small to count; of two
    recordings with nothing hidden, one has a law proposed. What is stated counts everywhere.
    """
    asked = []
    answers = [
        recorded("evaluation", "cubic spring"),
        recorded("evaluation", "tether", right=False, share=0.9, false=1),
        recorded("evaluation", "detent", right=False, among=False, share=0.2, causes=[], stated=0),
        recorded("evaluation", "torque ripple", right=False, nats=99.0, share=0.1, false=1),
        recorded("null", "t3 pendulum", causes=[["law", "elbow", "-c * q"]], stated=0),
        recorded("null", "ar1 pendulum", causes=[["joint_damping", "elbow", ""]]),
    ]

    def given(self, task, items):
        asked.extend(items)
        return answers

    monkeypatch.setattr(Work, "map", given)
    study = laws(Work(threads=1), 2, problems=("tether", "cubic drag", "ar1 pendulum"))
    assert asked == [
        *(["evaluation", "tether", FIRST_SEED["evaluation"] + i] for i in range(2)),
        *(["development", "cubic drag", FIRST_SEED["development"] + i] for i in range(2)),
        *(["null", "ar1 pendulum", FIRST_SEED["null"] + i] for i in range(2)),
    ]
    totals, found, silent = study.tables
    assert totals.rows == (
        ("evaluation", "4", "3", "1", "2", "0.9", "2", "3", "2"),
        ("nothing hidden", "2", "-", "1 laws proposed", "-", "-", "-", "1", "1"),
    )
    assert [row[4] for row in found.rows] == ["yes", "among the others", "no", "among the others"]
    assert found.rows[0][2:4] == ("-c * v**3 at elbow", "-c * v**3 at elbow")
    assert found.rows[2][3] == "-"
    assert found.rows[0][-2:] == ("123,456", "2")
    assert silent.rows == (
        ("t3 pendulum", "1000", "-c * q at elbow", "explained"),
        ("ar1 pendulum", "1000", "joint_damping at elbow", "explained"),
    )
    assert "4 recordings" in study.title
    assert "2 with nothing hidden" in study.title


def test_what_it_cannot_study_is_refused():
    with pytest.raises(BadArgument, match="'seeds' of laws must be at least 1"):
        laws(Work(), 0)
    with pytest.raises(UnknownName, match="cubic spring"):
        laws(Work(), problems=("cubic sprin",))
    with pytest.raises(UnknownName, match="quantised trolley"):
        laws(Work(), problems=("quantized trolley",))


def test_development_and_evaluation_share_no_seed_and_no_law():
    """Up to a thousand runs of each law; every kind of noise can be drawn."""
    assert not set(DEVELOPMENT) & {*EVALUATION, *REMOVED}
    firsts = sorted(FIRST_SEED.values())
    assert min(np.diff(firsts)) >= 1000
    assert set(every_item()) >= {f"{noise} {machine}" for noise in NULLS for machine in MACHINES}
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
                effect="law",
                target="elbow",
                formula=formula,
            )
            return SimpleNamespace(
                causes=[cause],
                stated=[],
                verdict="partly",
                window_steps=5,
                simulator_steps=7,
                baseline=SimpleNamespace(log_likelihood=before),
                extended=SimpleNamespace(log_likelihood=before + 0.5),
            )

    return Told


def test_a_run_hides_its_law_and_knows_what_it_is_worth(monkeypatch):
    """Whatever is said, the true law gains many nats on the recorded data; its formula counts as
    right where it is said, as among the others where it is what the cause is confused with. What
    is said gains half a nat a transition of what the machine itself gains.
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
    assert [(one["right"], one["among"], one["false"]) for one in said] == [
        (True, True, 0),
        (False, True, 1),
        (False, False, 1),
    ]
    first = said[0]
    assert (first["hidden"], first["target"]) == ("-c * abs(v) * v", "elbow")
    assert first["causes"] == [["law", "elbow", "-c1 * v * abs(v)"]]
    assert first["nats"] > 100
    assert 0 < first["share"] <= 0.5 * 12 * 5 / first["nats"]
    assert {one["nats"] for one in said} == {first["nats"]}


def test_no_law_is_proposed_where_nothing_is_hidden(monkeypatch):
    """A whole run in small: one rival, a quarter of the windows."""
    pytest.importorskip("sympy")
    monkeypatch.setattr("dropo.studies.laws.study.WINDOWS", 12)
    monkeypatch.setattr("dropo.studies.laws.study.RIVALS", ("joint_damping",))
    answer = run(["null", "gaussian torque-arm", 2000])
    assert answer["causes"] == []
    assert answer["stated"] == 0
    assert not {"hidden", "nats", "share"} & set(answer)
