"""Any number of a model as a parameter: where it is written, what follows, what is refused."""

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadArgument, UnknownName
from dropo.mjmodel.fields import NEVER_NEGATIVE, Binding, FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.cases import BALL, BOX, CART, CASES, PENDULUM, VALVE, mass, places
from tests.reference.stepping import load, replay_one_by_one


def model_of(xml):
    """The model as compiled."""
    return mujoco.MjModel.from_xml_string(xml)


def parameter(field, element=None, **more):
    """A FieldParameter in [-100, 100]."""
    low = 0.0 if field in NEVER_NEGATIVE else -100.0
    return FieldParameter("x", low, 100.0, field=field, element=element, **more)


def changed(before, after, field):
    """The places of a field that differ."""
    return [
        tuple(map(int, place))
        for place in np.argwhere(getattr(before, field) != getattr(after, field))
    ]


@pytest.mark.parametrize(
    ("xml", "chosen", "field", "expected"),
    [
        (BOX, parameter("body_mass", "flap"), "body_mass", [(2,)]),
        (BOX, parameter("geom_friction", "shell", index=1), "geom_friction", [(1, 1)]),
        (BOX, parameter("dof_damping", "lid"), "dof_damping", [(6,)]),
        (BALL, parameter("dof_armature", "shoulder", index=2), "dof_armature", [(2,)]),
        (BALL, parameter("body_ipos", "forearm", index=0), "body_ipos", [(2, 0)]),
        (CART, parameter("jnt_range", "rail", index=1), "jnt_range", [(0, 1)]),
        (VALVE, parameter("actuator_gainprm", "lag", index=0), "actuator_gainprm", [(1, 0)]),
        (CART, parameter("qpos0", index=1), "qpos0", [(1,)]),
    ],
)
def test_sets_one_number_and_no_other(xml, chosen, field, expected):
    """The element's row is found by name (a dof's by its joint), the number in it by its index."""
    before = model_of(xml)
    after = model_of(xml)
    binding = Binding(chosen, before)
    assert binding.nominal() == getattr(before, field)[expected[0]]
    binding.set(after, 7.25)
    assert changed(before, after, field) == expected
    assert getattr(after, field)[expected[0]] == 7.25


def test_sets_entries_of_the_option():
    """Gravity by index and the time step by name, back to the nominal value too."""
    model = model_of(CART)
    gravity = Binding(parameter("gravity", index=2), model)
    step = Binding(parameter("timestep"), model)
    assert (gravity.nominal(), step.nominal()) == (-9.81, 0.01)
    gravity.set(model, -1.62)
    step.set(model, 0.005)
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -1.62])
    assert model.opt.timestep == 0.005
    step.set(model, step.nominal())
    assert model.opt.timestep == 0.01


@pytest.mark.parametrize(
    ("chosen", "rows"),
    [
        (parameter("geom_friction", "shell", relative=True), (1, slice(None))),
        (parameter("geom_friction", "shell", index=0, relative=True), (1, 0)),
        (parameter("body_inertia", "box", relative=True), (1, slice(None))),
        (parameter("body_mass", "box", relative=True), (1,)),
    ],
)
def test_relative_is_a_factor_on_the_models_own_number(chosen, rows):
    """On the whole row, or on the indexed number; set twice, it is not compounded, and 1 gives the
    model back.
    """
    before = model_of(BOX)
    after = model_of(BOX)
    binding = Binding(chosen, before)
    assert binding.nominal() == 1.0
    for factor in (3.0, 0.5):
        binding.set(after, factor)
    expected = getattr(before, chosen.field).copy()
    expected[rows] *= 0.5
    np.testing.assert_array_equal(getattr(after, chosen.field), expected)
    binding.set(after, 1.0)
    np.testing.assert_array_equal(getattr(after, chosen.field), getattr(before, chosen.field))


def test_relative_dofs_of_a_ball_joint():
    """A factor on all three dofs of a ball joint, and on no other."""
    before = model_of(BALL)
    after = model_of(BALL)
    Binding(parameter("dof_damping", "shoulder", relative=True), before).set(after, 4.0)
    np.testing.assert_allclose(after.dof_damping, [0.2, 0.2, 0.2, 0.0])


def simulator_of(xml, parameters, frame_skip=2):
    """The simulator of positions and velocities."""
    return MujocoSimulator(
        mujoco.MjSpec.from_string(xml), parameters, frame_skip=frame_skip, threads=1
    )


def used_model(simulator, value):
    """The model that the simulator steps under a parameter vector."""
    worker = simulator._worker(general=False)
    worker.set(np.asarray(value, dtype=float))
    return worker.model


@pytest.mark.parametrize("derived", [True, False])
def test_derived_constants_follow_or_stay(derived):
    """body_invweight0 follows a mass where `derived`, and else stays as compiled; the mass is
    written either way.
    """
    simulator = simulator_of(BOX, [mass("box", derived=derived)])
    compiled = model_of(BOX)
    used = used_model(simulator, [2.0])
    assert used.body_mass[1] == 2.0
    assert (changed(compiled, used, "body_invweight0") != []) is derived
    if derived:
        expected = model_of(
            BOX.replace('size="0.1 0.08 0.1" mass="1"', 'size="0.1 0.08 0.1" mass="2"')
        )
        expected.body_inertia[:] = compiled.body_inertia
        mujoco.mj_setConst(expected, mujoco.MjData(expected))
        np.testing.assert_array_equal(used.body_invweight0, expected.body_invweight0)


def test_derived_and_kept_parameters_together():
    """Constants follow the derived mass with the kept one as compiled, whatever was simulated
    before.
    """
    simulator = simulator_of(BOX, [mass("box", derived=False), mass("flap")])
    used_model(simulator, [1.7, 0.9])
    used = used_model(simulator, [0.4, 0.6])
    expected = model_of(BOX)
    expected.body("flap").mass[0] = 0.6
    mujoco.mj_setConst(expected, mujoco.MjData(expected))
    np.testing.assert_array_equal(used.body_mass[1:], [0.4, 0.6])
    np.testing.assert_array_equal(used.body_invweight0, expected.body_invweight0)
    np.testing.assert_array_equal(used.dof_invweight0, expected.dof_invweight0)
    np.testing.assert_array_equal(used.body_subtreemass, expected.body_subtreemass)


@pytest.mark.parametrize(
    ("chosen", "value", "old", "new"),
    [
        (parameter("gravity", index=2), -3.0, "<option ", '<option gravity="0 0 -3" '),
        (parameter("timestep"), 0.004, 'timestep="0.01"', 'timestep="0.004"'),
        (parameter("dof_damping", "pivot"), 0.3, 'damping="0.1"', 'damping="0.3"'),
        (
            parameter("actuator_gear", "torque", index=0),
            2.5,
            'joint="pivot"/>',
            'joint="pivot" gear="2.5"/>',
        ),
    ],
)
def test_a_field_is_the_same_as_another_file(chosen, value, old, new):
    """A number set by its field moves the pendulum as one in the MJCF does; the time step too."""
    simulator = simulator_of(PENDULUM, [chosen])
    segments = CASES["pendulum"].segments("every step")
    other = PENDULUM.replace(old, new)
    assert other != PENDULUM
    expected = replay_one_by_one(load(other), segments, places(qpos=1, qvel=1), 2)
    np.testing.assert_allclose(
        simulator.predict([[value]], segments)[0], expected, rtol=0, atol=1e-14
    )
    assert np.abs(simulator.predict(simulator.nominal[None], segments)[0] - expected).max() > 1e-4


def test_moved_centre_of_mass():
    """body_ipos in an MjSpec: a heavier tip side slows the swing as an MJCF with that inertial
    frame does.
    """
    inertial = '<inertial pos="0 0 {}" mass="0.4" diaginertia="0.01 0.01 0.001"/>'
    xml = PENDULUM.replace("<geom", inertial.format(-0.25) + "<geom")
    simulator = simulator_of(xml, [parameter("body_ipos", "rod", index=2)])
    segments = CASES["pendulum"].segments("lambda")
    model = load(PENDULUM.replace("<geom", inertial.format(-0.4) + "<geom"))
    expected = replay_one_by_one(model, segments, places(qpos=1, qvel=1), 2)
    np.testing.assert_allclose(simulator.predict([[-0.4]], segments)[0], expected, atol=1e-13)
    assert np.abs(simulator.predict([[-0.25]], segments)[0] - expected).max() > 1e-3


def test_a_parameter_of_every_kind_at_once():
    """Mass, friction, gravity and a factor, derived and kept, give what each writes by itself, in
    any order.
    """
    friction = FieldParameter(
        "friction", 0.5, 2, field="geom_friction", element="shell", relative=True
    )
    damping = FieldParameter("damping", 0, 1, field="dof_damping", element="lid", derived=False)
    parameters = [mass("box"), parameter("gravity", index=2), friction, damping]
    values = np.array([1.5, -5.0, 1.3, 0.2])
    segments = CASES["box"].segments("lambda")
    found = simulator_of(BOX, parameters).predict(values[None], segments)
    np.testing.assert_array_equal(
        found, simulator_of(BOX, parameters[::-1]).predict(values[None, ::-1], segments)
    )
    names = {
        "body_mass": {1: 1.5},
        "geom_friction": {1: model_of(BOX).geom_friction[1] * 1.3},
        "dof_damping": {6: 0.2},
    }
    used = used_model(simulator_of(BOX, parameters), values)
    for field, rows in names.items():
        for row, number in rows.items():
            np.testing.assert_array_equal(getattr(used, field)[row], number)
    assert used.opt.gravity[2] == -5.0


@pytest.mark.parametrize(
    ("chosen", "error", "words"),
    [
        (
            parameter("body_mas", "box"),
            UnknownName,
            r"No field of MjModel or mjOption called 'body_mas'. Did you mean 'body_mass'\?",
        ),
        (
            parameter("gravty", index=2),
            UnknownName,
            r"No field of MjModel or mjOption called 'gravty'. Did you mean 'gravity'\?",
        ),
        (
            parameter("body_parentid", "box"),
            UnknownName,
            r"No field of MjModel or mjOption called 'body_parentid'. .*",
        ),
        (parameter("body_mass", "bxo"), UnknownName, r"No body called 'bxo'. Did you mean 'box'\?"),
        (
            parameter("dof_damping", "shell"),
            UnknownName,
            r"No joint called 'shell'. There is box, lid.",
        ),
        (
            parameter("body_mass"),
            BadArgument,
            r"The field 'body_mass' of parameter 'x' needs the name of a "
            r"body. There is box, flap, world.",
        ),
        (
            parameter("geom_friction", "shell"),
            BadArgument,
            r"The field 'geom_friction' of parameter 'x' has 3 numbers: give the index, 0 to 2.",
        ),
        (
            parameter("gravity"),
            BadArgument,
            r"The field 'gravity' of parameter 'x' has 3 numbers: give the index, 0 to 2.",
        ),
        (
            parameter("geom_friction", "shell", index=3),
            BadArgument,
            r"The index of parameter 'x' must be 0 to 2, the field "
            r"'geom_friction' has 3 numbers there. Got 3.",
        ),
        (
            parameter("geom_friction", "shell", index=-1),
            BadArgument,
            r"The index of parameter 'x' must be 0 to 2, the field "
            r"'geom_friction' has 3 numbers there. Got -1.",
        ),
        (
            parameter("body_mass", "box", index=1),
            BadArgument,
            r"The index of parameter 'x' must be 0 to 0, the field "
            r"'body_mass' has 1 numbers there. Got 1.",
        ),
        (
            parameter("gravity", "box", index=2),
            BadArgument,
            r"The field 'gravity' of parameter 'x' has no named "
            r"elements, and the name 'box' was given.",
        ),
        (
            parameter("timestep", index=1),
            BadArgument,
            r"The index of parameter 'x' must be 0 to 0, the field "
            r"'timestep' has 1 numbers there. Got 1.",
        ),
    ],
)
def test_refusals(chosen, error, words):
    """The message names the parameter, its field, and the nearest valid name or allowed range."""
    with pytest.raises(error, match=f"^{words}$"):
        Binding(chosen, model_of(BOX))
