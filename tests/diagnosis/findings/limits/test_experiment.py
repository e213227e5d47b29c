"""The experiment that would tell two effects apart, on the arm with two joints."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dropo.diagnosis.findings.causes import _proposal
from dropo.diagnosis.findings.limits.experiment import (
    SETTINGS,
    _candidates,
    commands_of,
    experiment,
    experiments,
    signal_limits,
)
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split
from dropo.evaluation.open_loop import open_loop
from dropo.mjmodel.joints import joints
from tests.models.hidden_in_arm import instance, problem

SIGMA = 3e-3
PAIR = ("actuator_lag:shoulder_motor", "actuator_delay:shoulder_motor")


@pytest.fixture(scope="module")
def lagging():
    """An arm with a lag of 2 ms at the shoulder, found, beside the delay that does nearly the same
    in these data.
    """
    data = problem([(PAIR[0], [0.002])], sigma=SIGMA)
    instances = [instance(data.simulator, label) for label in PAIR]
    library = Library(data.simulator.with_effects(instances), instances, 0)
    train, test = split(data, 5, 48)
    search = Selection(library, np.full(4, 1e-9))
    first = search.begin(train, test, np.zeros(2), white(np.full(4, SIGMA)), np.arange(0))
    return library, search.run(first, first, instances[:1])


@pytest.fixture(scope="module")
def proposed(lagging):
    """What is to be recorded to tell the lag from the delay."""
    library, state = lagging
    return experiment(library, state, *library.instances, np.array([0.002]))


def test_motions_are_simulated_once_for_several_effects(lagging, proposed):
    """The same answers as one by one, for less than two thirds of the steps."""
    library, state = lagging
    lag, delay = library.instances
    before = library.simulator.steps
    alone = experiment(library, state, lag, delay, np.array([0.004]))
    one = library.simulator.steps - before
    pairs = [(delay, np.array([0.002])), (delay, np.array([0.004]))]
    before = library.simulator.steps
    assert experiments(library, state, lag, pairs) == [proposed, alone]
    assert library.simulator.steps - before < 2 / 3 * 2 * one


def states_of(library, state, found):
    """The commands of an experiment, and the states that the model predicts under them."""
    data = state.train.windows.segments.trajectories
    commands = commands_of(library.simulator, data, [found])
    starts = data.observations[np.argsort(np.abs(data.observations).sum(axis=1))[:1]]
    return commands[0], open_loop(library.simulator, state.theta, starts, commands)[0]


def test_it_says_how_often_to_record(proposed, lagging):
    """Recorded as often as it says, it tells the two apart by ten nats."""
    assert proposed.times * proposed.nats >= SETTINGS.distinct
    step = lagging[0].simulator.control_step
    assert proposed.seconds == pytest.approx(proposed.times * proposed.steps * step)
    assert "shoulder" in str(proposed) or "all actuators" in str(proposed)


def test_it_can_be_recorded(proposed, lagging):
    """Several periods and ten windows long, smooth, from rest to rest, within every limit."""
    library, state = lagging
    data = state.train.windows.segments.trajectories
    assert proposed.steps >= 10 * state.train.windows.length
    assert proposed.steps * proposed.step >= 5 * proposed.period
    commands, states = states_of(library, state, proposed)
    middle = np.median(data.actions, axis=0)
    largest = np.abs(data.actions - middle).max()
    assert np.abs(np.diff(commands, axis=0)).max() < 0.5 * largest
    np.testing.assert_allclose(commands[[0, -1]], np.tile(middle, (2, 1)), atol=0.02 * largest)
    low, high = signal_limits(library.simulator, data)
    assert np.all(states[1:] > low)
    assert np.all(states[1:] < high)


@pytest.mark.parametrize(("field", "limits"), [("range", (-0.1, 0.1)), ("forcerange", (-0.4, 0.4))])
def test_limits_of_the_model_are_kept(lagging, monkeypatch, field, limits):
    """A joint that may turn by 0.1 rad alone, and drives that can give little: smaller motions."""
    library, state = lagging
    model = library.simulator.model
    if field == "range":
        narrow = [replace(joint, range=limits) for joint in joints(model)]
        monkeypatch.setattr(
            "dropo.diagnosis.findings.limits.experiment.joints", lambda model: narrow
        )
    else:
        monkeypatch.setattr(model, "actuator_forcelimited", np.ones(2, dtype=bool))
        monkeypatch.setattr(model, "actuator_forcerange", np.tile(limits, (2, 1)))
    found = experiment(library, state, *library.instances, np.array([0.002]))
    if found is None:
        return  # nothing that can be recorded is said to be nothing
    commands, states = states_of(library, state, found)
    if field == "range":
        assert np.abs(states[1:, :2]).max() < limits[1]
    else:
        gears = model.actuator_gear[:, 0]
        assert np.abs(commands).max(axis=0) @ gears <= 2 * limits[1] * gears.sum()


def test_an_effect_cannot_be_told_from_itself(lagging):
    """No command is worth anything then."""
    library, state = lagging
    twice = (library.instances[0], library.instances[0])
    found = experiment(library, state, *twice, state.theta[:1])
    assert found.nats < 1e-9
    assert found.seconds == np.inf or found.seconds > 1e6


def test_commands_that_make_the_simulation_diverge_tell_nothing(lagging, proposed, monkeypatch):
    """The largest commands throw the model out of its numbers: the experiment is chosen among the
    others.
    """
    library, state = lagging
    data = state.train.windows.segments.trajectories
    middle = np.median(data.actions, axis=0)
    limit = 0.3 * np.abs(data.actions - middle).max()

    def failing(simulator, value, starts, actions):
        states = open_loop(simulator, value, starts, actions)
        states[np.abs(actions - middle).max(axis=(1, 2)) > limit, 2:] = np.nan
        return states

    monkeypatch.setattr("dropo.diagnosis.findings.limits.experiment.open_loop", failing)
    found = experiment(library, state, *library.instances, np.array([0.002]))
    assert found.reach <= limit
    assert 0 < found.nats <= proposed.nats


def test_windows_longer_than_a_period(lagging):
    """Where the data are cut into windows of 80 steps, a motion has ten of them."""
    library, state = lagging
    train, test = split(problem([(PAIR[0], [0.002])], sigma=SIGMA, steps=240), 80, 12)
    search = Selection(library, np.full(4, 1e-9))
    long = search.begin(train, test, state.theta, white(np.full(4, SIGMA)), np.arange(0))
    found = experiment(library, long, *library.instances, np.array([0.002]))
    assert found.nats > 0
    assert found.steps >= 800


def test_commands_stay_within_the_data(lagging):
    """No candidate asks for more than the data's largest command; all of them are different."""
    library, state = lagging
    data = state.train.windows.segments.trajectories
    middle = np.median(data.actions, axis=0)
    for group in _candidates(library.simulator, 5):
        commands = commands_of(library.simulator, data, group)
        largest = np.abs(data.actions - middle).max(axis=0)
        assert np.all(np.abs(commands - middle) <= largest + 1e-12)
        assert all(np.any(one != two) for one, two in pairwise(commands))


def test_what_to_record_is_said_with_its_worth(proposed, lagging):
    """Which motion, for how long, and by how many nats it tells the two apart."""
    better = replace(proposed, now=0.5 * proposed.nats)
    text = _proposal(better, *lagging[0].instances)
    assert text.startswith("record this: ")
    assert "that tells actuator lag at shoulder_motor from actuator delay at shoulder_motor" in text
    assert text.endswith("nats")


def test_where_the_data_tell_more_more_of_them_is_said(proposed, lagging):
    """Random commands that change in every step tell a lag from a delay, smooth ones do not."""
    assert not replace(proposed, now=2 * proposed.nats).is_better
    text = _proposal(replace(proposed, now=2 * proposed.nats), *lagging[0].instances)
    assert "more of motion like the recorded" in text
    assert text.endswith("by about 10 nats")


def test_a_smooth_motion_tells_damping_from_friction():
    """More than as many steps of random commands."""
    pair = ("joint_damping:elbow", "joint_friction:elbow")
    data = problem([(pair[0], [0.05])], sigma=SIGMA)
    instances = [instance(data.simulator, label) for label in pair]
    library = Library(data.simulator.with_effects(instances), instances, 0)
    train, test = split(data, 5, 48)
    search = Selection(library, np.full(4, 1e-9))
    first = search.begin(train, test, np.zeros(2), white(np.full(4, SIGMA)), np.arange(0))
    state = search.run(first, first, instances[:1])
    found = experiment(library, state, *library.instances, np.array([0.02]))
    assert found.is_better
