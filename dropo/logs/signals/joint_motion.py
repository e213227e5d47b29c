"""The motion of joints by their logged positions, and what the model's sensors show along it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.services.validation import Array
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.resampling import align_signs, resample, resample_rotations
from dropo.logs.signals.stamps import find_gaps
from dropo.logs.signals.velocities import Velocities, estimate_velocities
from dropo.mjmodel.joints import Joint, ModelJoints, reference_pose
from dropo.mjmodel.sensors import Sensor, joints_before, sensors_along


def continuous(values: Array, joint: Joint) -> Array:
    """Give a joint's quaternions, q or -q, the signs with which they go on without jumps.

    Parameters
    ----------
    values : (n, k) array
        Positions of the joint.
    joint : Joint
        Of any kind.

    Returns
    -------
    (n, k) array
    """
    quaternion = joint.quaternion()
    if quaternion is None:
        return values
    out = values.copy()
    out[:, quaternion] = align_signs(out[:, quaternion], out[0, quaternion])
    return out


def joint_velocities(smooth: Velocities, joint: Joint) -> tuple[Array, Array]:
    """Make a joint's velocities of the slopes of its positions.

    A quaternion's derivative becomes the body's angular velocity, 2 Im(conj(q) dq/dt).

    Parameters
    ----------
    smooth : Velocities
        Of its positions.
    joint : Joint
        Of any kind.

    Returns
    -------
    velocities : (n, k) array
    noise : (k,) array
        Their standard deviations.
    """
    quaternion = joint.quaternion()
    if quaternion is None:
        return smooth.velocities, smooth.velocity_noise
    q = smooth.positions[:, quaternion]
    dq = smooth.velocities[:, quaternion]
    w = q[:, :1]
    v = q[:, 1:]
    dw = dq[:, :1]
    dv = dq[:, 1:]
    angular = 2 * (w * dv - dw * v - np.cross(v, dv)) / np.sum(q**2, axis=1, keepdims=True)
    noise = 2 * np.sqrt(np.mean(smooth.velocity_noise[quaternion] ** 2))
    linear = slice(0, quaternion.start)
    velocities = np.hstack([smooth.velocities[:, linear], angular])
    return velocities, np.concatenate([smooth.velocity_noise[linear], np.full(3, noise)])


@dataclass(frozen=True, eq=False)
class ShownSensors:
    """What the model's sensors show along the measured motion of a run.

    Attributes
    ----------
    time : (n,) array
        Instants of the positions' clock [s].
    by_name : dict
        (n, k) numbers of each sensor whose motion is known, in SI units.
    """

    time: Array
    by_name: dict[str, Array]


def sensors_shown(
    run: LogRun, robot: ModelJoints, sensors: Sequence[Sensor], rows: int, minimum_rows: int
) -> ShownSensors | None:
    """Compute what sensors show along the motion that a run's positions have.

    Parameters
    ----------
    run : LogRun
        Cleaned.
    robot : ModelJoints
        The robot.
    sensors : sequence of Sensor
        Those that are wanted.
    rows, minimum_rows : int
        Instants at most, and at least.

    Returns
    -------
    ShownSensors or None
        Of the longest stretch without a gap. None where no sensor's motion is known, or the stretch
        is too short. Joints whose position was not logged rest at qpos0.
    """
    measured = {}
    for name in robot.joints:
        series = run.of("qpos", name)
        if series is not None and not series.channel.source.own_clock:
            measured[name] = series
    known = [one for one in sensors if _is_known(one, robot, measured)]
    if not known:
        return None
    time = _stretch(list(measured.values()), rows)
    if len(time) < minimum_rows:
        return None
    model = robot.model
    positions = np.tile(reference_pose(model), (len(time), 1))
    velocities = np.zeros((len(time), model.nv))
    for name, series in measured.items():
        joint = robot.joints[name]
        values = _positions_at(series, joint, time)
        speeds, _ = joint_velocities(estimate_velocities(time, values), joint)
        positions[:, joint.qpos : joint.qpos + values.shape[1]] = values
        velocities[:, joint.qvel : joint.qvel + speeds.shape[1]] = speeds
    accelerations = np.gradient(velocities, time, axis=0)
    shown = sensors_along(model, positions, velocities, accelerations)
    places = {one.name: slice(one.place, one.place + len(one.units)) for one in known}
    return ShownSensors(time, {name: shown[:, place] for name, place in places.items()})


def _is_known(sensor: Sensor, robot: ModelJoints, measured: dict[str, TimeSeries]) -> bool:
    """Whether a sensor shows motion alone, and that of all joints that move it was measured."""
    if not sensor.follows_motion or sensor.body < 0:
        return False
    moving = joints_before(robot.model, sensor.body)
    return bool(moving) and all(name in measured for name in moving)


def _stretch(positions: Sequence[TimeSeries], rows: int) -> Array:
    """The stamps of the first position in the longest stretch in which all have rows."""
    first = max(float(one.time[0]) for one in positions)
    last = min(float(one.time[-1]) for one in positions)
    time = positions[0].time
    time = time[(time >= first) & (time <= last)]
    if len(time) < 2:
        return time
    gaps = [positions[0].time[find_gaps(positions[0].time)]]
    for one in positions[1:]:
        gaps.append(one.time[find_gaps(one.time)])
    cuts = np.searchsorted(time, np.unique(np.concatenate(gaps)))
    return max(np.split(time, cuts), key=len)[:rows]


def _positions_at(series: TimeSeries, joint: Joint, time: Array) -> Array:
    """The positions (n, k) of a joint at some instants."""
    if len(time) == len(series.time) and np.array_equal(time, series.time):
        return continuous(series.values, joint)
    values = resample(series.time, series.values, time)
    quaternion = joint.quaternion()
    if quaternion is not None:
        measured = series.values[:, quaternion]
        values[:, quaternion] = resample_rotations(series.time, measured, time)
    return values
