"""A whole run in windows that follow each other."""

import numpy as np

from dropo.evaluation.held_out import DataPart, whole_part
from dropo.evaluation.whole_run import RunSettings, whole_run
from tests.models.predicted_slide import TRUTH, problem


def test_it_is_what_the_simulator_says():
    """From each window's measured start, the last window shorter; no step is counted."""
    one = problem(trajectories=2)
    data = one.trajectories
    other = np.array([3.0, 0.2])
    before = one.simulator.steps
    found = whole_run(one, one.simulator, whole_part(data), (other, TRUTH), 8)
    assert one.simulator.steps == before
    assert (found.trajectory, found.length, len(found.measured)) == (0, 8, 30)
    np.testing.assert_array_equal(found.rows, data.next_observations[:30])
    for line, values in ((found.before, other), (found.after, TRUTH)):
        for start, length in ((8, 8), (24, 6)):
            window = data.from_rows(np.array([start]), length, every_step=True)
            wanted = one.simulator.predict(values[None], window)[0]
            np.testing.assert_array_equal(line[start : start + length], wanted)
    assert (
        np.abs(found.measured - found.after).max()
        < 0.1 * np.abs(found.measured - found.before).max()
    )


def test_which_run_and_how_much():
    """One with rows held out; no more steps than the settings say; once from the start where only
    starts are measured.
    """
    one = problem(trajectories=3)
    data = one.trajectories
    part = DataPart(data, data.trajectory, data.trajectory == 2)
    small = RunSettings(numbers=40)
    found = whole_run(one, one.simulator, part, (TRUTH, TRUTH), 8, small)
    assert (found.trajectory, len(found.measured)) == (2, 20)
    assert found.held_out.all()
    whole = whole_run(
        problem(trajectories=3, reset="start"), one.simulator, part, (TRUTH, TRUTH), 8
    )
    assert whole.length == 30
