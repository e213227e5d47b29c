"""A search in a larger library keeps what it knows, with places for what is new."""

from dataclasses import replace

import numpy as np

from dropo.diagnosis.laws.extension import extended
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import Batch
from tests.models.linear_mass import EFFECTS, Mass, instances, measured, selection


def test_batches_that_are_no_longer_listed_are_padded_too():
    """Those that effects were accepted from, which may be copies of the search's own."""
    search, first = selection(measured({"damping": 0.2}), effects=("damping", "bias"))
    batch = Batch(first, [], [])
    search.batches = [batch]
    search.origins = {"damping:mass": replace(batch), "bias:mass": batch}
    own = extended(search, Library(Mass(), instances(), 0))
    for one in (*own.batches, *own.origins.values()):
        assert len(one.before.theta) == len(EFFECTS)
        assert np.all(one.before.theta[2:] == 0)
    assert own.origins["bias:mass"] is own.batches[0]
