"""Regression over inverse dynamics where drives move joints through tendons, as a differential."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import Incompatible
from dropo.diagnosis.far_off.families import with_families
from dropo.diagnosis.regression.equation import refuse_unsuitable
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.mjmodel.dynamics.forces import linear_drives
from dropo.mjmodel.tendons import fixed_tendons, moved_by_tendons
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.first_models.machines import (
    DESIGNS,
    built,
    first_model,
    problem_of,
    random_machine,
    recorded,
)
from tests.models.far_off import torque_arm

WRIST = DESIGNS["gantry with a coupled wrist"]
LAWS = {"armature", "damping", "friction"}


def wrist(*, at_joints=False):
    """What the machine has beside its model, and its log; its laws along tendons or at joints."""
    rng = np.random.default_rng(21)
    spec = first_model(WRIST)
    machine = replace(random_machine(WRIST, rng), coupled=not at_joints)
    data = recorded(built(spec, machine), WRIST.servos, machine.delay, rng)
    return machine.numbers(), problem_of("wrist", spec, data)


@pytest.mark.parametrize("at_joints", [False, True])
def test_rotors_and_friction_are_found_where_they_are(at_joints):
    """Along the tendons or at the joints, each number within three errors, nothing else."""
    truth, problem = wrist(at_joints=at_joints)
    found = {(one.effect, one.target): one.estimate for one in QuickDiagnose().run(problem).causes}
    assert set(found) == {(effect, target) for effect, target, _ in truth}
    kinds = {effect.partition("_")[0] for effect, _ in found if effect.partition("_")[2] in LAWS}
    assert kinds == ({"joint"} if at_joints else {"joint", "tendon"})
    for (effect, target, quantity), value in truth.items():
        estimate = found[effect, target][quantity]
        assert abs(estimate.value - value) < 3 * estimate.se, (effect, target, estimate, value)


def test_drives_pull_tendons_as_mujoco_has_them_do():
    """The same generalized forces, in random states under random commands."""
    model = first_model(WRIST).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    positions, velocities = rng.normal(size=(2, 5, model.nv))
    commands = rng.normal(size=(5, model.nu))
    forces = linear_drives(model, positions, velocities).forces(commands)
    for i in range(5):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        data.ctrl[:] = commands[i]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(forces[i], data.qfrc_actuator, rtol=1e-12)


def test_laws_are_along_tendons_where_these_alone_move_all_joints():
    """The two joints of a differential; the control: one tendon of two joints, or a drive beside
    it, or a tendon along sites.
    """
    spec = first_model(WRIST)
    assert moved_by_tendons(spec.compile()) == {3, 4}
    spec.actuators[-1].set_to_motor()
    spec.delete(spec.actuators[-1])
    assert moved_by_tendons(spec.compile()) == frozenset()
    extra = spec.add_actuator(target="joint4")
    extra.trntype = mujoco.mjtTrn.mjTRN_JOINT
    extra.set_to_motor()
    assert moved_by_tendons(spec.compile()) == {3}
    lines = {line.tendon.name: line.driven for line in fixed_tendons(spec.compile())}
    assert lines == {"tendon3": True, "tendon4": False}


def test_a_drive_of_a_tendon_along_sites_is_refused():
    """Its lever depends on the posture; in a sentence that names it."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><site name="post" pos="0 0 1"/>
        <body><joint name="hinge"/><geom size=".1"/><site name="end" pos=".3 0 0"/></body>
        </worldbody><tendon><spatial name="rope"><site site="post"/><site site="end"/></spatial>
        </tendon><actuator><motor name="winch" tendon="rope"/></actuator></mujoco>"""
    )
    robot = MujocoSimulator(spec, [], observation=["qpos"], frame_skip=1, threads=1)
    with pytest.raises(Incompatible, match=r"'winch' is neither .* a slide or a fixed tendon"):
        refuse_unsuitable(robot)


def test_families_are_where_regression_has_them():
    """Along tendons, but at the joints where the model has one of them there already."""
    _, problem = wrist()
    assert labels_with_damping(torque_arm(problem=problem)) == [
        *(f"joint_damping:joint{i}" for i in range(3)),
        *(f"tendon_damping:tendon{i}" for i in (3, 4)),
    ]
    at_joints = torque_arm("joint_armature:joint4", problem=problem)
    assert sorted(labels_with_damping(at_joints)[1:]) == [
        f"joint_damping:joint{i}" for i in range(5)
    ]


def labels_with_damping(model):
    """The labels of a model's numbers with a damping everywhere."""
    return [instance.label for instance, _ in with_families(model, ["joint_damping"]).numbers]
