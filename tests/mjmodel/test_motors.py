"""Motors from the library become numbers of their joint; servo gains are one parameter each."""

import json

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, BadFile, InvalidInput, UnknownName
from dropo.mjmodel.fields import Binding, FieldParameter
from dropo.mjmodel.files.motors import Motor, motor_of, motor_parameters, mount, read_motors
from dropo.problems.loading import load

XML = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
<body pos="0 0 -1"><joint name="ball" type="ball"/><geom size="0.1"/></body></body></worldbody>
<actuator><motor name="drive" joint="hinge" gear="2"/>
  <position name="servo" joint="hinge" kp="20" kv="3"/>
<velocity name="speed" joint="hinge" kv="4"/></actuator></mujoco>"""


def test_the_library_is_sound():
    """Every motor has a source and a label, and reads as numbers; the AK80-6's rotor is 36 times as
    heavy behind its gear.
    """
    motors = read_motors()
    assert all(motor.source.startswith("https://") and motor.label for motor in motors.values())
    assert motors["ak80-6"].armature == pytest.approx(36 * 6.0719e-5)
    assert motors["mx-106"].armature is None


def test_a_mounted_motor_is_in_the_model():
    """Reflected inertia, friction and peak torque behind the actuators' gears; what the data sheet
    lacks stays.
    """
    spec = mujoco.MjSpec.from_string(XML)
    mount(spec, "hinge", Motor("mine", 6, 6e-5, peak_torque=12, coulomb=0.1))
    model = spec.compile()
    assert model.dof_armature[0] == pytest.approx(36 * 6e-5)
    assert model.dof_frictionloss[0] == pytest.approx(0.1)
    assert model.dof_damping[0] == 0
    np.testing.assert_allclose(model.actuator_forcerange, [[-6, 6], [-12, 12], [-12, 12]])
    data = mujoco.MjData(model)
    data.ctrl[0] = 100
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(12)


def test_its_parameters_hold_the_data_sheets_numbers():
    """Each interval contains the nominal value; a motor without numbers has nothing to fit."""
    found = {p.name: p for p in motor_parameters("hinge", read_motors()["ak80-6"])}
    assert set(found) == {"hinge_armature", "hinge_friction", "hinge_damping"}
    assert found["hinge_armature"].low < 36 * 6.0719e-5 < found["hinge_armature"].high
    assert found["hinge_friction"].high == pytest.approx(2.4)
    assert motor_parameters("hinge", Motor("bare")) == []


def test_servo_gains_are_one_number_each():
    """kp is set in gain and bias alike, so that the set point stays; kv of a position servo damps,
    of a velocity servo drives.
    """
    model = mujoco.MjModel.from_xml_string(XML)
    names = [("actuator_kp", "servo"), ("actuator_kv", "servo"), ("actuator_kv", "speed")]
    bound = [
        Binding(FieldParameter("gain", 1, 100, field=field, element=element), model)
        for field, element in names
    ]
    assert [binding.nominal() for binding in bound] == [20, 3, 4]
    for binding, value in zip(bound, (50, 5, 7), strict=True):
        binding.set(model, value)
    np.testing.assert_allclose(model.actuator_gainprm[1:, 0], [50, 7])
    np.testing.assert_allclose(model.actuator_biasprm[1:, :3], [[0, -50, -5], [0, 0, -7]])
    doubled = Binding(
        FieldParameter("gain", 0.5, 3, field="actuator_kp", element="servo", relative=True), model
    )
    doubled.set(model, 2.0)
    assert model.actuator_biasprm[1, 1] == -100
    with pytest.raises(BadArgument, match="'drive' is none"):
        Binding(FieldParameter("gain", 1, 100, field="actuator_kp", element="drive"), model)
    with pytest.raises(BadArgument, match="'speed' is none"):
        Binding(FieldParameter("gain", 1, 100, field="actuator_kp", element="speed"), model)


def test_a_problem_file_names_motors(tmp_path):
    """`motors` by joint, from the library or with numbers; kp is fitted by name; an unknown motor
    gives the nearest.
    """
    (tmp_path / "robot.xml").write_text(XML)
    rows = np.zeros((4, 9))
    rows[:, 1] = 1.0
    data = Trajectories(rows, np.zeros((4, 3)), rows, np.arange(4) == 3)
    np.savez(
        tmp_path / "data.npz",
        observations=data.observations,
        actions=data.actions,
        next_observations=data.next_observations,
        terminals=data.terminals,
    )
    text = (
        "model: robot.xml\ndata: data.npz\nmotors: {hinge: MOTOR}\nparameters: {kp: {field: "
        "actuator_kp, name: servo, low: 5, high: 60}}\n"
    )
    path = tmp_path / "problem.yaml"
    path.write_text(text.replace("MOTOR", "ak80-6"))
    simulator = load(path, threads=1).simulator
    assert simulator.model.dof_armature[0] == pytest.approx(36 * 6.0719e-5)
    assert simulator.nominal.tolist() == [20]
    path.write_text(text.replace("MOTOR", "{gear_ratio: 10, rotor_inertia: 1.0e-5}"))
    assert load(path, threads=1).simulator.model.dof_armature[0] == pytest.approx(1e-3)
    wrong_motors = {
        "ak80-7": "Did you mean 'ak80-6'",
        "{gear: 10}": "the nearest is 'gear_ratio'",
        "3": "the name of a motor",
    }
    for wrong, message in wrong_motors.items():
        path.write_text(text.replace("MOTOR", wrong))
        with pytest.raises(InvalidInput, match=message):
            load(path, threads=1)
    path.write_text(text.replace("hinge: MOTOR", "hing: ak80-6"))
    with pytest.raises(InvalidInput, match="Did you mean 'hinge'"):
        load(path, threads=1)


def test_a_library_of_ones_own(tmp_path):
    """A JSON file of the same form; impossible numbers and joints that do not turn are refused."""
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"big": {"gear_ratio": 50, "rotor_inertia": 1e-4}}))
    assert read_motors(path)["big"].armature == pytest.approx(0.25)
    path.write_text("{")
    with pytest.raises(BadFile, match="JSON file of motors"):
        read_motors(path)
    with pytest.raises(BadArgument, match="gear_ratio"):
        motor_of({"gear_ratio": -1}, "here")
    with pytest.raises(InvalidInput, match="neither"):
        mount(mujoco.MjSpec.from_string(XML), "ball", Motor("mine"))
    with pytest.raises(UnknownName, match="hinge"):
        mount(mujoco.MjSpec.from_string(XML), "hinges", Motor("mine"))
