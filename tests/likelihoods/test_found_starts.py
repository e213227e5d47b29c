"""Runs begin in the start states that were found, which follow the parameters."""

from dataclasses import replace

import numpy as np

from dropo.likelihoods.support.runs.found_starts import FoundStarts
from dropo.likelihoods.support.runs.linearization import Observed
from dropo.simulators.toy import SlidingBlock, simulate

VALUE = np.array([1.0, 0.5])
OTHER = np.array([1.4, 0.3])


def test_starts_are_moved_and_follow_the_parameters():
    """As from data whose first rows are at the moved starts, position alone being compared; each
    piece around a value of its own, too.
    """
    block = SlidingBlock()
    forces = np.random.default_rng(0).normal(size=(2, 6, 1))
    data = simulate(block, np.tile(VALUE, (2, 1)), forces, np.zeros(2))
    segments = data.segments(reset="start")
    observed = Observed(block, np.array([True, False]), np.array([True, True]))
    starts = np.array([[0.1, -0.2], [0.3, 0.4]])
    by_value = np.random.default_rng(1).normal(size=(2, 2, 2))
    rows = segments.steps[:, 0]
    assert rows.tolist() == [0, 6]
    for centre in (VALUE, np.array([VALUE, OTHER])):
        found = FoundStarts(observed, rows, starts, by_value, centre)
        assert [signal.name for signal in found.signals] == [block.signals[0].name]
        assert found.start_size == 2
        values = np.array([VALUE, OTHER])
        predicted = found.predict(values, segments)
        for k, value in enumerate(values):
            own = np.broadcast_to(centre, (2, 2))
            moved = starts + np.einsum("psd,pd->ps", by_value, value - own)
            observations = data.observations.copy()
            observations[rows] += moved
            shifted = replace(data, observations=observations).segments(reset="start")
            expected = block.predict(value[None], shifted)[0][:, [0]]
            np.testing.assert_allclose(predicted[k], expected, atol=1e-12)
        further = np.full((2, 2, 2), 0.05)
        again = found.predict(values, segments, offsets=further)
        plain = block.predict(VALUE[None], segments)[0][:, [0]]
        assert np.abs(again - predicted).max() > 0.04
        assert np.abs(predicted[0] - plain).max() > 0.05
    np.testing.assert_array_equal(found.targets(segments), block.targets(segments)[:, [0]])
