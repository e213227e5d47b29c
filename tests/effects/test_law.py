"""Laws: formulas as text, units of their constants, the forces they make, what they remember."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, InvalidInput, UnknownName
from dropo.effects.law import law_instance, law_of_text, places, units_at
from dropo.effects.support.formula import read_formula
from dropo.effects.support.formula_values import evaluate, evaluate_with, followed
from dropo.mjmodel.joints import joints
from dropo.problems.simulated.robots import simulated_robot
from tests.models.hidden_in_arm import instance, problem


@pytest.fixture(scope="module")
def found():
    """An arm with two hinges, and data of it with nothing hidden."""
    return problem([], episodes=4, steps=30)


UNITS = {("q", ""): "rad", ("v", ""): "rad/s", ("t", ""): "s", ("motor", ""): "N m"}


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("-c * abs(v) * v", ["N m s^2/rad^2"]),
        ("-c * tanh(v / w)", ["N m", "rad/s"]),
        ("k * dead(q, p)", ["N m/rad", "rad"]),
        ("-c * motor * lag(motor**2, T)", ["1/N^2 m^2", "s"]),
        ("-f * dahl(x) + c * sin(6 * q)", ["N m", "rad", "N m"]),
        ("c * max(q - a, 0)", ["N m/rad", "rad"]),
    ],
)
def test_units_follow_from_the_formula(text, units):
    """Each constant has the unit that makes the value a torque; the text is read back the same."""
    formula = read_formula(text, UNITS, "N m")
    assert list(formula.units) == units
    assert read_formula(formula.text, UNITS, "N m").program == formula.program


@pytest.mark.parametrize("inside", ["q", "lag(motor, T)"])
def test_terms_that_are_alike_are_added(inside):
    """Forty of them, evaluated at once, are what each gives alone; a past is remembered once."""
    rng = np.random.default_rng(0)
    sizes = {"s": 0.7, "T": 0.5, "k": 2.0, "w": 3.0}
    terms = []
    for i in range(40):
        sizes |= {f"c{i}": rng.normal(), f"a{i}": rng.normal()}
        terms.append(f"c{i} * exp(-(({inside} - a{i}) / s)**2)")

    def values(text):
        """A formula in four states of five motions, one after another."""
        formula = read_formula(text, UNITS, "N m")
        constants = np.array([sizes[name] for name in formula.program.constants])
        memory = {}
        found = []
        for i in range(4):
            draws = np.random.default_rng(i)
            state = {key: draws.normal(size=5) + i for key in UNITS}
            found.append(evaluate(formula.program, state, constants, memory))
        return np.array(found), formula.program.hidden

    beside = "-k * tanh(v / w)"
    whole, hidden = values(" + ".join([*terms, beside]))
    apart = sum(values(term)[0] for term in [*terms, beside])
    assert np.abs(whole - apart).max() < 1e-13
    assert hidden == (inside != "q")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("-c * abs(vv)", "Did you mean 'v'"),
        ("-c * absolute(v)", "Did you mean 'abs'"),
        ("__import__('os').system('true')", "may have numbers"),
        ("(lambda: 0)()", "may have numbers"),
        ("c.__class__", "No variable called"),
        ("c * d * v", "cannot be told apart"),
        ("c * v + q", "do not go together"),
        ("v", "no constant"),
        ("c * v *", "no formula"),
        ("c * lag(v, q)", "must be a number or a constant"),
        ("c * abs(v, v)", "takes 1 arguments"),
        ("c * v" + " + c * v" * 1000, "characters"),
    ],
)
def test_what_is_no_formula_is_refused(text, told):
    """Free code, unknown names, wrong units: one line that says what is wrong, and what is near."""
    with pytest.raises(InvalidInput, match=told):
        read_formula(text, UNITS, "N m", ["c", "d"])


@pytest.mark.parametrize("text", ["c * lag(v, T)", "c * dahl(w)", "c * lag(v, T) * dahl(w)"])
def test_hidden_states_along_runs_are_those_of_step_by_step(text):
    """Two runs of other lengths, a state that rests and a time that stands still among them."""
    program = read_formula(text, UNITS, "N m").program
    constants = np.array([{"c": 2.0, "T": 0.3, "w": 0.4}[name] for name in program.constants])
    rng = np.random.default_rng(3)
    begins = np.isin(np.arange(25), [0, 15])
    values = {key: rng.normal(size=25) for key in UNITS}
    values["q", ""][7] = values["q", ""][6]
    values["t", ""] = 0.1 * np.r_[np.arange(15), np.arange(10)]
    followed_states = {}

    def remembered(node, inside, values):
        followed_states[node[3]] = followed(node, inside, values, begins)
        return followed_states[node[3]][0]

    whole = evaluate_with(program, values, constants, remembered)
    for first, last in ((0, 15), (15, 25)):
        memory = {}
        for i in range(first, last):
            one = {key: value[i : i + 1] for key, value in values.items()}
            assert evaluate(program, one, constants, memory) == pytest.approx(whole[i], abs=1e-12)
            for place, parts in memory.items():
                at = [part[i] for part in followed_states[place]]
                np.testing.assert_allclose(np.ravel(parts), at, atol=1e-12)


def test_values():
    """Shapes have the values that they are named for; what is not finite is 0."""
    v = np.array([-2.0, 0.0, 0.5])
    for text, expected in [
        ("c * abs(v) * v", 3 * np.abs(v) * v),
        ("c * dead(v, 1)", 3 * np.array([-1.0, 0, 0])),
        ("c * max(v, 0)", 3 * np.array([0, 0, 0.5])),
        ("c * v**2 / 2 - c", 1.5 * v**2 - 3),
        ("c * sqrt(v)", np.array([0, 0, 3 * np.sqrt(0.5)])),
        ("c / v", np.array([-1.5, 0, 6])),
    ]:
        program = read_formula(text, {("v", ""): "1"}, "1").program
        np.testing.assert_allclose(evaluate(program, {("v", ""): v}, np.array([3.0]), {}), expected)


def test_a_linear_law_is_the_known_effect(found):
    """-c v is joint_damping, to what an explicit force differs from an implicit one; -2 c v not."""
    simulator = found.simulator
    segments = found.trajectories.from_rows(np.arange(0, 100, 9), 5, every_step=True)
    law = law_of_text(simulator.effect_context, "elbow:-c * v")
    damping = instance(simulator, "joint_damping:elbow")
    fine = simulator.with_finer_steps(20)

    def predicted(one, size):
        robot = fine.with_effects((), [(one, np.array([size]))])
        return robot.predict(np.asarray(robot.nominal)[None], segments)[0]

    change = np.abs(predicted(damping, 0.1) - predicted(damping, 0.0)).max()
    assert np.abs(predicted(law, 0.1) - predicted(damping, 0.1)).max() < 0.02 * change
    assert np.abs(predicted(law, 0.2) - predicted(damping, 0.1)).max() > 0.3 * change


@pytest.mark.parametrize("text", ["-c * motor * t", "-c * lag(v, T)", "-c * dahl(x)"])
def test_a_segment_knows_its_past(text):
    """Where time or a hidden state matters, a segment from the middle of a motion without noise
    goes on as the whole motion did.
    """
    arm = simulated_robot("torque-arm")
    law = law_instance(arm.simulator.effect_context, "elbow", text)
    sizes = np.array([{"c": 0.3, "T": 0.05, "x": 0.05}[q.name] for q in law.quantities])
    hidden = [(law, sizes)]
    data = problem(hidden, sigma=1e-15, episodes=2, steps=40).trajectories
    robot = arm.simulator.with_effects((), hidden)
    segments = data.from_rows(np.array([20, 30, 60]), 5)
    predicted = robot.predict(np.asarray(robot.nominal)[None], segments)[0]
    error = np.abs(predicted - segments.targets).max()
    plain = arm.simulator.predict(np.asarray(arm.simulator.nominal)[None], segments)[0]
    assert error < 0.05 * np.abs(plain - segments.targets).max()


def test_laws_of_commands_and_bodies(found):
    """c u added to a command is a gain; a constant force on a body is external_force."""
    simulator = found.simulator
    context = simulator.effect_context
    segments = found.trajectories.from_rows(np.arange(0, 100, 9), 5, every_step=True)
    name = simulator.action_names[0]

    def predicted(one, size):
        robot = simulator.with_effects((), [(one, np.array([size]))])
        return robot.predict(np.asarray(robot.nominal)[None], segments)[0]

    gain = predicted(instance(simulator, f"actuator_gain:{name}"), 0.1)
    law = law_instance(context, name, "c * u", "command")
    np.testing.assert_allclose(predicted(law, 0.1), gain, atol=1e-9)
    body = simulator.model.body(2).name
    pushed = predicted(instance(simulator, f"external_force:{body}.x"), 0.4)
    along = law_instance(context, body, "c * 1", "x")
    np.testing.assert_allclose(predicted(along, 0.4), pushed, atol=1e-3 * np.abs(pushed).max())
    assert [joint.name for joint in joints(simulator.model)] == ["shoulder", "elbow"]


def test_places_of_laws(found):
    """Joints, actuators and bodies, each with its own variables; others are refused by name."""
    context = found.simulator.effect_context
    assert places(context) == ["shoulder", "elbow"]
    assert places(context, "command") == ["shoulder_motor", "elbow_motor"]
    assert {"upper", "fore"} <= set(places(context, "x"))
    variables, unit = units_at(context, "elbow")
    assert unit == "N m"
    assert variables["v", ""] == "rad/s"
    variables, unit = units_at(context, "elbow_motor", "command")
    assert unit == "command"
    assert variables["u", ""] == "command"
    variables, unit = units_at(context, "fore", "z")
    assert unit == "N"
    assert variables["vz", ""] == "m/s"
    with pytest.raises(UnknownName, match="variant of law called 'w'"):
        units_at(context, "fore", "w")
    with pytest.raises(UnknownName, match="joint for law called 'elbo'"):
        units_at(context, "elbo")
    with pytest.raises(BadArgument, match="named as law:PLACE:FORMULA"):
        law_of_text(context, "elbow")


def test_a_law_at_a_joint_knows_its_command(found):
    """u is the command of the joint's own motor: c u is a gain of it, by the motor's gear."""
    simulator = found.simulator
    segments = found.trajectories.from_rows(np.arange(0, 100, 9), 5, every_step=True)

    def predicted(one, size):
        robot = simulator.with_effects((), [(one, np.array([size]))])
        return robot.predict(np.asarray(robot.nominal)[None], segments)[0]

    law = law_instance(simulator.effect_context, "elbow", "c * u")
    gear = simulator.model.actuator("elbow_motor").gear[0]
    gain = predicted(instance(simulator, "actuator_gain:elbow_motor"), 0.02)
    nothing = predicted(law, 0.0)
    same = predicted(law, 0.02 * gear)
    assert np.abs(same - gain).max() < 0.05 * np.abs(gain - nothing).max()
