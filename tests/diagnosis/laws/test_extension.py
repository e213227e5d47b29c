"""A search in a larger library keeps what it knows, with places for what is new."""

from dataclasses import replace

import numpy as np

from dropo.diagnosis.laws.extension import extended, places_of_laws, with_laws
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import Batch
from dropo.effects.law import law_instance
from dropo.problems.simulated.robots import simulated_robot
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


def test_a_law_has_its_place_though_a_search_took_it_out():
    """A second one there would have its name."""
    simulator = simulated_robot("torque-arm").simulator
    law = law_instance(simulator.effect_context, "elbow", "-c * v")
    plain = Library(simulator, [], len(simulator.space))
    assert places_of_laws(plain) == set()
    assert places_of_laws(with_laws(plain, [law])) == {"elbow"}
