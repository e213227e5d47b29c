"""Windows are as long as it takes for what is wrong to stand out from the noise."""

import math
from dataclasses import replace

import pytest

from dropo.diagnosis.search.window_length import (
    SETTINGS,
    WindowLengthSettings,
    choose_length,
)
from dropo.problems.file.estimated_velocities import with_velocities
from tests.models.hidden_in_arm import problem


@pytest.mark.parametrize(
    ("size", "sigma", "expected"),
    [(0.05, 1e-4, {5}), (0.003, 5e-3, {10, 20, 50}), (0.0, 1e-3, {SETTINGS.shortest})],
)
def test_small_effects_in_much_noise_need_longer_windows(size, sigma, expected):
    """Damping that stands out at once, one that must add up over several steps, and none at all,
    for which nothing is gained by waiting.
    """
    hidden = [("joint_damping:elbow", [size])] if size else []
    assert choose_length(problem(hidden, sigma=sigma, episodes=40, steps=110)) in expected


def test_the_problems_own_horizon_comes_first():
    """As stated, but at least the shortest."""
    known = problem([("joint_damping:elbow", [0.003])], steps=40)
    assert [choose_length(replace(known, horizon=steps)) for steps in (2, 7, 12)] == [
        SETTINGS.shortest,
        7,
        12,
    ]


def test_as_few_data_as_there_are():
    """Lengths of which too few windows would be left on either side are not tried: the effect that
    needs more gets the shortest.
    """
    few = problem([("joint_damping:elbow", [0.003])], sigma=5e-3, episodes=8, steps=24)
    assert choose_length(few) == SETTINGS.shortest < SETTINGS.horizons[1]


def test_windows_end_before_the_noise_of_their_start_bends():
    """What would stand out after 50 steps is not waited for where the start's noise bends before;
    an arm's does not, and a limit far below what its does stops it.
    """
    slow = problem([("joint_damping:elbow", [0.01])], sigma=0.03, episodes=40, steps=110)
    assert choose_length(slow) == 50
    assert choose_length(slow, WindowLengthSettings(curved=0.01)) == SETTINGS.shortest


def test_windows_are_longer_where_velocities_were_estimated():
    """Most of a few positions only tell the start's velocity: windows last a quarter of a second,
    half of that where there are not enough, and the shortest where the start's noise bends. The
    control is the same log, taken for measured.
    """
    alone = with_velocities(_by_positions(problem([("joint_damping:elbow", [0.2])], steps=60)))
    quarter = math.ceil(SETTINGS.seconds / alone.simulator.control_step)
    assert choose_length(alone) == quarter > SETTINGS.shortest
    many = replace(SETTINGS, fewest=len(alone.trajectories) // (2 * quarter))
    assert choose_length(alone, many) == quarter // 2
    assert choose_length(alone, replace(SETTINGS, curved=0.0)) == SETTINGS.shortest
    assert choose_length(replace(alone, estimated={})) < quarter


def _by_positions(found):
    """A problem whose log has no velocities."""
    data = found.trajectories
    return replace(
        found,
        simulator=found.simulator.observing(["qpos"]),
        trajectories=replace(
            data,
            observations=data.observations[:, :2],
            next_observations=data.next_observations[:, :2],
        ),
    )
