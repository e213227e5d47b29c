"""The study of noisy and unlogged states: its bound, and what it says of fits that miss it."""

import numpy as np
import pytest

from dropo.core.services.errors import UnknownName
from dropo.studies.unlogged_states.machines import MACHINES, simulate_log
from dropo.studies.unlogged_states.study import CASES, DEFAULT, _remarks, summary


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
