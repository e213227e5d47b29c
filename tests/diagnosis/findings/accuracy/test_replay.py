"""Whole runs by commands alone: errors by signal, run and unit, capped where motion is lost."""

import numpy as np
import pytest

from dropo.core.records.saved_schema import SavedReplay
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.findings.accuracy.replay import WholeRunReplay, replay
from dropo.problems.loading import load
from dropo.simulators.mujoco.simulator import MujocoSimulator

LENGTHS = (60, 30)


@pytest.fixture(scope="module")
def arm() -> MujocoSimulator:
    """Two joints, whose declared parameter is a mass."""
    simulator = load("torque-arm").simulator
    assert isinstance(simulator, MujocoSimulator)
    return simulator


def runs(arm: MujocoSimulator, theta: np.ndarray, offset: float) -> Trajectories:
    """Two runs of the arm itself; of the second, the shoulder's angle is read with an offset."""
    rng = np.random.default_rng(3)
    rows = sum(LENGTHS)
    blank = np.zeros((rows, 4))
    ends = np.zeros(rows, dtype=bool)
    ends[np.cumsum(LENGTHS) - 1] = True
    actions = 0.1 * rng.standard_normal((rows, 2))
    data = Trajectories(blank, actions, blank, ends)
    whole = data.segments(reset="start", every_step=True)
    next_observations = arm.predict(theta[None], whole)[0]
    next_observations[LENGTHS[0] :, 0] += offset
    return Trajectories(blank, actions, next_observations, ends)


def test_errors_by_run_signal_and_unit(arm: MujocoSimulator) -> None:
    """Nothing but the offset is left of the true model's errors; a wrong mass is off everywhere."""
    true = np.asarray(arm.nominal, dtype=float)
    wrong = 1.5 * true
    data = runs(arm, true, 0.01)
    found = replay(arm, data, [wrong, true])
    expected = np.zeros((2, 4))
    expected[1, 0] = 0.01
    np.testing.assert_allclose(found.after, expected, atol=1e-12)
    assert (found.before > 0).all()
    # All rows of both runs, all signals of the unit.
    share = LENGTHS[1] / sum(LENGTHS) / 2
    assert found.overall("rad")[1] == pytest.approx(0.01 * np.sqrt(share))
    assert found.overall("rad/s")[1] == pytest.approx(0.0, abs=1e-12)
    assert found.seconds == pytest.approx([length * arm.control_step for length in LENGTHS])
    assert len(found.table().rows) == 4 + 2
    SavedReplay.model_validate(found.to_json())


def test_what_is_lost_counts_as_twice_the_spread(arm: MujocoSimulator) -> None:
    """However far off, and where a simulation has diverged."""
    true = np.asarray(arm.nominal, dtype=float)
    data = runs(arm, true, 1e6)
    found = replay(arm, data, [true, true])
    spread = np.std(data.next_observations[:, 0])
    assert found.after[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert found.after[1, 0] == pytest.approx(2 * spread)


def test_a_run_in_which_one_signal_is_off_is_named() -> None:
    """Six runs, in one of which a joint stuck; the others' errors differ by chance alone."""
    rng = np.random.default_rng(4)
    after = 0.01 * rng.uniform(0.7, 1.4, (6, 2))
    after[3, 1] = 0.2
    seconds = (10.0,) * 6
    found = WholeRunReplay(seconds, ("qpos.lift", "qpos.roll"), ("rad", "rad"), 2 * after, after)
    (odd,) = found.odd()
    assert (odd.run, odd.signal, odd.error) == (3, "qpos.roll", 0.2)
    assert "run 4 of those held out qpos.roll is off by 0.2 rad" in str(odd)
    kept = after[:, 0], np.delete(after[:, 1], 3)
    expected = np.sqrt(np.mean([np.mean(one**2) for one in kept]))
    assert found.usual("rad") == pytest.approx(expected)
    assert found.table().rows[-1][0] == "all but odd runs"
    SavedReplay.model_validate(found.to_json())
    few = WholeRunReplay(seconds[:4], found.signals, found.units, 2 * after[:4], after[:4])
    assert few.odd() == []
