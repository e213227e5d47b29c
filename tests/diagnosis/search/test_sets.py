"""Sets of effects in the place of the one that a search ended with, on a line of masses."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.search.aliases import AliasSettings, beside_numbers, beside_the_rest
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.diagnosis.search.review import Review, ambiguity, review
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.sets import SetSearch, _bounds, _scaled, gram_of
from dropo.diagnosis.search.trials import Batch
from tests.models.linear_mass import EFFECTS, instances, loaded_spring, measured, selection

HIDDEN = {"damping": 0.2, "spring": 0.3}


def forced(search, state, *names):
    """The state with these effects, whether they are the right ones or not."""
    by_name = {instance.effect: instance for instance in instances()}
    for name in names:
        candidate = Candidate(by_name[name], np.array([0.1]), 0.0, np.zeros(1))
        (trial,) = search.try_candidates(state, [candidate])
        search.batches.append(Batch(state, [], [trial]))
        state = search.polish(trial.state)
    return state


def names_of(state):
    """The effects of a state."""
    return {instance.effect for instance in state.accepted}


@pytest.mark.parametrize(
    "wrong", [("friction", "bias"), ("friction",), ("friction", "drag", "gain")]
)
def test_a_wrong_set_is_exchanged_at_once(wrong):
    """Two effects that act together, of which the set has none: whatever is there goes, once the
    review has taken out what became unnecessary.
    """
    search, first = selection(measured(HIDDEN))
    start = forced(search, first, *wrong)
    found, _ = review(search, SetSearch(search, first, instances()).run(start))
    assert names_of(found) == set(HIDDEN)
    sizes = [found.theta[search.library.indices_of[one.label]][0] for one in found.accepted]
    wanted = [HIDDEN[one.effect] for one in found.accepted]
    np.testing.assert_allclose(sizes, wanted, rtol=0.05)


@pytest.mark.parametrize("usual", ["friction", "damping"])
def test_a_less_usual_effect_needs_a_margin(usual):
    """One effect for another: where the one that is there is the more usual, the other must be
    better by the margin, which is out of reach here; the control is the other way round.
    """
    search, first = selection(measured({"damping": 0.2}))
    odds = Plausibility({usual: 0.0}, others=-5.0)
    search.settings = replace(search.settings, usual_margin=1e9, plausibility=odds)
    start = forced(search, first, "friction")
    assert names_of(SetSearch(search, first, instances()).run(start)) == {usual}


def test_the_right_set_stays():
    """Whatever else promises as much is not better when it is refitted; a round says so."""
    search, first = selection(measured(HIDDEN))
    start = forced(search, first, *HIDDEN)
    sets = SetSearch(search, first, instances())
    assert sets.run(start) is start
    assert len(sets.seen) <= 1 + sets.settings.refitted


def test_nothing_hidden_no_set():
    """Ten data sets without anything hidden: no pair is accepted."""
    for seed in range(10):
        search, first = selection(measured({}, seed=seed))
        assert SetSearch(search, first, instances()).run(first) is first


def test_the_gram_matrix_says_what_a_refit_does():
    """Of effects in which the motion is linear: both magnitudes and the gain, before any refit."""
    search, first = selection(measured(HIDDEN))
    by_name = {instance.effect: instance for instance in instances()}
    pool = [(by_name[name], np.array([0.1])) for name in HIDDEN]
    gram = gram_of(search.library, first, pool)
    both = gram.exchange((), (0, 1))
    np.testing.assert_allclose(np.concatenate(both.magnitudes), list(HIDDEN.values()), rtol=0.2)
    one = max(gram.exchange((), (i,)).promise for i in range(2))
    assert both.promise > one > gram.exchange((), ()).promise


def test_aliases_are_computed_beside_the_rest_of_a_set():
    """Without the part that damping explains, drag is another likeness of friction than alone: as
    least squares say.
    """
    search, first = selection(measured({"damping": 0.2, "friction": 0.1}))
    last, reviews = review(search, search.run(first, first, instances()))
    assert names_of(last) == {"damping", "friction"}
    compared = beside_the_rest(search.library, last, reviews, AliasSettings(nearly=0.0))
    similar = compared["friction:mass"].similar["drag:mass"]
    indices_of = search.library.indices_of
    columns = [indices_of[f"{name}:mass"] for name in ("friction", "drag", "damping")]
    rows = last.train.flat(
        search.library.jacobian(last.theta, np.concatenate(columns), last.train.windows)
    )
    friction, drag = rows[:2] - np.outer(rows[:2] @ rows[2], rows[2]) / (rows[2] @ rows[2])
    wanted = abs(friction @ drag) / np.linalg.norm(friction) / np.linalg.norm(drag)
    np.testing.assert_allclose(similar, wanted, rtol=0.05)
    assert ambiguity(last, last.accepted[0], compared["damping:mass"]) == []


def test_one_cause_alone_has_no_rest():
    """Nothing is simulated for it."""
    search, first = selection(measured({"damping": 0.2}))
    last, reviews = review(search, search.run(first, first, instances()))
    before = search.library.simulator.steps
    assert beside_the_rest(search.library, last, reviews) == reviews
    assert search.library.simulator.steps == before


def test_what_one_of_several_numbers_does_is_named(monkeypatch):
    """A load does what a bias does, and a stiffness what nothing else does."""
    monkeypatch.setitem(EFFECTS, "push", EFFECTS["bias"])
    effects = ("spring", "push", "damping", "bias")
    offered = [loaded_spring(), *instances(effects[2:])]
    data = measured({"spring": 0.3, "bias": 0.2})
    search, first = selection(data, effects=effects, offered=offered)
    (spring,) = (last := search.run(first, first, offered[:2])).accepted
    reviews = {spring.label: Review(first, None, ())}
    others = offered[2:]
    found = beside_numbers(search.library, last, reviews, [spring], others, 0.98)[spring.label]
    ((other, why),) = found.others
    assert other.effect == "bias"
    assert why.startswith("in the place of its load: similarity 1.000")


def test_what_has_a_size_and_a_shape_is_scaled_by_its_size():
    """Its multiples, and their bounds, which are 0 of what is nothing; the control: two sizes."""
    quantities = (
        Quantity("size", "1", 0.0, 4.0, (1.0,)),
        Quantity("shape", "1", -3.0, 3.0, (-1.0, 1.0)),
    )
    one = EffectInstance("shaped", "mass", quantities, scaled=True, trials=(((1.0, -1.0),),))
    shaped = np.array([1.0, -1.0])
    np.testing.assert_array_equal(_scaled(one, shaped, 2.0), [2.0, -1.0])
    np.testing.assert_array_equal(_scaled(replace(one, scaled=False), shaped, 2.0), [2.0, -2.0])
    assert _bounds(shaped[:1], np.array([0.0]), np.array([4.0])) == (0.0, 4.0)
    assert _bounds(np.zeros(1), np.array([0.0]), np.array([4.0])) == (0.0, 0.0)
