"""What regression is certain of begins a search, where windows held out confirm it."""

import numpy as np
import pytest

from dropo.diagnosis.search.confirmation import is_confirmed
from dropo.diagnosis.search.known_causes import begin_with
from tests.models.linear_mass import instances, measured, selection

HIDDEN = {"damping": 0.2, "spring": 0.3}


def begun(hidden, known):
    """A search, the model as it is, and the one that it begins with."""
    search, first = selection(measured(hidden))
    of_name = {instance.effect: instance for instance in instances()}
    sizes = [(of_name[name], np.array([size])) for name, size in known.items()]
    return search, first, begin_with(search, first, instances(), sizes)


@pytest.mark.parametrize("known", [{"damping": 0.1, "spring": 0.2}, {"damping": 1e9, "spring": 0}])
def test_both_are_there_at_once(known):
    """From sizes that are off by half, or beyond their bounds; each has the batch in which others
    were tried in its place, which is what its ambiguity set is made of.
    """
    search, _, state = begun(HIDDEN, known)
    assert [one.effect for one in state.accepted] == list(known)
    for instance in state.accepted:
        size = state.theta[search.library.indices_of[instance.label]][0]
        assert size == pytest.approx(HIDDEN[instance.effect], rel=0.05)
        batch = search.origins[instance.label]
        assert instance not in batch.before.accepted
        tried = [trial.candidate.instance.label for trial in batch.trials]
        assert instance.label in tried
        assert len(tried) > 1


@pytest.mark.parametrize(("hidden", "known"), [({}, {"damping": 0.2}), (HIDDEN, {})])
def test_what_windows_do_not_confirm_is_left_to_the_search(hidden, known):
    """Nothing is missing though regression says so; or it says nothing."""
    search, first, state = begun(hidden, known)
    assert state is first
    assert search.origins == {}


def test_one_effect_that_explains_more_is_left_to_the_search():
    """Regression has friction in the place of damping, which windows held out would confirm."""
    hidden = {"damping": 0.2}
    search, first, state = begun(hidden, {"friction": 0.1})
    assert state is first
    of_name = {instance.effect: instance for instance in instances()}
    theta = first.theta.copy()
    theta[search.library.indices_of[of_name["friction"].label]] = 0.1
    wrong = search.polish(search.try_set(first, theta, (), (of_name["friction"],), scanned=()))
    needed = search.settings.needed_gain(len(instances()))
    assert is_confirmed(first.test, wrong.test, needed, search.settings)
