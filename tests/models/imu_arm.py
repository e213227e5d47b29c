"""An arm on a fixed base with an IMU on its last link, and logs of angles and IMU alone."""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.simulators.mujoco.simulator import MujocoSimulator

ARM = """
<mujoco model="imu-arm">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="yaw" axis="0 0 1" damping="0.15" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.8" contype="0"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="pitch" axis="0 1 0" damping="0.08" armature="0.005"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.4" contype="0"/>
        <site name="imu" pos="0 0.02 -0.2" euler="0 20 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="yaw_motor" joint="yaw"/>
    <motor name="pitch_motor" joint="pitch"/>
  </actuator>
  <sensor>
    <gyro name="imu_gyro" site="imu"/>
    <accelerometer name="imu_acc" site="imu"/>
    <framequat name="imu_quat" objtype="site" objname="imu"/>
  </sensor>
</mujoco>
"""
SKIP = 2
"""Physics steps in a control step."""
ENCODER = 2e-3
"""Standard deviation of the encoders' errors [rad]."""
SD = {"imu_gyro": 1e-2, "imu_acc": 0.1, "imu_quat": 2e-3}
"""The same of the IMU's [rad/s, m/s^2, 1]."""
PARAMETERS = (
    FieldParameter("damping", 0.02, 0.3, "N m s/rad", field="dof_damping", element="pitch"),
    FieldParameter("mass", 0.2, 0.8, "kg", field="body_mass", element="lower"),
    FieldParameter("gain", 0.5, 2.0, "", field="actuator_gainprm", element="yaw_motor", index=0),
)
TRUTH = np.array([0.08, 0.4, 1.0])
"""What the model has of these."""
IMU = ("imu_gyro", "imu_acc")


@dataclass(frozen=True, eq=False)
class Recording:
    """A run without errors: stamps (n,), angles (n, 2), sensors (n, k) by name, commands (n, 2)."""

    time: np.ndarray
    angles: np.ndarray
    sensors: dict
    commands: np.ndarray


def record(rng, steps=60, more_damping=0.0, xml=ARM, every=1):
    """Simulate a run under torques that are held for some steps.

    Sensors are those of the state at each stamp, under the command that led there; `every` physics
    steps have a row.
    """
    model = mujoco.MjModel.from_xml_string(xml)
    model.dof_damping[1] += more_damping
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-0.5, 0.5, 2)
    held = np.repeat(rng.normal(0, 1, (-(-steps // 8), 2)) * [0.35, 0.3], 8, axis=0)
    rows = []
    data.ctrl[:] = held[0]
    for i in range(steps * SKIP + 1):
        if i % every == 0:
            mujoco.mj_forward(model, data)
            rows.append(
                (
                    data.time,
                    data.qpos.copy(),
                    data.sensordata.copy(),
                    held[min(i // SKIP, len(held) - 1)],
                )
            )
        data.ctrl[:] = held[min(i // SKIP, len(held) - 1)]
        mujoco.mj_step(model, data)
    time, angles, found, commands = (np.array(part) for part in zip(*rows, strict=True))
    sensors = {}
    for name in SD:
        sensor = model.sensor(name)
        sensors[name] = found[:, sensor.adr[0] : sensor.adr[0] + sensor.dim[0]]
    return Recording(time, angles, sensors, commands)


def noisy(run, rng):
    """The angles (n, 2) and the sensors (n, k) by name, with errors."""
    angles = run.angles + ENCODER * rng.standard_normal(run.angles.shape)
    sensors = {
        name: one + SD[name] * rng.standard_normal(one.shape) for name, one in run.sensors.items()
    }
    return angles, sensors


def problem(seed, sensors=IMU, runs=6, steps=60, more_damping=0.0, parameters=PARAMETERS):
    """A problem of angles and some sensors with errors; velocities come from the positions."""
    rng = np.random.default_rng([seed, 4])
    before, after, actions = [], [], []
    for _ in range(runs):
        run = record(rng, steps, more_damping, every=SKIP)
        angles, shown = noisy(run, rng)
        rows = np.hstack([angles, *(shown[name] for name in sensors)])
        before.append(rows[:-1])
        after.append(rows[1:])
        actions.append(run.commands[:-1])
    ends = np.arange(1, runs * steps + 1) % steps == 0
    data = Trajectories(
        np.concatenate(before), np.concatenate(actions), np.concatenate(after), ends
    )
    robot = MujocoSimulator(
        mujoco.MjSpec.from_string(ARM),
        list(parameters),
        observation=["qpos", *(f"sensordata.{name}" for name in sensors)],
        frame_skip=SKIP,
        threads=1,
    )
    return with_velocities(Problem("imu-arm", robot, data))


COLUMNS = {
    "imu_gyro": ("gyro_x", "gyro_y", "gyro_z"),
    "imu_acc": ("acc_x", "acc_y", "acc_z"),
    "imu_quat": ("quat_w", "quat_x", "quat_y", "quat_z"),
}
"""What the columns of a log are called."""
MAP = {
    "time": {"column": "t"},
    "qpos": {"yaw": {"column": "q_yaw"}, "pitch": {"column": "q_pitch"}},
    "ctrl": {"yaw_motor": {"column": "tau_yaw"}, "pitch_motor": {"column": "tau_pitch"}},
}
"""The mapping of the rest."""


def sensor_map(*names, **more):
    """A mapping with some sensors, and more of each."""
    entries = {name: {"columns": list(COLUMNS[name])} | more for name in names}
    return MAP | {"sensordata": entries}


def write_logs(folder, seed=0, runs=2, steps=200, sensors=IMU, change=None, names=None):
    """Write arm.xml and CSV logs, and give the logs' paths.

    `change` changes the sensors, and `names` the names of columns.
    """
    (folder / "arm.xml").write_text(ARM)
    rng = np.random.default_rng([seed, 9])
    paths = []
    for i in range(runs):
        run = record(rng, steps, every=SKIP)
        angles, shown = noisy(run, rng)
        shown = change(shown) if change else shown
        table = {"t": run.time, "q_yaw": angles[:, 0], "q_pitch": angles[:, 1]}
        table |= {"tau_yaw": run.commands[:, 0], "tau_pitch": run.commands[:, 1]}
        for sensor in sensors:
            table |= dict(zip(COLUMNS[sensor], shown[sensor].T, strict=True))
        header = ",".join((names or {}).get(name, name) for name in table)
        paths.append(folder / f"run{i}.csv")
        values = np.stack(list(table.values()), axis=1)
        np.savetxt(paths[-1], values, delimiter=",", header=header, comments="", fmt="%.9g")
    return paths
