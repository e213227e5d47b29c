"""Numbers fitted to whole motions, with errors that know what motions do not tell."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.diagnosis.far_off.motions import LongWindowSettings, motions_of, moving
from dropo.diagnosis.far_off.output_error import OutputError
from dropo.diagnosis.far_off.ties import ties_of
from tests.models.far_off import torque_arm

TRUTH = 0.01  # [kg m^2] at the elbow
SHORT = LongWindowSettings(seconds=(0.1,), physics_steps=12_000)


def fitted(*labels):
    """An arm's numbers fitted to its motions, and the covariance without and with a prior."""
    model = torque_arm(*labels)
    motions = motions_of(model.problem, model.library, model.theta, SHORT)[0]
    error = OutputError(model.library, motions)
    theta = error.fit(model.theta, model.fitted)
    return model, error, error.linearize(theta, model.fitted, central=True)


@pytest.fixture(scope="module")
def rotor():
    """The inertia that is missing, and a friction that is not."""
    return fitted("joint_armature:elbow", "joint_friction:shoulder")


def test_what_is_missing_is_found(rotor):
    """Within four standard errors, which are below a twentieth of it; what is not missing is 0."""
    model, error, end = rotor
    sd = np.sqrt(np.diag(error.covariance(end, np.zeros((2, 2)))))
    inertia, friction = end.theta[model.fitted]
    assert abs(inertia - TRUTH) < 4 * sd[0] < 0.2 * TRUTH
    assert abs(friction) < 4 * sd[1] + 1e-6


def test_the_fit_is_a_minimum(rotor):
    """The cost rises on both sides of every number, by as much as its derivatives say."""
    model, error, end = rotor
    width = 3 / np.sqrt(np.diag(end.gram))
    for i, place in enumerate(model.fitted):
        for sign in (-1, 1):
            theta = end.theta.copy()
            theta[place] += sign * width[i]
            cost = error.cost(error.whitened(error.residuals(theta[None]), end.scale)).sum()
            assert 2.0 < cost - end.cost < 9.0


def test_a_joint_that_mostly_rests_has_the_errors_of_its_motions(rotor):
    """It moves a fifth of the time: its errors are those, not the median of none; another that
    always moves has its own. A window that diverges has no say.
    """
    _, error, _ = rotor
    shape = error.motions.moving.shape
    rows = np.random.default_rng(0).normal(0.0, 0.1, shape)
    rows[np.arange(len(rows)) % 5 > 0, 0] = 1e-4
    motions = replace(error.motions)
    motions.__dict__["moving"] = np.abs(rows) > 1e-4
    rows[: len(rows) // len(motions.windows)] = np.nan
    residuals = rows.reshape(len(motions.windows), -1)
    resting, moving, *_ = OutputError(error.library, motions).scale_of(residuals)
    assert 0.08 < resting < 0.12
    assert 0.09 < moving < 0.11
    none = np.full_like(residuals, np.nan)
    assert (error.scale_of(none) >= motions.noise).all()


def test_where_a_signal_moves():
    """A signal that rests for four fifths of a window, with its encoder's noise, moves in the last
    fifth; one that swings moves but where it turns.
    """
    time = np.linspace(0, 1, 500)
    noise = np.random.default_rng(1).normal(0, 1e-4, (2, 500))
    ramp = np.maximum(0.0, time - 0.8) + noise
    swing = np.sin(2 * np.pi * time) + noise
    rests, swings = moving(np.stack([ramp, swing], axis=2)).mean(axis=(0, 1))
    assert 0.18 < rests < 0.24
    assert 0.85 < swings < 1.0


def test_directions_that_motions_do_not_tell_are_unknown():
    """All drives' gain beside each drive's: together known as alone, apart not at all. A prior of
    0.2 on each is then all that is known; without one errors are far beyond it.
    """
    _model, error, end = fitted(
        "joint_armature:elbow",
        "actuator_gain",
        "actuator_gain:shoulder_motor",
        "actuator_gain:elbow_motor",
    )
    free = np.sqrt(np.diag(error.covariance(end, np.zeros((4, 4)))))
    known = np.sqrt(np.diag(error.covariance(end, np.diag([0.0, 25.0, 25.0, 25.0]))))
    assert (free[1:] > 1.0).all()
    assert (known[1:] > 0.05).all()
    assert (known[1:] < 0.25).all()
    assert free[0] < 0.1 * TRUTH


def test_numbers_that_move_nothing_are_unknown():
    """A payload's place across the plane in which an arm moves: it is known not at all, the rest
    is, and no set of numbers that are told together has it.
    """
    model = torque_arm("joint_armature:elbow", "payload:fore")
    mass, *place = model.library.indices_of["payload:fore"]
    theta = model.theta.copy()
    theta[mass] = 0.05
    model = model.at(theta)
    motions = motions_of(model.problem, model.library, model.theta, SHORT)[0]
    error = OutputError(model.library, motions)
    end = error.linearize(model.theta, model.fitted, central=True)
    covariance = error.covariance(end, np.zeros((5, 5)))
    across = list(model.fitted).index(place[1])
    others = np.delete(np.arange(5), across)
    assert np.isinf(covariance[across, across])
    assert np.isfinite(covariance[np.ix_(others, others)]).all()
    assert not any(" y " in one for one in ties_of(model, covariance, end.free, 0.2))


def test_a_number_at_its_bound_does_not_hold_the_others():
    """Friction cannot be negative: it stays within its bounds, and the inertia is found."""
    model, _error, end = fitted("joint_friction:elbow", "joint_armature:elbow")
    friction, inertia = end.theta[model.fitted]
    assert friction >= 0
    assert abs(inertia - TRUTH) < 0.1 * TRUTH


def test_halved_steps_are_part_of_the_error(rotor):
    """The arm's data come of the model's own step: what halving it changes is small, but not 0."""
    _, error, end = rotor
    change = error.change_by_step(end, np.zeros((1, 1)))
    assert (change > 0).all()
    assert change[0] < 0.5 * TRUTH
