"""A search anew under other premises: noise that is not white, exact physics steps."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from dropo.diagnosis import solving
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.search.arithmetic import Arithmetic, ArithmeticAlternatives
from dropo.diagnosis.search.whitening import WhitenessSettings
from dropo.diagnosis.settings import DiagnosisSettings
from dropo.diagnosis.setup import SearchedEffects, SearchSetup
from dropo.mjmodel.options import integrator
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.studies.first_models.machines import (
    STEP,
    Design,
    MissingNumbers,
    built,
    first_model,
    measured,
    problem_of,
)
from tests.models.hidden_in_arm import problem

DESIGN = Design(("hinge y",), (0.3,), (0.6,), (30.0,), loaded=False, rate=0.02)
NUMBERS = np.array([[0.01], [0.2], [0.1]])
COARSE = 0.005  # [s]
EFFECTS = ("actuator_delay",)


@pytest.fixture
def faked(monkeypatch):
    """Searches whose ends are faked, under friction as it is."""
    monkeypatch.setattr(solving, "_with_other_friction", lambda setup, found: (setup, found))


def setup_of_nothing():
    """What a search works on, without anything."""
    return SearchSetup(None, None, None, SimpleNamespace(floor=None), None, None, None, 0, ())


@pytest.mark.usefixtures("faked")
def test_half_a_search_under_other_noise_does_not_count(monkeypatch):
    """What was found before is the answer, and said to be interrupted."""
    last = SimpleNamespace(train=None, accepted=("damping",))
    before = SearchedEffects(None, last, {})
    half = SearchedEffects(
        None, SimpleNamespace(train=None, accepted=("damping",)), {}, interrupted=True
    )
    answers = [before, half]
    monkeypatch.setattr(solving, "search_effects", lambda setup: (setup, answers.pop(0)))
    coloured = SimpleNamespace(rho=np.array([0.9]))
    monkeypatch.setattr(solving, "other_noise", lambda *given: coloured)
    monkeypatch.setattr(solving, "_anew", lambda setup, under: setup.selection)
    setup = setup_of_nothing()
    found = solving.solved(setup, WhitenessSettings(), lambda *_: None)
    assert found[0] is setup
    assert found[1].last is last
    assert found[1].interrupted
    assert answers == []


@pytest.mark.usefixtures("faked")
@pytest.mark.parametrize(("rho", "goes_on"), [(-0.1, True), (0.9, False)])
def test_under_weakly_coloured_noise_a_search_goes_on(monkeypatch, rho, goes_on):
    """With what was found; where noise is strong, that may stand for it, and all is done anew."""
    asked = []

    def searched(setup):
        asked.append(setup.begun)
        return setup, SearchedEffects(None, SimpleNamespace(train=None, accepted=("damping",)), {})

    coloured = SimpleNamespace(rho=np.array([0.0, rho]))
    anew = SimpleNamespace(origins={})
    begun = setup_of_nothing()
    begun.selection.origins = {"damping": "what else was tried"}
    monkeypatch.setattr(solving, "search_effects", searched)
    monkeypatch.setattr(solving, "other_noise", lambda *given: coloured)
    monkeypatch.setattr(solving, "_anew", lambda setup, under: anew)
    monkeypatch.setattr(solving, "_begun_with", lambda setup, last: "found")
    solving.solved(begun, WhitenessSettings(), lambda *_: None)
    assert asked == [None, "found" if goes_on else None]
    assert anew.origins == (begun.selection.origins if goes_on else {})


@pytest.mark.usefixtures("faked")
@pytest.mark.parametrize("left", [None, "left"])
def test_disturbances_come_first(monkeypatch, left):
    """Noise is tested on what is left without them. Control: at once where there are none."""
    asked = []
    found = SearchedEffects(None, SimpleNamespace(train=None, accepted=("damping",)), {})
    monkeypatch.setattr(solving, "search_effects", lambda setup: (setup, found))
    monkeypatch.setattr(solving, "other_noise", lambda *given: asked.append(given))
    end = solving.solved(setup_of_nothing(), WhitenessSettings(), lambda *given: left)
    assert end[1:] == (found, left)
    assert bool(asked) == (left is None)


@pytest.fixture(scope="module")
def servo():
    """A pendulum on a servo, simulated ten times finer than a model that has all its numbers."""
    rng = np.random.default_rng(3)
    machine = MissingNumbers(*NUMBERS, 0.0, np.zeros(3), 0.0, delay=0.0)
    spec = built(first_model(DESIGN), machine)
    made = spec.copy()
    made.option.timestep = STEP / 4
    made.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    time = 0.01 * np.arange(300)
    commands = 0.5 * np.sin(2 * np.pi * rng.uniform(0.2, 2.0, (4, 1, 3)) * time[:, None])
    data = measured(made, commands.sum(axis=2, keepdims=True), 0.0, rng)
    spec.option.timestep = COARSE
    return with_velocities(problem_of("servo", spec, data))


def refused(*given):
    """No more exact steps."""
    return False


def test_long_physics_steps_are_no_cause(servo, monkeypatch):
    """Nothing is missing but short steps, and that is said: from the beginning, or in the place of
    a cause. Left out, half a step is a delay for the windows, and no cause all the same, since it
    may be what the steps do. The control: where sizes that may be 0 are causes.
    """
    search = Diagnose(EFFECTS, length=10, windows=16, disturbances=False)
    decisions = ["is_preferred", "__call__"]
    for left_out in decisions:
        with monkeypatch.context() as changed:
            changed.setattr(ArithmeticAlternatives, left_out, refused)
            found = search.run(servo)
            assert found.causes == ()
            assert 'integrator="RK4"' in found.numerics[0]
    for decision in decisions:
        monkeypatch.setattr(ArithmeticAlternatives, decision, refused)
    monkeypatch.setattr(solving, "_with_other_friction", lambda setup, found: (setup, found))
    (leader,) = search.run(servo).leaders
    assert (leader.effect, leader.why) == ("actuator_delay", "its size may be 0")
    (cause,) = replace(search, settings=DiagnosisSettings(nothing=0.0)).run(servo).causes
    assert cause.effect == "actuator_delay"
    assert cause.estimate["delay"].value == pytest.approx(COARSE / 2, rel=0.3)


@pytest.mark.parametrize("begun", ["own", "exact"])
def test_data_of_the_models_own_steps_keep_them(monkeypatch, begun):
    """Simulated in them, data speak for them from the beginning; and at the end, where the search
    begins with more exact ones all the same. The cause is the same.
    """

    def exact(alternatives, state):
        alternatives.winner = Arithmetic(1, "RK4" if own != "RK4" else "Euler")
        return True

    own = integrator(problem([], episodes=4, steps=60).simulator.model)
    arm = problem([("actuator_gain:elbow_motor", [-0.1])], sigma=1e-5, episodes=8, steps=60)
    if begun == "exact":
        monkeypatch.setattr(ArithmeticAlternatives, "is_preferred", exact)
    steps = []
    search_effects = solving.search_effects

    def searched(setup):
        steps.append(setup.problem.simulator.model.opt.integrator)
        return search_effects(setup)

    monkeypatch.setattr(solving, "search_effects", searched)
    found = Diagnose(("actuator_gain", "joint_damping"), length=10, windows=24).run(arm)
    (cause,) = found.causes
    assert (cause.effect, cause.target) == ("actuator_gain", "elbow_motor")
    assert abs(cause.estimate["gain"].value + 0.1) < 4 * cause.estimate["gain"].se
    assert not any("was evaluated with these" in sentence for sentence in found.numerics)
    assert len(set(steps)) == (2 if begun == "exact" else 1)
    assert steps[0] == steps[-1]
