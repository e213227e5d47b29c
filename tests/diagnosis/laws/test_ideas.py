"""Which formulas are proposed, from which forces."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.diagnosis.findings.remains.unexplained_forces import impulses
from dropo.diagnosis.laws import ideas
from dropo.diagnosis.laws.extension import with_laws
from dropo.diagnosis.laws.forces import residual_forces
from dropo.diagnosis.laws.ideas import IdeaSettings, Terms, _rows, ideas_from, without_law
from dropo.diagnosis.laws.shapes import LawTerm
from dropo.diagnosis.search.linearization import Library, linearize
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import split
from dropo.effects.law import law_instance
from dropo.mjmodel.joints import joints
from dropo.problems.simulated.robots import simulated_robot
from tests.models.hidden_in_arm import instance, problem

SIGN = LawTerm("sign(v)", "dry friction", effects=("joint_friction",))
DRAG = LawTerm("abs(v) * v", "quadratic drag")


def test_no_term_beside_the_effect_that_it_stands_for(monkeypatch):
    """It would take back what is too much of that; in its place it may stand."""
    simulator = simulated_robot("torque-arm").simulator
    elbow = next(joint for joint in joints(simulator.model) if joint.name == "elbow")
    friction = instance(simulator, "joint_friction:elbow")
    asked = []

    def rows(simulator, forces, joint, shapes, settings):
        return np.zeros((len(shapes), 3))

    def propose(joint, shapes, rows, forces, pool, settings):
        asked.append((forces, [shape.text for shape in shapes], len(rows)))
        return []

    monkeypatch.setattr(ideas, "_rows", rows)
    monkeypatch.setattr(ideas, "_proposals", propose)
    monkeypatch.setattr(ideas, "_without_known", lambda library, forces, effects: "bare")
    terms = Terms((elbow,), ([SIGN, DRAG],), 2)
    library = SimpleNamespace(simulator=simulator)
    for accepted, expected in (
        ((friction,), [("whole", [DRAG.text], 1), ("bare", [SIGN.text, DRAG.text], 2)]),
        ((), [("whole", [SIGN.text, DRAG.text], 2)]),
    ):
        asked.clear()
        state = SimpleNamespace(accepted=accepted)
        assert ideas_from(None, library, state, "whole", terms, IdeaSettings()) == []
        assert asked == expected


def test_forces_without_a_law_are_the_laws():
    """At the truth nothing is missed; without a law it is missed, with its size, though damping is
    fitted beside it. The control: another formula explains less of that.
    """
    simulator = simulated_robot("torque-arm").simulator
    law = law_instance(simulator.effect_context, "elbow", "-c * abs(v) * v", typical={"c": 0.1})
    damping = instance(simulator, "joint_damping:elbow")
    data = problem([(law, np.array([0.1])), (damping, np.array([0.05]))], episodes=12, steps=60)
    there = [damping, *impulses(data.simulator.model, 10)]
    library = with_laws(Library(data.simulator.with_effects(there), there, 0), [law])
    free = np.concatenate([library.indices_of[one.label] for one in (damping, law)])
    theta = np.zeros(len(library.simulator.space))
    theta[free] = 0.05, 0.1
    train, _ = split(data, 10, 40)
    noise = np.full(4, 1e-3)
    side = linearize(library, train, theta, white(noise))
    forces = residual_forces(library, State(side, side, free, (damping, law)), 1e-3 * noise)
    bare = without_law(library, forces, law)
    elbow = next(joint for joint in joints(data.simulator.model) if joint.name == "elbow")
    cubic = LawTerm("v**3", "cubic drag")
    rows, _ = bare.unexplained(_rows(library.simulator, bare, elbow, [DRAG, cubic], IdeaSettings()))
    along = rows @ bare.residuals
    squares = (rows**2).sum(axis=1)
    assert -along[0] / squares[0] == pytest.approx(0.1, abs=4 / np.sqrt(squares[0]))
    gains = 0.5 * along**2 / squares
    assert gains[0] - gains[1] > 100
    left, _ = forces.unexplained(_rows(library.simulator, forces, elbow, [DRAG], IdeaSettings()))
    assert np.linalg.norm(left @ forces.residuals) < 1e-3 * abs(along[0])
