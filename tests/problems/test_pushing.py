"""The arm that pushes a box: a moved centre of mass acts, commands keep to limits, closed and open
loops agree, DROPO finds 3 cm.
"""

import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.estimators.dropo import DROPO
from dropo.problems.panda import pushing as pushing_problem
from dropo.problems.panda.pusher import BOX, JOINT_ACCELERATION, Arms, angles_at, boxes_of, drive
from dropo.problems.panda.pushing import (
    FRAME_SKIP,
    HORIZON,
    NOISE,
    STEPS,
    TRUTH,
    Pusher,
    measured,
    pushing,
    pushing_simulator,
    target_model,
)
from dropo.simulators.mujoco.closed_loop import fields_of


@pytest.fixture(scope="module")
def simulator():
    return pushing_simulator(1)


@pytest.fixture(scope="module")
def problem():
    return pushing(1)


def push(model, fields, aims, steps=200):
    """Pushes straight ahead at so many places beside the middle, by a policy that ignores turns."""
    numbers = np.column_stack([aims, np.zeros((len(aims), 3))])
    pusher = Pusher(numbers, model.body("box").pos[:2])
    return drive(
        model,
        pusher,
        np.zeros((len(aims), 3)),
        steps,
        frame_skip=FRAME_SKIP,
        fields=fields,
        rng=np.random.default_rng(0),
    )


def test_closed_loop_is_what_predict_replays(simulator):
    """Bit for bit, for boxes whose mass, friction and centre of mass differ; the control: another
    centre of mass is another run.
    """
    values = np.array(
        [[1.1, 0.45, 0.6, 0.0, 0.03], [0.8, 0.6, 0.3, 0.01, -0.02], [1.0, 0.5, 0.5, 0.0, 0.0]]
    )
    model, fields = fields_of(simulator, values)
    runs = push(model, fields, [0.03, -0.02, 0.0])
    before, after = (
        part.reshape(-1, part.shape[2]) for part in (runs.states[:, :-1], runs.states[:, 1:])
    )
    ends = np.tile(np.arange(200) == 199, 3)
    segments = Trajectories(before, runs.actions.reshape(-1, 7), after, ends).segments(
        reset="start"
    )
    predicted = simulator.predict(values, segments)
    targets = simulator.targets(segments)
    for k in range(3):
        own = slice(200 * k, 200 * k + 200)
        np.testing.assert_array_equal(predicted[k, own], targets[own])
        assert np.abs(predicted[(k + 1) % 3, own] - targets[own]).max() > 1e-3


def test_the_centre_of_mass_turns_the_box(simulator):
    """Pushed in its middle, a box whose mass is on the left turns left, where it drags more, and
    its mirror image right.
    """
    true = simulator.space.vector(TRUTH)
    mirrored = true * [1, 1, 1, 1, -1]
    model, fields = fields_of(simulator, np.array([true, mirrored]))
    turns = boxes_of(push(model, fields, [0.0, 0.0]).states[:, -1])[:, 2]
    assert turns[0] > 0.1
    assert turns[1] < -0.1
    assert simulator.model.body("box").simple[0] == 0
    assert model.body("box").subtreemass[0] == pytest.approx(TRUTH["box_mass"])


def test_a_pushed_box_does_not_hop(simulator):
    """It slides flat: it tilts slower than 0.1 rad/s while it is pushed at 0.1 m/s."""
    model, fields = fields_of(simulator, simulator.space.vector(TRUTH)[None])
    states = push(model, fields, [0.03]).states[0]
    assert np.abs(states[:, -3:-1]).max() < 0.1
    assert boxes_of(states[-1])[0] - boxes_of(states[0])[0] > 0.1


def test_commands_keep_to_the_arms_limits(simulator):
    """Joint accelerations are cut at the Panda's limits, and commanded angles are their double
    integral.
    """
    arms = Arms(simulator.model, 1, 0.01)
    ids = np.array([0])
    path = [arms.angles[0].copy()]
    for wanted in [[0.2, 0.1]] * 30 + [[-0.2, 0.1]] * 30:
        arms.lead(ids, np.array([wanted]))
        path.append(arms.angles[0].copy())
    accelerations = np.diff(path, n=2, axis=0) / 0.01**2
    assert (np.abs(accelerations) <= JOINT_ACCELERATION * (1 + 1e-9)).all()
    np.testing.assert_allclose(arms.angles[0], angles_at(simulator.model, arms.pins)[0], atol=0.02)
    arms.accelerate(ids, np.full((1, 7), 1e3))
    path.append(arms.angles[0].copy())
    np.testing.assert_allclose(np.diff(path[-3:], n=2, axis=0)[0] / 0.01**2, JOINT_ACCELERATION)


def test_the_target_has_bolts():
    """Its centre of mass is 3 cm beside the middle and the mass the truth's; its height and inertia
    are not the model's.
    """
    box = target_model().body("box")
    own = pushing_simulator(1).model.body("box")
    np.testing.assert_allclose(box.ipos[:2], [TRUTH["com_x"], TRUTH["com_y"]], atol=1e-12)
    assert box.mass[0] == pytest.approx(TRUTH["box_mass"])
    assert box.ipos[2] < -0.01
    assert abs(box.inertia[0] / own.inertia[0] - 1) > 0.05


def test_the_problem(problem):
    """One trajectory of 1050 transitions in chains of ten; the box alone is reset; noise as stated;
    the same seed, the same data.
    """
    assert (problem.reset, problem.horizon, len(problem.segments)) == (
        "partial",
        HORIZON,
        STEPS // HORIZON,
    )
    assert problem.set_columns.sum() == 13
    assert problem.set_columns[BOX : BOX + 7].all()
    np.testing.assert_array_equal(
        pushing(1).trajectories.observations, problem.trajectories.observations
    )
    assert (pushing(1, seed=1).trajectories.observations != problem.trajectories.observations).any()
    state = problem.trajectories.observations[:1]
    seen = measured(np.repeat(state, 2000, axis=0), np.random.default_rng(0))
    spread = problem.simulator.layout.coordinates(seen, state).std(axis=0)
    np.testing.assert_allclose(
        spread / NOISE, 1, atol=5 / np.sqrt(2 * 2000)
    )  # 26 signals, five standard errors


def test_without_bolts_aside_no_shift_is_found(monkeypatch):
    """From one of six pushes, within 5 mm: the control of the study in small, which finds it."""
    dropo = DROPO(likelihood="linear", epsilon="learn")
    monkeypatch.setitem(pushing_problem.TRUTH, "com_y", 0.0)
    target_model.cache_clear()
    try:
        even = pushing(1).using(transitions=105)
    finally:
        target_model.cache_clear()
    assert abs(dropo.fit(even, rng=0).mean[4]) < 0.005
