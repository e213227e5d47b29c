"""Resampling reproduces what each method is exact for, and refuses what it cannot know."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dropo.core.services.errors import BadArgument, UnknownName
from dropo.logs.signals.resampling import resample, resample_rotations


def test_a_spline_passes_through_what_was_measured():
    """At the measured instants every method gives the measurement; between them a line stays a
    line.
    """
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.5, 2.0, 40))
    values = rng.normal(size=(40, 3))
    for method in ("akima", "linear", "previous"):
        np.testing.assert_allclose(resample(time, values, time, method=method), values, atol=1e-12)
    at = np.linspace(time[0], time[-1], 200)
    for method in ("akima", "linear"):
        np.testing.assert_allclose(
            resample(time, np.stack([3 * time - 1], axis=1), at, method=method)[:, 0],
            3 * at - 1,
            atol=1e-10,
        )


def test_akima_splines_do_not_overshoot_a_step_and_are_close_on_smooth_motion():
    """Beside a step the Akima spline stays within it; on a sine it is far closer than straight
    lines.
    """
    time = np.arange(20.0)
    step = (time >= 10).astype(float)[:, None]
    fine = np.linspace(0, 19, 1000)
    assert np.ptp(resample(time, step, fine)) <= 1 + 1e-9
    angle = np.sin(time / 2)[:, None]
    errors = {
        method: np.abs(resample(time, angle, fine, method=method)[:, 0] - np.sin(fine / 2)).max()
        for method in ("akima", "linear")
    }
    assert errors["akima"] < 0.5 * errors["linear"]


def test_commands_are_held():
    """A command holds until the next one, also behind the last; before the first there is none."""
    at = [0.0, 0.99, 1.0, 1.5, 9.0]
    np.testing.assert_array_equal(
        resample([0, 1, 2], [[5], [6], [7]], at, method="previous")[:, 0], [5, 5, 6, 6, 7]
    )
    with pytest.raises(BadArgument, match=r"Got -0\.1"):
        resample([0, 1, 2], [[5], [6], [7]], [-0.1], method="previous")


def test_rotations_turn_evenly():
    """Half way between two measurements lies half the turn, whichever sign they were written with."""
    time = np.array([0.0, 1.0, 3.0])
    turns = np.array([[0.0, 0, 0], [0, 0, 1.0], [0, 2.0, 0]])
    measured = Rotation.from_rotvec(turns).as_quat(scalar_first=True)
    found = resample_rotations(
        time, measured * np.array([[1], [-1], [1]]), [0.0, 0.5, 1.0, 2.0, 3.0]
    )
    wanted = Rotation.from_rotvec([0, 0, 0.5]).as_quat(scalar_first=True)
    np.testing.assert_allclose(found[1], wanted, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(found[[0, 2, 4]] * measured, axis=1)), 1, atol=1e-12)
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0).all()


def test_refusals():
    """Time that stands still, instants outside of the log, an unknown method and a zero quaternion
    are refused by name.
    """
    with pytest.raises(BadArgument, match="strictly increasing"):
        resample([0, 1, 1], np.zeros((3, 1)), [0.5])
    with pytest.raises(BadArgument, match=r"within 0 and 2 s. Got 2.5"):
        resample([0, 1, 2], np.zeros((3, 1)), [0.5, 2.5])
    with pytest.raises(UnknownName, match="akima"):
        resample([0, 1, 2], np.zeros((3, 1)), [0.5], method="akina")
    with pytest.raises(BadArgument, match="a zero"):
        resample_rotations([0, 1], np.zeros((2, 4)), [0.5])
