"""Callbacks: what they bring, what they cost, and that the target is not asked twice."""

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.core.contracts.estimator import Run
from dropo.core.contracts.interactive_estimator import Answer, Callbacks, distribution, joined
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.estimators.adr import ADR
from dropo.estimators.simopt import SimOpt
from dropo.problems.simulated.slide import slide


def calls(evaluation_log=None):
    return Callbacks(Run(slide(), np.random.default_rng(0), evaluation_log or EvaluationLog()))


def pushes(rng, rows=3):
    values = rng.standard_normal((rows, 5))
    return Trajectories(values[:, :2], values[:, 2:3], values[:, 3:], np.arange(rows) == rows - 1)


def test_costs_are_counted():
    """Steps of the problem's own simulator, those that the answer tells of, and the target's
    transitions; a bare number costs nothing.
    """
    made = calls()
    simulator = made.run.problem.simulator
    segments = made.run.problem.segments

    def call(rng):
        simulator.predict([[1.5, 0.8]], segments)
        return Answer(2.5, transitions=7, steps=11)

    assert made.number(np.zeros(2), call) == 2.5
    assert made.number(np.zeros(2), lambda rng: 1.0) == 1.0
    assert (made.run.steps, made.transitions, made.run.evaluations) == (
        int(segments.lengths.sum()) + 11,
        7,
        2,
    )


def test_each_call_has_randomness_of_its_own():
    """The same in the same run, other numbers from call to call."""
    one = calls()
    same = calls()
    first = [one.number(np.zeros(1), lambda rng: rng.random()) for _ in range(3)]
    assert first == [same.number(np.zeros(1), lambda rng: rng.random()) for _ in range(3)]
    assert len(set(first)) == 3


def test_data_come_back_whole():
    """Rows and ends as collected, with their number counted as the target's."""
    made = calls()
    found = made.data(np.zeros(2), lambda rng: Answer(pushes(rng), transitions=2))
    kept = pushes(np.random.default_rng(0).spawn(1)[0])
    for name in ("observations", "actions", "next_observations", "terminals"):
        np.testing.assert_array_equal(getattr(found, name), getattr(kept, name))
    assert made.transitions == 5
    both = joined([found, found])
    assert both.spans == [(0, 3), (3, 6)]


def test_the_target_is_asked_once(tmp_path):
    """A run that is taken up has its answers and its counts from the evaluation log; the control: a
    callback that is asked raises.
    """

    def not_again(rng):
        raise AssertionError("asked again")

    first = calls(EvaluationLog(tmp_path / "calls.jsonl"))
    number = first.number(np.zeros(2), lambda rng: Answer(0.1, steps=5))
    data = first.data(np.ones(2), pushes)
    resumed = calls(EvaluationLog(tmp_path / "calls.jsonl"))
    assert resumed.number(np.zeros(2), not_again) == number
    np.testing.assert_array_equal(
        resumed.data(np.ones(2), not_again).observations, data.observations
    )
    assert (
        (resumed.run.steps, resumed.transitions) == (first.run.steps, first.transitions) == (5, 3)
    )
    with pytest.raises(AssertionError, match="asked again"):
        resumed.number(np.zeros(2), not_again)


def test_a_law_as_a_callback_gets_it():
    """It draws, has the problem's own noise, and no likelihood."""
    problem = slide()
    fit = distribution(problem, "simopt", "uniform", np.array([1.5, 0.8, 0.5, 0.1]))
    draws = fit.sample(1000, 0)
    assert (np.abs(draws - [1.5, 0.8]) <= [0.5, 0.1]).all()
    assert np.isnan(fit.log_likelihood)
    assert (fit.epsilon == (0 if problem.epsilon is None else problem.epsilon)).all()


def test_answers_that_cannot_be_used():
    with pytest.raises(BadArgument, match="The 'answer' of the callback must be a finite number"):
        calls().number(np.zeros(1), lambda rng: float("nan"))
    wrong = Trajectories(np.zeros((1, 3)), np.zeros((1, 1)), np.zeros((1, 3)), np.array([True]))
    with pytest.raises(BadArgument, match="'observations' of the callback must be of shape"):
        calls().data(np.zeros(1), lambda rng: wrong)


def test_without_a_callback():
    """The refusal shows the Python line, also on the command line, which writes nothing."""
    with pytest.raises(Incompatible) as refusal:
        SimOpt()
    assert str(refusal.value) == (
        "Method 'simopt' calls back to collect(fit, rng) -> Trajectories, which a command "
        "line cannot give."
        " In Python: dropo.SimOpt(collect=collect).fit(dropo.load('hopper'), rng=0), with "
        "collect a function of yours."
    )
    with pytest.raises(BadArgument, match="'performance' of ADR must be a function performance"):
        ADR(performance=3.0)


@pytest.mark.parametrize("method", ["simopt", "bayrn", "adr"])
def test_on_the_command_line(method, capsys, tmp_path):
    assert main(["fit", "slide", "--method", method, "--out", str(tmp_path / "out")]) == 2
    assert f"Method {method!r} calls back to " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
