"""The order of trials of which several are good."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis.search.trials import commonest_first
from tests.models.linear_mass import instances


@pytest.mark.parametrize(("better", "first"), [(3.0, 1), (30.0, 2)])
def test_fewer_numbers_where_windows_held_out_do_not_tell(better, first):
    """One that needs two numbers comes first only where it is clearly better on data that it was
    not fitted to.
    """
    linearize = lambda gain: SimpleNamespace(
        log_likelihood=np.full(10, gain / 10), windows=SimpleNamespace(block=np.arange(10))
    )
    trial = lambda numbers, gain: SimpleNamespace(
        candidate=SimpleNamespace(signature=np.eye(2)[numbers - 1], instance=instances()[numbers]),
        magnitudes=np.ones(numbers),
        penalized_gain=gain,
        state=SimpleNamespace(test=linearize(gain)),
    )
    trials = commonest_first([trial(2, 100 + better), trial(1, 100.0)])
    assert len(trials[0].magnitudes) == first
