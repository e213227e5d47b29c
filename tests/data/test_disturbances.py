"""Pushes that no command explains are found with their place and time, and nothing else is; a
robust fit survives them.
"""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.data.outliers import disturbances
from dropo.data.outliers.disturbances import find_disturbances, robust_values
from dropo.problems.file.estimated_velocities import with_velocities
from tests.models.pushed_arm import NOISE, PUSHES, STEP, recorded


def test_pushes_are_found_and_nothing_else(simulator):
    """Each push is one span of its run that covers it, within 0.3 s on either side; without pushes
    there is none; spikes are none.
    """
    value = simulator.nominal
    found = find_disturbances(simulator, recorded(simulator, PUSHES, spikes=5), value, STEP)
    assert [span.trajectory for span in found.spans] == [0, 2]
    for span, (_, first, last) in zip(found.spans, PUSHES, strict=True):
        assert span.start - 0.3 < first * STEP < span.start + 0.2
        assert span.end - 0.2 < last * STEP < span.end + 0.3
        assert span.signal == "qvel.hinge"
    assert np.sign([span.size for span in found.spans]).tolist() == [1, -1]
    assert "trajectory 0, 2." in str(found)
    kept = found.left_out()
    assert len(kept) == len(found.trajectories) - sum(
        span.last - span.first for span in found.spans
    )
    assert len(kept.spans) == 5
    assert find_disturbances(simulator, recorded(simulator, {}, spikes=5), value, STEP).spans == ()


def test_pushes_are_found_from_positions_alone(simulator):
    """Velocities estimated from positions are wrong where commands change at once: that is no push,
    but where they are not said to be estimated. Pushes are found, nothing else.
    """
    for pushes, runs in ((PUSHES, [0, 2]), ({}, [])):
        moved = recorded(simulator, pushes, abrupt=True, noise=0.01 * NOISE)
        parts = (moved.observations[:, :1], moved.actions, moved.next_observations[:, :1])
        alone = Trajectories(*parts, moved.terminals)
        problem = with_velocities(Problem("arm", simulator.observing(["qpos[0]"]), alone))
        data = (problem.simulator, problem.trajectories, simulator.nominal, STEP)
        told = find_disturbances(*data, estimated=problem.estimated)
        untold = find_disturbances(*data)
        assert [span.trajectory for span in told.spans] == runs
        assert {span.signal for span in told.spans} <= {"qpos.hinge"}
        assert len(untold.spans) > len(runs)


def test_a_robust_fit_survives_pushes(simulator):
    """Friction and mass are found from the wrong start, with pushes in the data; a plain fit to the
    same windows is farther off.
    """
    data = recorded(simulator, {**PUSHES, (1, 100, 250): 1.5, (1, 500, 650): 1.5})
    found = robust_values(simulator, data, STEP, [0.4, 0.9])
    assert abs(found - [0.15, 0.6]).max() < 0.03
    spans = find_disturbances(simulator, data, found, STEP)
    assert {span.trajectory for span in spans.spans} == {0, 1, 2}


def test_a_model_that_lacks_something_is_called_so(simulator):
    """Where much of the data stands out, the sentence says that it is rather the model; the control
    is a push alone.
    """
    wrong = find_disturbances(simulator, recorded(simulator, PUSHES), simulator.nominal, STEP)
    assert "rather a model" not in str(wrong)
    many = replace(wrong, spans=tuple(replace(span, first=0, last=700) for span in wrong.spans))
    assert "rather a model" in str(many)


def test_rows_around_a_contact_are_left_out_on_both_sides(simulator, monkeypatch):
    """A contact in one row takes as many rows before it as after it."""
    trajectories = recorded(simulator, {})
    touching = np.zeros(len(trajectories), dtype=bool)
    touching[100] = True
    monkeypatch.setattr(simulator, "in_contact", lambda segments: touching)
    free = disturbances._away_from_contacts(simulator, trajectories, 2)
    assert list(np.flatnonzero(~free)) == [98, 99, 100, 101, 102]
