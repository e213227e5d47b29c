"""The extended problem is the model that was evaluated."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis.search.library import instances_for
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.setup import extended_problem
from tests.models.hidden_in_arm import problem


@pytest.mark.parametrize("first", [0, 1])
def test_two_changes_of_one_body_act_as_in_the_search(first):
    """A body's mass and what it carries, in whatever order they were accepted."""
    given = problem([], name="position-arm", seed=3000)
    labels = ["payload:stick", "body_mass:stick"]
    instances = instances_for(given, labels, np.array([], dtype=np.int64))
    library = Library(given.simulator.with_effects(instances), instances, len(given.space))
    theta = np.array(library.simulator.nominal)
    for instance in instances:
        sizes = [0.4, 0.05, 0.02, 0.1] if instance.effect == "payload" else [-0.4]
        theta[library.indices_of[instance.label]] = sizes
    accepted = (instances[first], instances[1 - first])
    extended = extended_problem(given, library, SimpleNamespace(theta=theta, accepted=accepted))
    declared = theta[None, : len(given.space)]
    segments = given.segments
    np.testing.assert_array_equal(
        extended.simulator.predict(declared, segments),
        library.simulator.predict(theta[None], segments),
    )
