"""A distribution's parameters are a simulator's own, or magnitudes of effects that it gets."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.services.errors import UnknownName
from dropo.training.binding import bind
from dropo.training.distributions import Point
from tests.models.hidden_in_arm import UPPER, instance, problem


@pytest.fixture(scope="module")
def arm():
    """A simulator of an arm with a declared mass, and a short recording of it."""
    found = problem([], parameters=[UPPER], episodes=1, steps=12)
    return found.simulator, found.trajectories


def test_magnitudes_of_effects_are_bound_by_their_names(arm):
    """A distribution over an effect's size and the mass: both are set, in whichever order; the
    motion is that of a simulator with that effect, and what is not drawn is nominal.
    """
    plain, data = arm
    effect = instance(plain, "joint_damping:elbow")
    extended = plain.with_effects([effect])
    mass, damping = extended.space.names
    both = Point(extended.space, np.array([1.2, 0.3]))
    bound, fill = bind(plain, both, "the arm")
    assert bound.space.names == extended.space.names
    np.testing.assert_array_equal(fill(np.array([[1.2, 0.3]])), [[1.2, 0.3]])
    alone = type(extended.space)([p for p in extended.space if p.name == damping])
    bound, fill = bind(plain, Point(alone, np.array([0.3])), "the arm")
    filled = fill(np.array([[0.3]]))
    np.testing.assert_array_equal(filled, [[plain.nominal[0], 0.3]])
    segments = data.segments(5)
    np.testing.assert_array_equal(
        bound.predict(filled, segments), extended.predict(filled, segments)
    )
    fixed = plain.with_effects((), [(effect, np.array([0.3]))])
    same = fixed.predict(np.asarray(plain.nominal)[None], segments)
    np.testing.assert_allclose(bound.predict(filled, segments), same, atol=1e-12)
    assert mass == "upper_mass"


def test_what_a_simulator_has_not_is_refused(arm):
    """An effect at a place that it has not, and a name that is none of its parameters."""
    plain, _ = arm
    extended = plain.with_effects([instance(plain, "joint_damping:elbow")])
    (parameter,) = [p for p in extended.space if "/" in p.name]
    for name, told in (
        (parameter.name.replace("elbow", "wrist"), "effect in the arm called 'joint_damping:wrist"),
        ("upper_mas", "Did you mean 'upper_mass'"),
        ("jointdamping:elbow/damping", "parameter of the arm called 'jointdamping:elbow/damp"),
    ):
        space = type(extended.space)([replace(parameter, name=name)])
        with pytest.raises(UnknownName, match=told):
            bind(plain, Point(space, np.array([0.1])), "the arm")
