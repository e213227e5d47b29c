"""Effects on the model and on forces against slow twins: an MJCF with other numbers, and forces
applied step by step.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.simulators.mujoco.model_xml import format_model
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.effects_on_arm import instance, observed, predicted, same
from tests.models.robots import ARM, CART, CUBE, ROBOTS, STRANGE
from tests.reference.effects import replay

XML = {"arm": ARM, "cube": CUBE, "cart": CART, "strange": STRANGE}


G = 9.81
INERTIA = "0.0066666666666666667"
LOWER = 'fromto="0 0 0 0.1 0.05 -0.3" mass="0.5"/>'
PAYLOAD = """
<body pos="0.05 -0.02 -0.2">
<inertial pos="0 0 0" mass="0.3" diaginertia="1e-15 1e-15 1e-15"/></body>
"""
MODELS = [
    ("arm", "joint_damping:shoulder", (0.7,), ('damping="0.3"', 'damping="1.0"')),
    (
        "arm",
        "joint_damping.hinges",
        (0.7,),
        ('name="elbow"', 'name="elbow" damping="0.7"'),
        ('damping="0.3"', 'damping="1.0"'),
    ),
    ("arm", "joint_friction:shoulder", (0.4,), ('frictionloss="0.1"', 'frictionloss="0.5"')),
    ("arm", "joint_friction:elbow", (0.4,), ('name="elbow"', 'name="elbow" frictionloss="0.4"')),
    ("arm", "joint_armature:shoulder", (0.03,), ('armature="0.02"', 'armature="0.05"')),
    ("arm", "joint_stiffness:elbow", (3.0,), ('stiffness="2"', 'stiffness="5"')),
    ("arm", "joint_limit:elbow.upper", (-0.1,), ('range="-0.2 0.1"', 'range="-0.2 0.0"')),
    ("arm", "joint_limit:elbow.lower", (0.1,), ('range="-0.2 0.1"', 'range="-0.1 0.1"')),
    ("arm", "actuator_gain:push", (0.5,), ('gear="20"', 'gear="30"')),
    ("arm", "actuator_gain:servo", (0.5,), ('kp="12" kv="0.4"', 'kp="18" kv="0.6"')),
    ("arm", "air_drag.density", (90.0,), ("<option", '<option density="90"')),
    ("arm", "air_drag.viscosity", (3.0,), ("<option", '<option viscosity="3"')),
    ("arm", "wind.x", (40.0, -6.0), ("<option", '<option density="40" wind="-6 0 0"')),
    (
        "arm",
        "gravity_tilt.y",
        (0.2,),
        ("<option", f'<option gravity="{-G * np.sin(0.2)} 0 {-G * np.cos(0.2)}"'),
    ),
    (
        "cube",
        "gravity_tilt.x",
        (0.2,),
        ("<option", f'<option gravity="0 {G * np.sin(0.2)} {-G * np.cos(0.2)}"'),
    ),
    ("cube", "contact_friction", (-0.5,), ('friction="0.6"', 'friction="0.3"')),
    ("cube", "contact_friction", (0.5,), ('friction="0.6"', 'friction="0.9"')),
    (
        "cube",
        "contact_stiffness.time-constant",
        (0.5,),
        ("<worldbody>", '<default><geom solref="0.03 1"/></default><worldbody>'),
    ),
    (
        "cube",
        "contact_stiffness.damping-ratio",
        (0.5,),
        ("<worldbody>", '<default><geom solref="0.02 1.5"/></default><worldbody>'),
    ),
    (
        "cube",
        "contact_stiffness.margin",
        (0.02,),
        ("<worldbody>", '<default><geom margin="0.01"/></default><worldbody>'),
    ),
    (
        "cube",
        "body_mass:cube",
        (0.5,),
        ('size="0.1 0.1 0.1" mass="1"', 'size="0.1 0.1 0.1"'),
        (
            "<freejoint/>",
            (
                f'<freejoint/><inertial pos="0 0 0" mass="1.5" diaginertia="{INERTIA} '
                f'{INERTIA} {INERTIA}"/>'
            ),
        ),
    ),
    (
        "arm",
        "payload:lower",
        (0.3, 0.05, -0.02, -0.2),
        (LOWER, LOWER + PAYLOAD),
    ),
    (
        "cube",
        "body_inertia:cube",
        (0.5,),
        (
            "<freejoint/>",
            '<freejoint/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>',
        ),
    ),
    (
        "cube",
        "body_com:cube.x",
        (0.03,),
        (
            "<freejoint/>",
            (
                f'<freejoint/><inertial pos="0.03 0 0" mass="1" diaginertia="{INERTIA} '
                f'{INERTIA} {INERTIA}"/>'
            ),
        ),
    ),
]


@pytest.mark.parametrize(
    ("name", "label", "magnitudes", "changes"), [(n, e, s, c) for n, e, s, *c in MODELS]
)
def test_model_of_another_text(name, label, magnitudes, changes):
    """Predictions are those of a model whose MJCF says so, derived constants included."""
    robot = ROBOTS[name]()
    text = XML[name]
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    same(
        robot,
        predicted(robot, label, *magnitudes),
        replay(mujoco.MjModel.from_xml_string(text), robot),
    )


TWO = CUBE.replace(
    "</worldbody>",
    (
        '<body name="other" pos="1 0 0.1"><freejoint/><geom type="sphere" '
        'size="0.1"/></body></worldbody>'
    ),
)


SOFTER = [
    ("time-constant", 0.5, 'solref="0.03 1"'),
    ("damping-ratio", -0.5, 'solref="0.02 0.5"'),
    ("margin", 0.01, 'margin="0.01"'),
]


@pytest.mark.parametrize(("variant", "size", "text"), SOFTER)
def test_contact_stiffness_of_one_geom(variant, size, text):
    """One geom's numbers alone change, of several that can touch."""
    spec = mujoco.MjSpec.from_string(TWO)
    robot = MujocoSimulator(spec, ()).effect_context
    found = {a.label: a for a in find("effects", "contact_stiffness")(robot)}[
        f"contact_stiffness:shell.{variant}"
    ]
    own = mujoco.MjModel.from_xml_string(TWO)
    other = mujoco.MjModel.from_xml_string(TWO.replace('name="shell"', f'name="shell" {text}'))
    found.model(own, np.array([size]))
    np.testing.assert_allclose(own.geom_solref, other.geom_solref, rtol=1e-12)
    np.testing.assert_allclose(own.geom_margin, other.geom_margin, rtol=1e-12)


def test_contacts_that_give_stiffness_themselves_are_left():
    """A negative solref is stiffness and damping, which a factor on the time constant does not
    mean.
    """
    robot = MujocoSimulator(
        mujoco.MjSpec.from_string(TWO.replace('name="shell"', 'name="shell" solref="-900 -40"')), ()
    ).effect_context
    found = {a.label: a for a in find("effects", "contact_stiffness")(robot)}
    assert "contact_stiffness:shell.margin" in found
    assert "contact_stiffness:shell.time-constant" not in found
    before = robot.model.geom_solref.copy()
    after = robot.model.__copy__()
    found["contact_stiffness.time-constant"].model(after, np.array([0.5]))
    assert np.array_equal(after.geom_solref[1], before[1])
    assert after.geom_solref[0, 0] == 1.5 * before[0, 0]


def test_centre_of_mass_needs_a_source():
    """Where a free body cannot be compiled anew its centre of mass is not offered, and refused with
    the way out.
    """
    free = ROBOTS["cube"]()
    com = instance(free, "body_com:cube.x")
    compiled = MujocoSimulator(mujoco.MjModel.from_xml_string(CUBE), (), frame_skip=4, threads=1)
    assert list(find("effects", "body_com")(compiled.effect_context)) == []
    with pytest.raises(Incompatible, match="from an MJCF file or an MjSpec"):
        compiled.with_effects([com])


def on(robot, joint):
    """(dof, qpos address) of a joint."""
    model = robot.simulator.model
    return int(model.joint(joint).dofadr[0]), int(model.joint(joint).qposadr[0])


def friction(data, dof, load):
    return -load * np.tanh(data.qvel[dof] / 1e-2)


FORCES = [
    (
        "arm",
        "joint_stiffness:shoulder.rest",
        (2.0, 0.7),
        "shoulder",
        lambda d, v, q: 0.7 - 2.0 * d.qpos[q],
    ),
    (
        "arm",
        "joint_stiffness:elbow.rest",
        (2.0, 0.7),
        "elbow",
        lambda d, v, q: 0.7 - 2.0 * (d.qpos[q] - 0.1),
    ),
    (
        "arm",
        "joint_stribeck:shoulder",
        (0.5, 0.4),
        "shoulder",
        lambda d, v, q: friction(d, v, 0.5 * np.exp(-((d.qvel[v] / (0.5 * np.exp(0.4))) ** 2))),
    ),
    (
        "arm",
        "joint_cogging:shoulder.12-a-turn",
        (0.6, -0.3),
        "shoulder",
        lambda d, v, q: 0.6 * np.sin(12 * d.qpos[q]) - 0.3 * np.cos(12 * d.qpos[q]),
    ),
    (
        "arm",
        "actuator_torque_speed:push",
        (0.3,),
        "shoulder",
        lambda d, v, q: weaker(d.qfrc_actuator[v], d.qvel[v], 0.3),
    ),
    (
        "arm",
        "actuator_torque_speed:servo",
        (0.9,),
        "elbow",
        lambda d, v, q: weaker(d.qfrc_actuator[v], d.qvel[v], 0.9),
    ),
    (
        "strange",
        "actuator_torque_speed:actuator3",
        (0.9,),
        "track",
        lambda d, v, q: weaker(d.actuator_force[3], d.qvel[v], 0.9),
    ),
    (
        "strange",
        "actuator_torque_speed:speed",
        (0.9,),
        "track",
        lambda d, v, q: weaker(d.actuator_force[4], d.qvel[v], 0.9),
    ),
]


def weaker(force, speed, slope):
    """What a motor that drives loses with speed."""
    return -min(slope * abs(speed), 1) * force if force * speed > 0 else 0.0


@pytest.mark.parametrize(
    ("name", "label", "magnitudes", "joint", "distribution"),
    FORCES,
    ids=[case[1] for case in FORCES],
)
def test_force_step_by_step(name, label, magnitudes, joint, distribution):
    """Predictions are those of a loop that applies the effect's law as a generalised force, with
    MuJoCo's own motor forces.
    """
    robot = ROBOTS[name]()
    dof, place = on(robot, joint)

    def push(model, data):
        return np.where(np.arange(model.nv) == dof, distribution(data, dof, place), 0.0)

    same(
        robot,
        predicted(robot, label, *magnitudes),
        replay(mujoco.MjModel.from_xml_string(XML[name]), robot, applied_force=push),
    )


@pytest.mark.parametrize(
    ("name", "joint", "share", "actuators"),
    [
        ("arm", "shoulder", 0.1, None),
        ("arm", "elbow", 0.1, None),
        ("strange", "track", 0.2, [3, 4]),
    ],
)
def test_load_friction_step_by_step(name, joint, share, actuators):
    """Predictions are those of a loop that sets the joint's dry friction before every step, by
    MuJoCo's own motor forces.
    """
    robot = ROBOTS[name]()
    dof, _ = on(robot, joint)
    own = robot.simulator.model.dof_frictionloss[dof]

    def grip(model, data):
        load = (
            data.qfrc_actuator[dof] if actuators is None else data.actuator_force[actuators].sum()
        )
        model.dof_frictionloss[dof] = own + share * abs(load)
        return np.zeros(model.nv)

    same(
        robot,
        predicted(robot, f"joint_load_friction:{joint}", share),
        replay(mujoco.MjModel.from_xml_string(XML[name]), robot, applied_force=grip),
    )


LEVER = """<mujoco>
  <option timestep="0.002"/>
  <worldbody><body><joint name="pivot" axis="0 1 0"/>
    <geom size="0.01" pos="0.2 0 0" mass="0.5097"/></body></worldbody>
  <actuator><motor name="push" joint="pivot" gear="-1"/></actuator>
</mujoco>"""


def test_load_friction_holds():
    """A lever that pulls down with 1 N m stays where a motor gives 0.8 N m, if a third of these are
    friction; if a tenth, it falls.
    """
    spec = mujoco.MjSpec.from_string(LEVER)
    motor = MujocoSimulator(spec, (), observation=["qpos"], threads=1)
    blank = np.zeros((200, 1))
    ends = np.arange(200) == 199
    data = Trajectories(blank, np.full((200, 1), 0.8), blank, ends)
    whole = data.segments(reset="start", every_step=True)
    (found,) = find("effects", "joint_load_friction")(motor.effect_context)
    lever = motor.with_effects([found])
    held, falls = lever.predict(np.array([[1 / 3], [0.1]]), whole)[:, -1, 0]
    assert abs(held) < 0.05 * falls
    assert falls > 0.1


@pytest.mark.parametrize("first", [0, 1])
def test_springs_and_a_load_add_up_in_any_order(first):
    """A spring, a load alone and their sum; all are numbers of the model. A load alone comes with a
    spring of a millionth of the largest torque a rad.
    """
    robot = ROBOTS["arm"]()
    spring = (instance(robot, "joint_stiffness:shoulder"), np.array([2.0]))
    load = (instance(robot, "joint_stiffness:shoulder.rest"), np.array([0.0, 0.7]))
    pair = [spring, load][:: 1 - 2 * first]
    simulator = robot.simulator.with_effects((), pair)
    both = simulator.predict(simulator.nominal[None], robot.segments)[0]
    together = predicted(robot, "joint_stiffness:shoulder.rest", 2.0, 0.7)
    np.testing.assert_allclose(both, together, rtol=1e-5, atol=1e-5)
    alone = predicted(robot, "joint_stiffness:shoulder.rest", 0.0, 0.7)
    plain = mujoco.MjModel.from_xml_string(XML["arm"])
    pushed = replay(plain, robot, applied_force=lambda m, d: np.array([0.7, 0.0]))
    np.testing.assert_allclose(alone, observed(robot, pushed), rtol=1e-5, atol=1e-5)


def test_a_load_is_written():
    """The force of the written model's spring is the load, to the digits of an MJCF."""
    robot = ROBOTS["arm"]()
    load = (instance(robot, "joint_stiffness:shoulder.rest"), np.array([0.0, 0.7]))
    written = mujoco.MjModel.from_xml_string(format_model(robot.simulator, active=[load]))
    assert written.jnt_stiffness[0] * written.qpos_spring[0] == pytest.approx(0.7, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "label", "axis"),
    [("arm", "external_force:lower.x", 0), ("cube", "external_force:cube.y", 1)],
)
def test_external_force(name, label, axis):
    """A force at the body's centre of mass, in the world's axes."""
    robot = ROBOTS[name]()
    model = mujoco.MjModel.from_xml_string(XML[name])
    wrench = (model.body(label.split(":")[1].split(".")[0]).id, 3.0 * np.eye(6)[axis])
    same(robot, predicted(robot, label, 3.0), replay(model, robot, wrench=wrench))


def test_a_simulation_that_diverges_does_so_in_silence():
    """From speeds whose square is no double any more no warning comes, which would be an error."""
    robot = ROBOTS["arm"]()
    hidden = instance(robot, "joint_stribeck:shoulder")
    sizes = np.full(len(hidden.quantities), 0.3)
    simulator = robot.simulator.with_effects((), [(hidden, sizes)])
    rows = robot.segments.trajectories.observations.copy()
    rows[robot.segments.steps[0, 0], simulator.model.nq] = 1e200
    data = replace(robot.segments.trajectories, observations=rows)
    segments = replace(robot.segments, trajectories=data)
    lost = ~np.isfinite(simulator.predict(simulator.nominal[None], segments)[0]).all(axis=1)
    assert lost.any()
    assert not lost.all()


def test_two_at_once():
    """Effects of several layers add up, in the twin as in the simulator."""
    robot = ROBOTS["arm"]()
    fixed = [
        (instance(robot, "joint_damping:shoulder"), np.array([0.7])),
        (instance(robot, "external_force:lower.x"), np.array([3.0])),
    ]
    simulator = robot.simulator.with_effects(
        [instance(robot, "joint_stiffness:shoulder.rest")], fixed
    )
    found = simulator.predict(np.append(robot.simulator.nominal, [2.0, 0.7])[None], robot.segments)[
        0
    ]
    model = mujoco.MjModel.from_xml_string(ARM.replace('damping="0.3"', 'damping="1.0"'))
    wrench = (model.body("lower").id, 3.0 * np.eye(6)[0])
    same(
        robot,
        found,
        replay(
            model,
            robot,
            applied_force=lambda m, d: np.array([0.7 - 2.0 * d.qpos[0], 0.0]),
            wrench=wrench,
        ),
    )
