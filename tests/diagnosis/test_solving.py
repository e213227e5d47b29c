"""What a search refuses at its end."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis import solving
from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.search.review import reviews_so_far
from dropo.diagnosis.search.whitening import WhitenessSettings, white
from dropo.diagnosis.setup import SearchedEffects, SearchSetup
from dropo.diagnosis.solving import MAY_BE_NOTHING, that_may_be_nothing, without_worse
from tests.models.linear_mass import instances, measured, selection

LEVEL = 0.98


def searched(hidden, accepted):
    """The end of a search that accepted these effects, of data in which those are."""
    search, first = selection(measured(hidden))
    added = [one for one in instances() if one.effect in accepted]
    theta = first.theta.copy()
    last = search.polish(search.try_set(first, theta, (), added))
    return search.library, SearchedEffects(first, last, reviews_so_far(search, last))


@pytest.mark.parametrize(
    ("gained", "present", "kept"), [(90.0, True, True), (110.0, True, False), (110.0, False, True)]
)
def test_what_forces_explain_better_is_no_noise_of_sensors(monkeypatch, gained, present, kept):
    """Errors that follow each other gain 100 nats on windows held out; forces that nothing explains
    gain less, more, or nothing that is sure.
    """
    search, first = selection(measured({}))
    found = white(first.train.whiten.sigma)
    setup = SearchSetup(None, None, search.library, search, None, None, None, 0, ())
    monkeypatch.setattr(solving, "other_noise", lambda *given: found)
    monkeypatch.setattr(solving, "impulses_of", lambda library: ["force"])
    monkeypatch.setattr(solving, "gain_of", lambda *given: (100.0, 5.0))
    forces = SimpleNamespace(present=present, gain=gained)
    monkeypatch.setattr(solving, "unexplained_force", lambda *given: forces)
    noise = solving._noise_of_sensors(setup, first, WhitenessSettings())
    assert noise is (found if kept else None)


def test_an_effect_whose_size_may_be_0_is_refused():
    """A bias beside the damping that is there; it is said why."""
    library, found = searched({"damping": 0.2}, ("damping", "bias"))
    label, leader = that_may_be_nothing(library, found, LEVEL)
    assert label == "bias:mass"
    assert (leader.effect, leader.why) == ("bias", "its size may be 0")
    assert "not accepted" in leader.sentence


@pytest.mark.parametrize(
    ("gain", "why", "most", "goes_on"),
    [
        (200.0, MAY_BE_NOTHING, 6, False),  # no more than one that was refused as nothing
        (300.0, MAY_BE_NOTHING, 6, True),
        (200.0, "errors are larger", 6, True),
        (300.0, MAY_BE_NOTHING, 1, False),  # after so many
    ],
)
def test_others_in_the_place_of_nothing_are_not_looked_for(monkeypatch, gain, why, most, goes_on):
    """One that explained 250 nats and may be nothing went before."""
    search, _ = selection(measured({"damping": 0.2}))
    library, found = searched({"damping": 0.2}, ("damping", "bias"))
    label, leader = that_may_be_nothing(library, found, LEVEL)
    earlier = {"spring:mass": replace(leader, gain=250.0)}
    setup = SearchSetup(None, None, library, search, None, None, None, 0, (), worse=earlier)
    asked = []

    def explain(setup, first, begun):
        asked.append(begun)
        return begun, {}

    monkeypatch.setattr(solving, "explain", explain)
    latest = replace(leader, gain=gain, why=why)
    setup, after = without_worse(setup, found, label, latest, most)
    assert len(asked) == goes_on
    assert label not in {one.label for one in after.last.accepted}
    assert set(setup.worse) == {"spring:mass", label}


def test_a_small_change_of_the_model_must_be_twice_as_certain(monkeypatch):
    """A damping 3.5 errors from 0; a control where it is 7, and one where the model has none."""
    library, found = searched({"damping": 0.2}, ("damping",))
    error = standard_errors(library, found.last)[0][-1]
    library, near = searched({"damping": 3.5 * error}, ("damping",))
    _, far = searched({"damping": 7 * error}, ("damping",))
    assert that_may_be_nothing(library, near, LEVEL) is None
    monkeypatch.setattr(solving, "totals_of", lambda _library, theta, _accepted: theta + 1e3)
    assert that_may_be_nothing(library, near, LEVEL)[0] == "damping:mass"
    assert that_may_be_nothing(library, far, LEVEL) is None


def test_few_degrees_of_freedom_excuse_what_is_new_alone(monkeypatch):
    """A bias that may be nothing, whose error has two: refused as a change of what the model has,
    left alone as what it has not.
    """
    library, found = searched({"damping": 0.2}, ("damping", "bias"))
    errors = standard_errors(library, found.last)[0]
    monkeypatch.setattr(solving, "standard_errors", lambda *_: (errors, np.full(len(errors), 2.0)))
    assert that_may_be_nothing(library, found, LEVEL) is None
    monkeypatch.setattr(solving, "totals_of", lambda _library, theta, _accepted: theta + 1e-9)
    assert that_may_be_nothing(library, found, LEVEL)[0] == "bias:mass"


def test_of_a_size_and_a_shape_the_size_counts():
    """A bias that may be nothing beside a shape that is certain: refused as one effect of both if
    the first is its size; the control: left alone as two sizes.
    """
    library, found = searched({"damping": 0.2}, ("damping", "bias"))
    bias, damping = sorted(found.last.accepted, key=lambda one: one.effect)
    both = replace(bias, quantities=(*bias.quantities, *damping.quantities), trials=())
    indices = np.concatenate([library.indices_of[one.label] for one in (bias, damping)])
    library.indices_of[both.label] = indices
    for scaled in (True, False):
        one = replace(both, scaled=scaled)
        end = replace(found, last=replace(found.last, accepted=(one,)))
        unsure = that_may_be_nothing(library, end, LEVEL)
        assert (unsure is not None) is scaled


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
