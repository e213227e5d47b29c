"""Problems on data that simulated machines record."""

from dataclasses import replace

import numpy as np
import pytest

from dropo import fit, hide, load
from dropo.core.services.errors import SimulationFailed
from dropo.problems.simulated.hidden import NOISE
from dropo.problems.simulated.robots import simulated_robot


def test_masses_of_an_arm_are_found():
    """To four standard errors, which are below 0.1 %."""
    problem = load("torque-arm", threads=1).using(transitions=400)
    found = fit(problem)
    truth = np.array([problem.truth[name] for name in problem.space.names])
    assert np.all(np.abs(found.mean - truth) < 4 * found.mean_se)
    assert np.all(found.mean_se < 1e-3 * truth)


@pytest.mark.parametrize("name", NOISE)
def test_something_hidden_changes_the_data(name):
    """The same machine, seed and noise, with and without: only what is hidden is another."""
    place = {
        "hopper": "leg_joint",
        "hopper-noisy": "leg_joint",
        "half-cheetah": "bthigh",
        "walker2d": "leg_joint",
        "torque-arm": "elbow",
    }
    label = f"joint_damping:{place.get(name, 'lift')}=0.5"
    with_it = hide(name, [label], seed=3)
    without = hide(name, [], seed=3)
    first = with_it.trajectories
    second = without.trajectories
    np.testing.assert_array_equal(first.observations[0], second.observations[0])
    assert not np.allclose(first.next_observations[0], second.next_observations[0], atol=1e-9)
    assert with_it.simulator.space.names == without.simulator.space.names != ()
    assert with_it.start_noise
    assert with_it.epsilon == pytest.approx(NOISE[name] ** 2)


def test_walkers_load():
    """Gymnasium's models with all masses declared; the nominal ones are the truth."""
    problem = load("half-cheetah", threads=1)
    assert sum(problem.truth.values()) == pytest.approx(14.0)
    assert len(problem.trajectories) == 1800
    assert len(load("walker2d", threads=1).space) == 7


def test_a_machine_that_falls_at_once_is_told():
    """No trajectory of a step; some that end early are left out."""
    rng = np.random.default_rng
    arm = simulated_robot("torque-arm")
    fallen = replace(arm, alive=lambda rows: np.zeros(len(rows), dtype=bool))
    with pytest.raises(SimulationFailed, match="None of 26 trajectories lasts a control step"):
        fallen.record(noise=1e-3, rng=rng(0))
    some = replace(arm, alive=lambda rows: np.arange(len(rows)) % 2 == 0)
    assert some.record(noise=1e-3, rng=rng(0)).terminals.sum() == 13
