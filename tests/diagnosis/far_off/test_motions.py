"""Long windows: as long as data and chaos allow, of positions, with the noise of their starts."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.diagnosis.far_off.motions import LongWindowSettings, motions_of
from tests.models.far_off import torque_arm

FEW = LongWindowSettings(seconds=(0.1, 0.2), physics_steps=12_000)


def cut(model, settings=FEW):
    """A model's motions."""
    return motions_of(model.problem, model.library, model.theta, settings)


@pytest.fixture(scope="module")
def arm():
    """An arm that lacks rotor inertia."""
    return torque_arm("joint_armature:elbow")


def test_positions_alone_are_compared(arm):
    """Residuals are those of the angles in every step, in rad."""
    fitted, _held_out = cut(arm)
    assert fitted.compared.tolist() == [True, True, False, False]
    predicted = arm.library.predict(arm.theta[None], fitted.windows)
    residuals = fitted.residuals(predicted)[0]
    assert residuals.shape == (len(fitted.windows), 2 * fitted.windows.length)
    by_signal = (fitted.windows.measured - predicted[0]).reshape(-1, 4)
    np.testing.assert_array_equal(residuals.reshape(-1, 2), by_signal[:, :2])


def test_windows_are_as_long_as_asked_where_data_allow(arm):
    """0.2 s are 10 control steps; with a curvature that nothing is below, the first length."""
    assert cut(arm)[0].windows.length == 10
    assert cut(arm, replace(FEW, curved=-1.0))[0].windows.length == 5


def test_fitted_and_held_out_data_stay_apart(arm):
    """No row of the windows held out is among the rows that are fitted."""
    fitted, held_out = cut(arm)
    rows = {row.tobytes() for row in fitted.windows.measured.reshape(-1, 4)}
    others = {row.tobytes() for row in held_out.windows.measured.reshape(-1, 4)}
    assert not rows & others


def test_windows_that_move_otherwise_come_first(arm):
    """Eight of many: those in which each joint moves most and fastest tell more of every number
    than as many that are evenly spread.
    """
    settings = replace(FEW, physics_steps=1_200, control_steps=80, pool=1000)
    chosen = cut(arm, settings)[0].windows
    pool = cut(arm, replace(settings, physics_steps=1_200_000, control_steps=80_000))[0].windows
    assert len(chosen) == 8 < len(pool)
    np.testing.assert_array_equal(chosen.measured, pool.measured[:8])
    told = [_told(windows) for windows in (chosen, pool.take(np.sort(_even(len(pool)))))]
    assert told[0] > told[1] + 1


def _told(windows):
    """The logarithm of the determinant of how far and how fast joints move."""
    angles = windows.measured.reshape(len(windows), windows.length, 4)[:, :, :2]
    moved = np.concatenate([angles.std(axis=1), np.diff(angles, axis=1).std(axis=1)], axis=1)
    return np.linalg.slogdet(moved.T @ moved)[1]


def _even(count):
    """Eight of so many."""
    return np.linspace(0, count - 1, 8).round().astype(int)


def test_the_starts_noise_is_followed_where_it_matters(arm):
    """It has loadings for each signal, the derivatives of the predictions by the start; none where
    it is allowed for.
    """
    fitted = cut(arm)[0]
    assert fitted.loadings.shape == (len(fitted.windows), 20, 4)
    # An angle's error at the start is about one in the next step.
    assert np.median(fitted.loadings[:, 0, 0]) == pytest.approx(1.0, abs=0.05)
    known = cut(arm, replace(FEW, start=np.inf))[0]
    assert known.loadings.shape == (len(fitted.windows), 20, 0)


def test_too_few_data_are_refused(arm):
    """Three windows are too few to fit; without data held out nothing can be judged."""
    data = arm.problem.trajectories
    short = replace(arm.problem, trajectories=data.head(18))
    with pytest.raises(BadArgument, match="at least 8 windows of 5 steps to fit"):
        motions_of(short, arm.library, arm.theta, FEW)
    alone = replace(arm.problem, held_out=None)
    with pytest.raises(BadArgument, match="data held out"):
        motions_of(alone, arm.library, arm.theta, FEW)
