"""What a search refuses at its end."""

from types import SimpleNamespace

from dropo.diagnosis.search.review import reviews_so_far
from dropo.diagnosis.setup import SearchedEffects
from dropo.diagnosis.solving import that_may_be_nothing
from tests.models.linear_mass import instances, measured, selection

LEVEL = 0.98


def searched(hidden, accepted):
    """The end of a search that accepted these effects, of data in which those are."""
    search, first = selection(measured(hidden))
    added = [one for one in instances() if one.effect in accepted]
    theta = first.theta.copy()
    last = search.polish(search.try_set(first, theta, (), added))
    return search.library, SearchedEffects(first, last, reviews_so_far(search, last))


def test_an_effect_whose_size_may_be_0_is_refused():
    """A bias beside the damping that is there; it is said why."""
    library, found = searched({"damping": 0.2}, ("damping", "bias"))
    label, leader = that_may_be_nothing(library, found, LEVEL)
    assert label == "bias:mass"
    assert (leader.effect, leader.why) == ("bias", "its size may be 0")
    assert "not accepted" in leader.sentence


def test_beside_declared_parameters_none_is_refused():
    """A size may only grow with them: the same end, whose first number is a declared one."""
    _, found = searched({"damping": 0.2}, ("damping", "bias"))
    declared = SimpleNamespace(declared=int(found.last.free[0]) + 1)
    assert that_may_be_nothing(declared, found, LEVEL) is None


def test_effects_that_are_there_are_not():
    """A control: damping and a spring that the data have; and a model without effects."""
    library, found = searched({"damping": 0.2, "spring": 0.3}, ("damping", "spring"))
    assert that_may_be_nothing(library, found, LEVEL) is None
    library, found = searched({"damping": 0.2}, ())
    assert that_may_be_nothing(library, found, LEVEL) is None
