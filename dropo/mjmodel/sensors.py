"""The sensors of a model, by name, and what they show along a motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.services.validation import Array
from dropo.mjmodel.names import element_names, joint_names

G = 9.80665
"""Standard gravity [m/s^2], by which accelerometers count."""
_UNITS = {
    "touch": "N",
    "accelerometer": "m/s^2",
    "velocimeter": "m/s",
    "gyro": "rad/s",
    "force": "N",
    "torque": "N m",
    "magnetometer": "T",
    "rangefinder": "m",
    "ballangvel": "rad/s",
    "tendonpos": "m",
    "tendonvel": "m/s",
    "framepos": "m",
    "framelinvel": "m/s",
    "frameangvel": "rad/s",
    "framelinacc": "m/s^2",
    "frameangacc": "rad/s^2",
    "subtreecom": "m",
    "subtreelinvel": "m/s",
    "clock": "s",
}
"""SI units of kinds of sensors; other kinds have none, or that of their joint."""
_OF_JOINTS = {
    "jointpos": ("rad", "m"),
    "jointvel": ("rad/s", "m/s"),
    "jointlimitpos": ("rad", "m"),
    "jointlimitvel": ("rad/s", "m/s"),
    "jointlimitfrc": ("N m", "N"),
    "jointactuatorfrc": ("N m", "N"),
    "actuatorfrc": ("N m", "N"),
}
"""SI units of kinds of sensors at hinges, and at slides."""
_ROTATIONS = ("framequat", "ballquat")
_TURNS_ALONG = (
    *("accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer", "framequat"),
)
"""Kinds of sensors whose numbers change where the sensor is turned in its mount."""
_OF_MOTION = (
    *("accelerometer", "velocimeter", "gyro", "framequat", "framepos", "framelinvel"),
    *("frameangvel", "framelinacc", "frameangacc", "framexaxis", "frameyaxis", "framezaxis"),
    *("jointpos", "jointvel", "tendonpos", "tendonvel", "ballquat", "ballangvel", "subtreecom"),
    *("subtreelinvel", "magnetometer"),
)
"""Kinds of sensors that positions, velocities and accelerations of the joints determine."""
_STAGES = {
    int(mujoco.mjtStage.mjSTAGE_POS): "position",
    int(mujoco.mjtStage.mjSTAGE_VEL): "velocity",
    int(mujoco.mjtStage.mjSTAGE_ACC): "acceleration",
}


@dataclass(frozen=True)
class Sensor:
    """A sensor of a model that has a name.

    Attributes
    ----------
    id : int
        Its number in the model.
    name : str
        Its name.
    kind : str
        MuJoCo's name of its type, such as "gyro".
    place : int
        Where its numbers begin in sensordata.
    units : tuple of str
        The SI unit of each number.
    mount : str
        What it stands on, such as "site imu"; sensors of one mount turn together.
    body : int
        The body that it stands on; -1 where it is on none.
    stage : str
        "position", "velocity" or "acceleration": what of the motion it shows.
    """

    id: int
    name: str
    kind: str
    place: int
    units: tuple[str, ...]
    mount: str
    body: int
    stage: str

    @property
    def is_rotation(self) -> bool:
        """Whether its numbers are a quaternion w, x, y, z."""
        return self.kind in _ROTATIONS

    @property
    def may_be_turned(self) -> bool:
        """Whether its numbers are another's where it is turned in its mount."""
        return self.kind in _TURNS_ALONG

    @property
    def follows_motion(self) -> bool:
        """Whether the motion of the joints says what it shows."""
        return self.kind in _OF_MOTION


def named_sensors(model: mujoco.MjModel) -> dict[str, Sensor]:
    """List the sensors of a model that have a name.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    dict of str to Sensor
        By name, in the model's order.
    """
    found = {}
    for name, i in element_names(model, "sensor").items():
        kind = mujoco.mjtSensor(int(model.sensor_type[i])).name.removeprefix("mjSENS_").lower()
        found[name] = Sensor(
            id=i,
            name=name,
            kind=kind,
            place=int(model.sensor_adr[i]),
            units=(_unit(model, i, kind),) * int(model.sensor_dim[i]),
            mount=_mount(model, i),
            body=_body(model, i),
            stage=_STAGES.get(int(model.sensor_needstage[i]), "position"),
        )
    return found


def _unit(model: mujoco.MjModel, i: int, kind: str) -> str:
    """The SI unit of a sensor's numbers."""
    if kind not in _OF_JOINTS:
        return _UNITS.get(kind, "")
    joint = int(model.sensor_objid[i])
    if kind == "actuatorfrc":
        on_joint = model.actuator_trntype[joint] == mujoco.mjtTrn.mjTRN_JOINT
        joint = int(model.actuator_trnid[joint, 0]) if on_joint else -1
    if joint < 0:
        return ""
    is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    return _OF_JOINTS[kind][int(is_slide)]


def _mount(model: mujoco.MjModel, i: int) -> str:
    """What a sensor stands on."""
    kind = mujoco.mjtObj(int(model.sensor_objtype[i])).name.removeprefix("mjOBJ_").lower()
    return f"{kind} {int(model.sensor_objid[i])}"


def _body(model: mujoco.MjModel, i: int) -> int:
    """The body that a sensor stands on; -1 where it is on none, or is seen from another one."""
    kinds = mujoco.mjtObj
    place = int(model.sensor_objid[i])
    owners = {
        int(kinds.mjOBJ_SITE): model.site_bodyid,
        int(kinds.mjOBJ_GEOM): model.geom_bodyid,
        int(kinds.mjOBJ_CAMERA): model.cam_bodyid,
        int(kinds.mjOBJ_JOINT): model.jnt_bodyid,
    }
    kind = int(model.sensor_objtype[i])
    if int(model.sensor_reftype[i]) != int(kinds.mjOBJ_UNKNOWN):
        return -1
    if kind in (int(kinds.mjOBJ_BODY), int(kinds.mjOBJ_XBODY)):
        return place
    return int(owners[kind][place]) if kind in owners else -1


def joints_before(model: mujoco.MjModel, body: int) -> list[str]:
    """Name the joints that move a body.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    body : int
        Its number.

    Returns
    -------
    list of str
        From the body to the world.
    """
    names = joint_names(model)
    found = []
    while body > 0:
        first = int(model.body_jntadr[body])
        found += names[first : first + int(model.body_jntnum[body])] if first >= 0 else []
        body = int(model.body_parentid[body])
    return found


def sensors_along(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """Compute what the sensors show along a motion, whatever forces it has.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    positions : (n, nq) array
        Positions [m, rad].
    velocities, accelerations : (n, nv) arrays
        Velocities [m/s, rad/s] and accelerations [m/s^2, rad/s^2].

    Returns
    -------
    (n, nsensordata) array
        Right for sensors that follow the motion (`Sensor.follows_motion`).
    """
    data = mujoco.MjData(model)
    shown = np.empty((len(positions), model.nsensordata))
    for i in range(len(positions)):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        data.qacc[:] = accelerations[i]
        mujoco.mj_inverse(model, data)
        shown[i] = data.sensordata
    return shown


def turned_columns(quaternion: Sequence[float], values: Array, *, rotation: bool) -> Array:
    """Turn what a sensor shows into the axes of another mount.

    Parameters
    ----------
    quaternion : sequence of float
        Unit quaternion w, x, y, z that turns vectors of the sensor's axes into those of the mount.
    values : (n, 3) or (n, 4) array
        Vectors, or orientations w, x, y, z.
    rotation : bool
        Whether they are orientations.

    Returns
    -------
    (n, 3) or (n, 4) array
    """
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_quat(np.asarray(quaternion, dtype=float), scalar_first=True)
    if not rotation:
        return np.asarray(turn.apply(values))
    lengths = np.linalg.norm(values, axis=1)
    out = np.array(values)
    real = lengths > 0
    if real.any():
        turned = Rotation.from_quat(values[real], scalar_first=True) * turn.inv()
        out[real] = lengths[real, None] * turned.as_quat(scalar_first=True)
    return out
