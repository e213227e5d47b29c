"""Screening, refitting and accepting effects, on a line of masses."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.support.time_profile import growing, setting_in
from dropo.diagnosis.findings.causes import estimate, standard_errors
from dropo.diagnosis.findings.remains.omnibus import omnibus
from dropo.diagnosis.search.confirmation import gain_of, is_confirmed
from dropo.diagnosis.search.invariance import invariance
from dropo.diagnosis.search.plausibility import Plausibility
from dropo.diagnosis.search.review import ambiguity, review
from dropo.diagnosis.search.screening import Candidate, Screening, with_constant
from dropo.diagnosis.search.trials import Batch
from tests.models.linear_mass import instances, measured, selection

SELECTION = "dropo.diagnosis.search.selection"
SIZES = {
    "damping": 0.05,
    "spring": -0.05,
    "bias": 0.02,
    "gain": -0.05,
    "friction": 0.03,
    "drag": 0.03,
}


@pytest.mark.parametrize("declared", [False, True])
@pytest.mark.parametrize("name", SIZES)
def test_hidden_effect_is_found(name, declared):
    """The screening ranks it first, the refit finds its size within four standard errors, and it
    alone is accepted; beside a declared parameter that does the same, nothing is needed.
    """
    search, first = selection(measured({name: SIZES[name]}), declared)
    if declared and name == "gain":
        assert search.run(first, first, instances()) is first
        return
    screened = Screening(search.library, search.floor)(first.train, first.free, instances())
    assert screened[0].instance.effect == name
    last, _ = review(search, search.run(first, first, instances()))
    assert [instance.effect for instance in last.accepted] == [name]
    errors = np.zeros(len(last.theta))
    errors[last.free] = standard_errors(search.library, last)[0]
    told = estimate(search.library, last, last.accepted[0], errors)["size"]
    assert abs(told.value - SIZES[name]) < 4 * told.se < 0.5 * abs(SIZES[name])
    assert gain_of(first.test, last.test)[0] > 20


def test_nothing_hidden_nothing_named():
    """Thirty data sets without anything hidden, noise between 1e-4 and 1e-2: no effect is accepted
    in any, though six are tried.
    """
    named = 0
    for seed in range(30):
        search, first = selection(measured({}, sigma=10 ** (-4 + seed / 15), seed=seed))
        named += search.run(first, first, instances()) is not first
    assert named == 0


def test_two_effects():
    """Both are found, one after the other, and no third."""
    search, first = selection(measured({"damping": 0.2, "spring": 0.3}))
    last = search.run(first, first, instances())
    assert {instance.effect for instance in last.accepted} == {"damping", "spring"}


@pytest.mark.parametrize(("size", "found"), [(0.2, True), (0.003, False)])
def test_trials_that_a_wrong_noise_holds_up_are_fitted_to_the_end(monkeypatch, size, found):
    """No trial is confirmed as it is: one that leaves far less noise is fitted to the end before
    the search gives up, another is not.
    """
    search, first = selection(measured({"damping": size}))
    assert search.step(first, instances(), first).accepted[0].effect == "damping"
    tried = search.try_candidates
    trials = []
    monkeypatch.setattr(
        search, "try_candidates", lambda *asked: trials.extend(more := tried(*asked)) or more
    )
    as_they_are = lambda after: any(trial.state.test is after for trial in trials)
    monkeypatch.setattr(
        "dropo.diagnosis.search.selection.is_confirmed",
        lambda *asked: not as_they_are(asked[1]) and is_confirmed(*asked),
    )
    last = search.step(first, instances(), first)
    assert (last is not None) == found
    assert not found or (
        [instance.effect for instance in last.accepted],
        search.origins["damping:mass"].trials,
    ) == (["damping"], trials)


@pytest.mark.parametrize(
    ("surplus", "better", "named"),
    [(100.0, 100.0, "damping"), (10.0, 100.0, "spring"), (100.0, 1.0, "spring")],
)
def test_what_fits_to_the_end_bring_decides(monkeypatch, surplus, better, named):
    """A rival that promised 50 nats less is taken where a fit to the end brings more than that, and
    the rival is the better one then; a control brings less, another's rival is hardly better.
    """
    search, first = selection(measured({"damping": 0.2}))
    screened, _ = search.screen(first, instances())
    candidates = [one for one in screened if one.instance.effect in ("spring", "damping")]
    trials = search.try_candidates(first, candidates)
    search.batches.append(Batch(first, screened, trials))
    spring, damping = sorted(trials, key=lambda one: one.candidate.instance.effect, reverse=True)
    promised = damping.fitted_gain + damping.penalized_gain - spring.penalized_gain + 50.0
    spring = replace(spring, fitted_gain=spring.fitted_gain + promised - damping.fitted_gain)
    assert spring.penalized_gain - damping.penalized_gain == pytest.approx(50.0)
    fitted = {"spring": surplus, "damping": surplus + better}
    as_tried = [spring.state, damping.state]
    monkeypatch.setattr(search, "polish", replace)
    monkeypatch.setattr(f"{SELECTION}.is_confirmed", lambda *asked: True)
    monkeypatch.setattr(
        f"{SELECTION}.penalized_log_likelihood",
        lambda state: 0.0 if state in as_tried else fitted[state.accepted[-1].effect],
    )
    found = search._accept_first(first, [spring, damping], 0.0)
    assert [one.effect for one in found.accepted] == [named]
    assert search.origins[f"{named}:mass"].trials == trials


def test_what_sets_in_at_an_end_of_the_data_is_not_taken(monkeypatch):
    """However much it explains; the control is what is taken where nothing sets in."""
    search, first = selection(measured({"damping": 0.2}))
    assert search.step(first, instances(), first) is not None
    at_an_end = "dropo.diagnosis.search.selection.sets_in_at_an_end"
    monkeypatch.setattr(at_an_end, lambda instance, magnitudes: True)
    assert search.step(first, instances(), first) is None


def test_noise_is_learned():
    """sigma within 10 % where the guess was twice too large (500 numbers on each side: four
    standard errors are 13 %).
    """
    _, first = selection(measured({}, sigma=1e-3))
    np.testing.assert_allclose(first.train.whiten.sigma, 1e-3, rtol=0.13)


def added(search, state, effect, other="damping"):
    """The state with one more effect, whether it is the best or not, with an alternative."""
    screened = search.screening(state.train, state.free, instances())
    chosen = [
        c
        for c in screened
        if c.instance.effect in (effect, other) and c.instance not in state.accepted
    ]
    search.batches.append(origin := Batch(state, screened, search.try_candidates(state, chosen)))
    trial = next(t for t in origin.trials if t.candidate.instance.effect == effect)
    search.origins[trial.candidate.instance.label] = origin
    return search.polish(trial.state)


def test_review_takes_out_what_became_unnecessary():
    """A first guess that a better one replaces does not stay: friction by itself, then the damping
    that it stood for.
    """
    search, first = selection(measured({"damping": 0.2}))
    both = added(search, added(search, first, "friction"), "damping")
    assert [instance.effect for instance in both.accepted] == ["friction", "damping"]
    last, found = review(search, both)
    assert [instance.label for instance in last.accepted] == list(found) == ["damping:mass"]


def test_review_exchanges_a_first_guess_that_another_beats():
    """Friction taken for damping while a spring was missing: once the spring is there, damping
    takes its place; the right ones stay.
    """
    search, first = selection(measured({"damping": 0.2, "spring": 0.3}))
    wrong = added(search, added(search, first, "friction"), "spring")
    last, _ = review(search, wrong)
    assert {instance.effect for instance in last.accepted} == {"damping", "spring"}
    assert review(search, last)[0] is last


@pytest.mark.parametrize("begun", ["damping", "drag"])
@pytest.mark.parametrize(
    ("odds", "sigma", "named"),
    [
        ({"drag": -2.0}, 0.03, "damping"),
        ({"damping": -2.0}, 0.03, "drag"),
        ({"damping": -0.5}, 0.03, "damping"),
        ({"damping": -2.0}, 0.01, "damping"),
    ],
)
def test_review_takes_the_more_usual_of_two_alike(odds, sigma, named, begun):
    """Whichever was accepted first, as long as data tell them apart by few nats (13 here); where
    the odds are nearly the same or data tell more (73), these decide.
    """
    search, first = selection(measured({"damping": 0.05, "spring": 0.3}, sigma=sigma))
    usual = Plausibility(odds, others=0.0)
    settings = replace(search.settings, plausibility=usual, polished_fraction=0.5)
    search = replace(search, settings=settings)
    other = "drag" if begun == "damping" else "damping"
    start = added(search, added(search, first, "spring"), begun, other)
    last, _ = review(search, start)
    assert {instance.effect for instance in last.accepted} == {named, "spring"}


def test_alike_effects_are_said_to_be():
    """Of two effects that noise hides the difference of, one is named and the other is in its
    ambiguity set; where they differ, none is.
    """
    others = []
    for size, sigma in ((0.1, 0.03), (0.1, 1e-3)):
        search, first = selection(measured({"damping": size}, sigma=sigma))
        last, found = review(search, search.run(first, first, instances()))
        assert last.accepted[0].effect in ("damping", "drag")
        others.append(
            {
                other.instance.effect
                for _, other, _ in ambiguity(last, last.accepted[0], found[last.accepted[0].label])
            }
        )
    assert others[0] & {"damping", "drag", "friction"}
    assert not others[1]


@pytest.mark.parametrize(("hidden", "constant"), [("damping", True), ("friction", False)])
def test_size_of_a_proxy_differs_between_regimes(hidden, constant):
    """Damping has one size in all regimes where it is the cause; friction taken for damping has
    not.
    """
    search, first = selection(measured({hidden: 0.2}), effects=("damping", "bias"))
    last = search.run(first, first, instances(("damping", "bias")))
    assert last.accepted[0].effect == "damping"
    found = invariance(search.library, last.test, last.accepted[0])
    assert found.constant == constant


def test_structure_that_remains_is_seen():
    """With drag hidden and not looked for, state and command predict residuals; with nothing hidden
    they do not, in twenty data sets.
    """
    _, first = selection(measured({"drag": 0.2}), effects=("bias",))
    assert omnibus(first.train, first.test, np.random.default_rng(0)).present
    alarms = 0
    for seed in range(20):
        _, first = selection(measured({}, seed=seed), effects=("bias",))
        alarms += omnibus(first.train, first.test, np.random.default_rng(0)).present
    assert alarms <= 1


def test_what_is_always_there_is_tried_before_what_sets_in():
    """With the size that was promised, once, also where a screening promised it less or nothing;
    the control: no effect, none added.
    """
    damping, spring = instances(("damping", "spring"))
    late = setting_in(damping)
    grown = growing(damping)
    promised = [
        Candidate(late, np.array([0.4, -0.45]), 900.0, np.ones(1)),
        Candidate(spring, np.array([0.1]), 20.0, np.ones(1)),
    ]
    tried = with_constant(
        [*promised, Candidate(grown, np.array([0.2]), 9.0, np.ones(1))], [damping, spring]
    )
    assert [candidate.instance for candidate in tried] == [damping, late, spring, grown]
    assert tried[0].magnitudes.tolist() == [0.4]
    moved_up = with_constant(
        [*promised, Candidate(damping, np.array([0.3]), 9.0, np.ones(1))], [damping, spring]
    )
    assert [candidate.instance for candidate in moved_up] == [damping, late, spring]
    assert with_constant(promised, [spring]) == promised
