"""A law that no effect stands for is found as a formula; nothing is where nothing is hidden."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from dropo import Diagnose
from dropo.diagnosis.laws.discovery import FoundLaw, _curve
from dropo.diagnosis.laws.ideas import may_stand_for_one_law
from dropo.diagnosis.laws.pursuit import propose
from dropo.diagnosis.laws.shapes import LawTerm, Ranges, shapes_at
from dropo.effects.law import law_instance
from dropo.exports.export import export
from dropo.problems.file.plain_model import write_extended
from dropo.problems.file.verification import verify
from dropo.problems.loading import load
from dropo.problems.simulated.robots import simulated_robot
from dropo.report.pages.diagnosis_page import causes_section
from dropo.studies.laws.machines import law_machine
from tests.models.hidden_in_arm import instance, problem

FORMULA = "-c * abs(v) * v"
DRAG = 0.1


def hidden(*effects):
    """An arm that has these, and no declared parameters."""
    return problem(list(effects), episodes=12, steps=60)


@pytest.fixture(scope="module")
def found():
    """A diagnosis of an arm whose elbow has quadratic drag, without effects that could stand in."""
    context = simulated_robot("torque-arm").simulator.effect_context
    law = law_instance(context, "elbow", FORMULA)
    return Diagnose(["law"], windows=40).run(hidden((law, np.array([DRAG]))))


def test_the_formula_is_found(found):
    """Its text, its size within five standard errors and one percent, its unit, its name."""
    (cause,) = found.causes
    assert (cause.effect, cause.target, cause.formula) == ("law", "elbow", FORMULA)
    size = cause.estimate["c"]
    assert abs(size.value - DRAG) < min(5 * size.se, 0.01 * DRAG)
    assert size.unit == "N m s^2/rad^2"
    assert cause.called == "quadratic drag"
    assert "quadratic drag" in found.headline()
    assert found.verdict == "explained"


def test_the_picture_has_the_force(found):
    """The force in parts of the data is the law's, within their errors, and not another's."""
    (curve,) = found.figures.laws
    assert (curve.axis, curve.axis_unit, curve.unit) == ("v", "rad/s", "N m")
    force, error = np.array(curve.force), np.array(curve.error)
    off = (force - np.array(curve.law)) / error
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert np.sqrt(np.mean((force / error) ** 2)) > 3


def test_files(found, tmp_path):
    """diagnosis.json has the formula; the extended problem and model.py have the law; a plug-in
    offers it at both joints.
    """
    found.save(tmp_path)
    write_extended(found.problem, found.parameters, tmp_path / "extended")
    (saved,) = json.loads((tmp_path / "diagnosis.json").read_text())["causes"]
    assert saved["formula"] == FORMULA
    assert FORMULA in causes_section(json.loads((tmp_path / "diagnosis.json").read_text())).body
    ((law, sizes),) = load(tmp_path / "extended" / "problem.yaml", threads=1).simulator.fixed
    assert law.formula == FORMULA
    assert sizes[0] == pytest.approx(found.causes[0].estimate["c"].value)
    assert verify(tmp_path).holds
    written = export(tmp_path, "effect", tmp_path / "plugin")
    scope = {}
    exec(written.files[0].read_text(), scope)
    context = simulated_robot("torque-arm").simulator.effect_context
    offered = list(scope["law_elbow"](context))
    assert [one.label for one in offered] == ["law_elbow:shoulder", "law_elbow:elbow"]


def test_nothing_hidden():
    """Where the model is right, nothing is looked for, and nothing is named."""
    found = Diagnose(["law"], windows=40).run(hidden())
    assert found.verdict == "consistent"
    assert found.causes == ()


RANGES = Ranges(np.linspace(-1, 1, 41), np.linspace(-5, 5, 41), True, ("elbow",), 3.0, True)


def test_every_shape_is_a_formula():
    """Each term is read as a law of a joint with a motor, with units that go together."""
    context = simulated_robot("torque-arm").simulator.effect_context
    for shape in shapes_at(RANGES):
        names = [name for name, _ in shape.own]
        law = law_instance(context, "shoulder", f"c * ({shape.written(names)})")
        assert len(law.quantities) == 1 + len(names), shape


def test_proposals_from_columns():
    """Of random columns that of the truth is proposed, with its size; of noise alone nothing is."""
    rng = np.random.default_rng(0)
    shapes = [LawTerm(f"x{i}", "") for i in range(60)]
    columns = rng.normal(size=(60, 2000))
    full = np.linalg.norm(columns, axis=1)
    noise = rng.normal(size=2000)

    def first(residuals):
        return propose("elbow", shapes, columns, residuals, 1.0, 400, 60, full)[:1]

    (one,) = first(0.3 * columns[7] + noise)
    assert [shape.text for shape in one.shapes] == ["x7"]
    assert abs(one.sizes[0] - 0.3) < 4.5 / np.sqrt(2000)
    (two,) = first(0.3 * columns[7] - 0.3 * columns[30] + noise)
    assert {shape.text for shape in two.shapes} == {"x7", "x30"}
    assert first(noise) == []


@pytest.mark.study
def test_one_law_takes_the_place_of_what_stood_in_for_it():
    """Square-root friction, which damping and dry friction nearly explain together, is found as one
    formula, without them.
    """
    context = simulated_robot("torque-arm").simulator.effect_context
    law = law_instance(context, "shoulder", "-c * sign(v) * sqrt(abs(v))")
    found = Diagnose(["joint_damping", "joint_friction", "law"], windows=40).run(
        hidden((law, np.array([0.3])))
    )
    assert [(one.effect, one.target, one.formula) for one in found.causes] == [
        ("law", "shoulder", law.formula)
    ]
    assert found.verdict == "explained"


def test_shapes_of_one_variable_draw_a_curve_together():
    """A law of two shapes of speed, or of one beside damping, is no cause by itself; one of speed
    and one of position, a ripple of sine and cosine, and one shape alone are. Along a slide too.
    """
    rail = law_machine("trolley").robot.simulator
    push = law_instance(rail.effect_context, "rail", "-c * dead(q, w)")
    play = LawTerm("dead(q, {0})", "", (("w", 0.3),))
    waves = LawTerm("sin({0} * q)", "", (("k", 8.7),))
    of_slide = _curve(
        SimpleNamespace(simulator=rail),
        SimpleNamespace(accepted=(push,)),
        push,
        {push.label: FoundLaw("", (), (play, waves))},
    )
    assert of_slide == "qpos.rail"
    simulator = simulated_robot("torque-arm").simulator
    library = SimpleNamespace(simulator=simulator)
    law = law_instance(simulator.effect_context, "elbow", FORMULA)
    damping = instance(simulator, "joint_damping:elbow")
    friction = instance(simulator, "joint_friction:elbow")
    other = instance(simulator, "joint_damping:shoulder")
    drag, cubic, spring = LawTerm("abs(v) * v", ""), LawTerm("v**3", ""), LawTerm("q**3", "")
    ripple = [
        LawTerm("sin({0} * q)", "", (("k", 9.0),)),
        LawTerm("cos({0} * q)", "", (("k", 9.0),)),
    ]

    def curve(shapes, *accepted):
        state = SimpleNamespace(accepted=(*accepted, law))
        return _curve(library, state, law, {law.label: FoundLaw("", (), tuple(shapes))})

    assert curve([drag, cubic]) == curve([drag], damping) == "qvel.elbow"
    assert curve([*ripple, spring]) == "qpos.elbow"
    assert curve([drag]) == curve([drag], other) == curve([drag, spring]) == curve(ripple) == ""
    held = {
        (damping, friction): True,
        (damping, other): False,
        (damping,): False,
    }
    for accepted, may in held.items():
        assert may_stand_for_one_law(library, SimpleNamespace(accepted=accepted)) == may
