"""Screening, refitting and accepting effects, on a line of masses."""

import numpy as np
import pytest

from dropo.diagnosis.causes import estimate
from dropo.diagnosis.invariance import invariance
from dropo.diagnosis.omnibus import omnibus
from dropo.diagnosis.screening import Screening
from dropo.diagnosis.selection import ambiguity, gain_of
from tests.diagnosis.toy import EFFECTS, atoms, measured, selection

SIZES = {"damping": 0.05, "spring": -0.05, "bias": 0.02, "gain": -0.05, "friction": 0.03, "drag": 0.03}


@pytest.mark.parametrize("declared", [False, True])
@pytest.mark.parametrize("name", SIZES)
def test_hidden_effect_is_found(name, declared):
    """The screening ranks it first, the refit finds its size within four standard errors, and it alone is accepted; beside a declared
    parameter that does the same, nothing is needed."""
    search, first = selection(measured({name: SIZES[name]}), declared)
    if declared and name == "gain":
        assert len(search.run(first, atoms())) == 1
        return
    screened = Screening(search.library)(first.train, first.free, atoms())
    assert screened[0].atom.effect == name
    states = search.run(first, atoms())
    last = search.backward(states[-1])
    assert [atom.effect for atom in last.accepted] == [name]
    told = estimate(search.library, last, last.accepted[0])["size"]
    assert abs(told["value"] - SIZES[name]) < 4 * told["se"] < 0.5 * abs(SIZES[name])
    assert gain_of(states[0].test, last.test)[0] > 20


def test_nothing_hidden_nothing_named():
    """Thirty data sets without anything hidden, noise between 1e-4 and 1e-2: no effect is accepted in any, though six are tried."""
    named = 0
    for seed in range(30):
        search, first = selection(measured({}, sigma=10 ** (-4 + seed / 15), seed=seed))
        named += len(search.run(first, atoms())) > 1
    assert named == 0


def test_two_effects():
    """Both are found, one after the other, and no third."""
    search, first = selection(measured({"damping": 0.2, "spring": 0.3}))
    last = search.run(first, atoms())[-1]
    assert {atom.effect for atom in last.accepted} == {"damping", "spring"}


def test_noise_is_learned():
    """sigma within 10 % where the guess was twice too large (500 numbers on each side: four standard errors are 13 %)."""
    _, first = selection(measured({}, sigma=1e-3))
    np.testing.assert_allclose(first.train.whiten.sigma, 1e-3, rtol=0.13)


def test_backward_takes_out_what_became_unnecessary():
    """A first guess that a better one replaces does not stay: friction by itself, then the damping that it stood for."""
    search, first = selection(measured({"damping": 0.2}))
    friction = next(c for c in search.screening(first.train, first.free, atoms()) if c.atom.effect == "friction")
    wrong = search.polish(search._try(first, friction, None).state)
    damping = next(c for c in search.screening(wrong.train, wrong.free, atoms()) if c.atom.effect == "damping")
    both = search.polish(search._try(wrong, damping, None).state)
    assert [atom.effect for atom in both.accepted] == ["friction", "damping"]
    assert [atom.effect for atom in search.backward(both).accepted] == ["damping"]


def test_alike_effects_are_said_to_be():
    """Of two effects that do the same, one is named and the other is in its ambiguity set; effects that differ are not."""
    twin = {"damping", "drag"}
    data = measured({"damping": 0.1}, sigma=0.03)
    search, first = selection(data)
    search.run(first, atoms())
    winner = search.rounds[0][0]
    assert winner.candidate.atom.effect in twin
    others = {c.atom.effect for c, _ in ambiguity(winner, search.rounds[0], search.screened[0])}
    clear, first = selection(measured({"damping": 0.1}))
    clear.run(first, atoms())
    told = ambiguity(clear.rounds[0][0], clear.rounds[0], clear.screened[0])
    assert not told
    assert others <= set(EFFECTS) - {winner.candidate.atom.effect}


@pytest.mark.parametrize(("hidden", "constant"), [("damping", True), ("friction", False)])
def test_size_of_a_proxy_differs_between_regimes(hidden, constant):
    """Damping has one size in all regimes where it is the cause; friction taken for damping has not."""
    search, first = selection(measured({hidden: 0.2}), effects=("damping", "bias"))
    last = search.run(first, atoms(("damping", "bias")))[-1]
    assert last.accepted[0].effect == "damping"
    found = invariance(search.library, last.test, last.accepted[0])
    assert found.constant == constant


def test_structure_that_remains_is_seen():
    """With drag hidden and not looked for, state and command predict residuals; with nothing hidden they do not, in twenty data sets."""
    _, first = selection(measured({"drag": 0.2}), effects=("bias",))
    assert omnibus(first.train, first.test, np.random.default_rng(0)).present
    alarms = 0
    for seed in range(20):
        _, first = selection(measured({}, seed=seed), effects=("bias",))
        alarms += omnibus(first.train, first.test, np.random.default_rng(0)).present
    assert alarms <= 1
