"""Sensors by name, and what they show along a motion."""

import mujoco
import numpy as np

from dropo.mjmodel.observation import Layout
from dropo.mjmodel.sensors import joints_before, named_sensors, sensors_along, turned_columns
from tests.models.imu_arm import ARM

SLIDE = """
<mujoco><worldbody><body><joint name="rail" type="slide"/><geom size="0.1" mass="1"/>
  <site name="tip"/></body></worldbody>
  <actuator><motor name="push" joint="rail"/></actuator>
  <sensor><jointvel name="speed" joint="rail"/><touch name="foot" site="tip"/>
    <actuatorfrc name="load" actuator="push"/><gyro site="tip"/></sensor></mujoco>"""


def test_kinds_and_units():
    """By MuJoCo's names; those of joints have the joint's unit, and no name is no sensor."""
    found = named_sensors(mujoco.MjModel.from_xml_string(SLIDE))
    assert {name: (one.kind, one.units) for name, one in found.items()} == {
        "speed": ("jointvel", ("m/s",)),
        "foot": ("touch", ("N",)),
        "load": ("actuatorfrc", ("N",)),
    }
    assert [one.follows_motion for one in found.values()] == [True, False, False]
    arm = mujoco.MjModel.from_xml_string(ARM)
    gyro, acceleration, orientation = named_sensors(arm).values()
    assert (gyro.stage, acceleration.stage, orientation.stage) == (
        "velocity",
        "acceleration",
        "position",
    )
    assert gyro.mount == acceleration.mount == orientation.mount
    assert joints_before(arm, gyro.body) == ["pitch", "yaw"]


def test_along_a_motion():
    """They are those of the simulation with this motion; the control has another acceleration."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = [0.3, -0.4], [1.0, 2.0], [0.2, -0.1]
    mujoco.mj_forward(model, data)
    rows = [part[None] for part in (data.qpos, data.qvel, data.qacc)]
    np.testing.assert_allclose(sensors_along(model, *rows)[0], data.sensordata, atol=1e-12)
    other = sensors_along(model, rows[0], rows[1], 0 * rows[2])[0]
    assert np.abs(other - data.sensordata)[3:6].max() > 0.1


def test_turned_columns():
    """A quarter turn about z takes x to y, and the orientation of what is turned back."""
    turn = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    vectors = turned_columns(turn, np.array([[1.0, 0, 0]]), rotation=False)
    np.testing.assert_allclose(vectors, [[0, 1, 0]], atol=1e-12)
    back = turned_columns(turn, np.array([turn]), rotation=True)
    np.testing.assert_allclose(back, [[1, 0, 0, 0]], atol=1e-12)


def test_an_orientation_is_three_signals():
    """Its sign is of no matter, it is no start coordinate, and a part of it is plain numbers."""
    model = mujoco.MjModel.from_xml_string(ARM)
    layout = Layout(model, ["qpos", "qvel", "sensordata.imu_quat"])
    assert [(one.name, one.unit) for one in layout.signals[4:]] == [
        (f"sensordata.imu_quat.r{axis}", "rad") for axis in "xyz"
    ]
    assert layout.of_state.tolist() == [True] * 4 + [False] * 3
    row = np.array([[0.1, 0.2, 0, 0, 0.6, 0, 0.8, 0]])
    other = np.concatenate([row[:, :4], -row[:, 4:]], axis=1)
    np.testing.assert_allclose(layout.coordinates(other, row)[:, 4:], 0, atol=1e-12)
    assert len(Layout(model, ["qpos", "sensordata[6:8]"]).signals) == 4
