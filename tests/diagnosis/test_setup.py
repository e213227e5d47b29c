"""The extended problem is the model that was evaluated."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.services import registry
from dropo.diagnosis.search.library import instances_for
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.setup import SearchSetup, extended_problem
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


def _own_drag(robot):
    size = Quantity("drag", "N m s/rad", 0.0, 10.0, probes=(0.1,))
    return [EffectInstance("own_drag", "elbow", (size,), force=lambda state, _: 0 * state.qvel)]


@pytest.mark.parametrize("far_off", [False, True])
def test_effects_of_plugins_that_were_not_looked_for_are_named(far_off, monkeypatch):
    """Whole motions are fitted by known effects alone; a search by windows looks for all."""
    given = problem([], name="position-arm", seed=3000)
    explained = SimpleNamespace(warnings=()) if far_off else None
    library = Library(given.simulator, (), len(given.space))
    nominal = np.array(given.simulator.nominal)
    last = SimpleNamespace(theta=nominal, free=np.array([], dtype=np.int64), accepted=())
    none = (None, None, None, np.array([], dtype=np.int64), 0, ())
    setup = SearchSetup(given, explained, library, *none)
    assert setup.warnings_of(last) == ()
    monkeypatch.setitem(registry._registered["effects"], "own_drag", _own_drag)
    said = setup.warnings_of(last)
    assert len(said) == far_off
    if far_off:
        assert "plug-ins were not looked for: own_drag. Diagnose the extended problem" in said[0]
