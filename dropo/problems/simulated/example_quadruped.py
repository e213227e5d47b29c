"""An example on legs: the model of a quadruped with position servos, and logs of it on a floor.

`python -m dropo.problems.simulated.example_quadruped DIR` writes `quadruped.xml`, of the size of a
Unitree Go1 and made of primitives, and CSV logs of a simulated machine of this model: pose of the
trunk as motion capture gives it, angles of twelve joints, and what the servos were told. With
`--imu` the logs hold what an IMU on the trunk shows in place of the pose. The machine is simulated
at a finer step.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.services.errors import SimulationFailed
from dropo.core.services.files.atomic_write import write_text
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import reference_pose
from dropo.mjmodel.numbers import derive_constants
from dropo.mjmodel.options import physics_step
from dropo.simulators.mujoco.plain_robot import Robot

LEGS = {"FR": (0.19, -0.05), "FL": (0.19, 0.05), "RR": (-0.19, -0.05), "RL": (-0.19, 0.05)}
"""Name of a leg -> where its hip is, forwards and to the left of the trunk's middle [m]."""
_LEG = """\
      <body name="{leg}_hip" pos="{x} {y} 0">
        <joint name="{leg}_abduction" axis="1 0 0" range="-50 50"/>
        <geom type="cylinder" size="0.045 0.02" euler="90 0 0" mass="0.6" contype="0"
              conaffinity="0"/>
        <body name="{leg}_thigh" pos="0 {side} 0">
          <joint name="{leg}_hip" axis="0 1 0" range="-40 170"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.213" size="0.02" mass="0.9" contype="0"
                conaffinity="0"/>
          <body name="{leg}_calf" pos="0 0 -0.213">
            <joint name="{leg}_knee" axis="0 1 0" range="-160 -40"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.012" mass="0.13" contype="0"
                  conaffinity="0"/>
            <geom name="{leg}_foot" type="sphere" pos="0 0 -0.213" size="0.022" mass="0.05"/>
          </body>
        </body>
      </body>
"""
_SERVO = '    <position name="{joint}" joint="{joint}"/>\n'
_JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("abduction", "hip", "knee"))
_LEGS = "".join(
    _LEG.format(leg=leg, x=x, y=y, side=0.08 * np.sign(y)) for leg, (x, y) in LEGS.items()
)
MODEL = f"""\
<mujoco model="quadruped">
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <joint damping="0.3" armature="0.01" frictionloss="0.2"/>
    <position kp="60" kv="1" forcerange="-30 30"/>
    <geom friction="0.7 0.02 0.001" condim="3"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="20 20 0.1" priority="1"/>
    <body name="trunk" pos="0 0 0.31">
      <freejoint name="base"/>
      <geom name="trunk" type="box" size="0.19 0.06 0.05" mass="5.2"/>
      <site name="imu" pos="0.02 0 0.01"/>
{_LEGS}    </body>
  </worldbody>
  <actuator>
{"".join(_SERVO.format(joint=joint) for joint in _JOINTS)}  </actuator>
  <sensor>
    <gyro name="gyro" site="imu"/>
    <accelerometer name="acc" site="imu"/>
  </sensor>
</mujoco>
"""
STANCE = (0.0, 0.8, -1.6)
"""Angles of abduction, hip and knee at which the machine stands [rad]."""


@dataclass(frozen=True)
class Walk:
    """How the machine is driven and logged.

    Attributes
    ----------
    seconds : float
        Of each log.
    rate : float
        Rows of a log in a second.
    finer : int
        Physics steps of the machine in one of the model.
    trot : tuple of float
        Least and largest frequency of the trot [Hz].
    lift, stride, sway : float
        Reach of the knees, hips and abductions [rad].
    balance : float
        How far hips and abductions reach to where the trunk moves [rad/(m/s)].
    restless : float
        Reach of slow random targets that are added [rad].
    change : float
        Time between two frequencies and reaches [s].
    position, rotation, angle : float
        Standard deviation of the noise on the trunk's position [m] and rotation [rad], and on the
        joints' angles [rad].
    imu : bool
        Whether an IMU's numbers are logged in place of the pose.
    turning, acceleration : float
        Standard deviation of the noise on what the gyro [rad/s] and the accelerometer [m/s^2] show.
    tilt : float
        By how much the IMU is mounted askew, about the trunk's axis to the left [rad].
    fallen : float
        Height of the trunk below which the machine has fallen [m].
    falling, shortest : float
        A log ends so long before a fall, and has at least this length [s].
    late : float
        By how much commands act late [s].
    """

    seconds: float = 20.0
    rate: float = 200.0
    finer: int = 4
    trot: tuple[float, float] = (2.0, 3.0)
    lift: float = 0.4
    stride: float = 0.2
    sway: float = 0.06
    balance: float = 0.3
    restless: float = 0.04
    change: float = 2.0
    position: float = 5e-4
    rotation: float = 2e-3
    angle: float = 1e-3
    imu: bool = False
    turning: float = 0.02
    acceleration: float = 0.3
    tilt: float = 0.0
    fallen: float = 0.15
    falling: float = 0.5
    shortest: float = 2.0
    late: float = 0.0


WALK = Walk()
Change = Callable[[mujoco.MjModel], None]
"""Makes the machine differ from its model."""


@dataclass(frozen=True, eq=False)
class WalkLog:
    """What was logged of one walk: n rows.

    Attributes
    ----------
    time : (n,) array
        [s].
    pose : (n, 7) array
        The trunk's position [m] and quaternion, the real part first.
    angles, targets : (n, 12) array
        Of the joints in the model's order [rad].
    speeds : (n, 18) array
        True velocities, which no log holds [m/s, rad/s].
    imu : (n, 6) array or None
        What the gyro [rad/s] and the accelerometer [m/s^2] show, where the log holds that in place
        of the pose.
    """

    time: Array
    pose: Array
    angles: Array
    targets: Array
    speeds: Array = field(repr=False)
    imu: Array | None = None

    def as_csv(self) -> str:
        """Write the log as text.

        Returns
        -------
        str
            Without the velocities.
        """
        base = [f"trunk_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        shown = self.pose
        if self.imu is not None:
            base = [f"{sensor}_{axis}" for sensor in ("gyro", "acc") for axis in "xyz"]
            shown = self.imu
        targets = [f"{joint}_target" for joint in _JOINTS]
        lines = [",".join(["time", *base, *_JOINTS, *targets])]
        table = np.column_stack([self.time, shown, self.angles, self.targets])
        lines += [",".join(f"{x:.6f}" for x in row) for row in table]
        return "\n".join(lines) + "\n"


def write_quadruped(
    folder: str | Path,
    runs: int = 3,
    seed: int = 0,
    walk: Walk = WALK,
    change: Change | None = None,
    machine: str = MODEL,
) -> list[Path]:
    """Write the model and logs of the example.

    Parameters
    ----------
    folder : str or Path
        Where.
    runs : int
        How many logs.
    seed : int
        Of commands and noise.
    walk : Walk, optional
        How the machine is driven and logged.
    change : callable, optional
        Makes the machine differ from its model.
    machine : str, optional
        MJCF of the machine that walks; the model that is written stays as it is.

    Returns
    -------
    list of Path
        quadruped.xml, log1.csv, log2.csv, ...
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    paths = [place / "quadruped.xml"]
    write_text(paths[0], MODEL)
    for number, rng in enumerate(np.random.default_rng(seed).spawn(runs), 1):
        paths.append(place / f"log{number}.csv")
        write_text(paths[-1], walked(rng, walk, change, machine).as_csv())
    return paths


def walked(
    rng: np.random.Generator,
    walk: Walk = WALK,
    change: Change | None = None,
    machine: str = MODEL,
) -> WalkLog:
    """Let the machine walk, and log it.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of commands and noise.
    walk : Walk, optional
    change : callable, optional
        Makes the machine differ from its model.
    machine : str, optional
        MJCF of the machine.

    Returns
    -------
    WalkLog

    Raises
    ------
    SimulationFailed
        If the machine falls.
    """
    command_rng, noise_rng = rng.spawn(2)
    spec = mujoco.MjSpec.from_string(machine)
    spec.option.timestep /= walk.finer
    model = spec.compile()
    if change is not None:
        change(model)
    derive_constants(model)
    step = physics_step(model)
    skip = round(1 / (walk.rate * step))
    robot = Robot(model, skip)
    command = np.tile(STANCE, 4)
    robot.reset(np.concatenate([reference_pose(model)[:7], command]), np.zeros(model.nv))
    _hold(robot, command, 2 * round(1 / step) // 2)
    count = round(walk.seconds * walk.rate)
    time = np.arange(count) / walk.rate
    targets = _targets(command_rng, time, walk)
    late = min(round(walk.late / step), skip)
    states = np.empty((count, model.nq + model.nv))
    imu = np.empty((count, 6))
    for t in range(count):
        states[t] = robot.state()[1:]
        if walk.imu:
            imu[t] = robot.sensors()
        # A late command leaves the one before it in force for a part of the step.
        _hold(robot, command, late)
        targets[t] += _balance(robot.state()[1:], walk)
        command = targets[t]
        _hold(robot, command, skip - late)
        positions = robot.state()[1 : 1 + model.nq]
        if not (positions[2] > walk.fallen and np.isfinite(positions).all()):
            count = max(0, t - round(walk.falling * walk.rate))
            break
    if count < walk.shortest * walk.rate:
        raise SimulationFailed(f"the machine falls {time[t]:.3g} s after its start")
    time = time[:count]
    states = states[:count]
    targets = targets[:count]
    pose = states[:, :7].copy()
    pose[:, :3] += walk.position * noise_rng.standard_normal((count, 3))
    turned = walk.rotation * noise_rng.standard_normal((count, 3))
    for row, turn in zip(pose, turned, strict=True):
        mujoco.mju_quatIntegrate(row[3:], turn, 1.0)
    angles = states[:, 7:19] + walk.angle * noise_rng.standard_normal((count, 12))
    shown = _shown(imu[:count], walk, noise_rng) if walk.imu else None
    return WalkLog(time, pose, angles, targets, states[:, 19:], shown)


def _shown(imu: Array, walk: Walk, rng: np.random.Generator) -> Array:
    """What gyro and accelerometer (n, 6) show where they are mounted askew, with noise."""
    along = np.cos(walk.tilt)
    across = np.sin(walk.tilt)
    turn = np.array([[along, 0, across], [0, 1, 0], [-across, 0, along]])
    turned = np.concatenate([imu[:, :3] @ turn, imu[:, 3:] @ turn], axis=1)
    noise = np.repeat([walk.turning, walk.acceleration], 3)
    return turned + noise * rng.standard_normal(imu.shape)


def _targets(rng: np.random.Generator, time: Array, walk: Walk) -> Array:
    """(n, 12) targets of a trot that begins at rest and changes, with slow waves added [rad]."""
    blocks = int(time[-1] // walk.change) + 1
    block = np.minimum((time // walk.change).astype(int), blocks - 1)
    frequency = rng.uniform(*walk.trot, blocks)[block]
    forwards = walk.stride * rng.uniform(-1, 1, blocks)[block]
    aside = walk.sway * rng.uniform(-1, 1, blocks)[block]
    turn = 0.5 * walk.stride * rng.uniform(-1, 1, blocks)[block]
    begins = 1 - np.exp(-time / 0.5)
    phase = 2 * np.pi * np.cumsum(frequency) * (time[1] - time[0])
    targets = []
    for leg, (x, y) in LEGS.items():
        own = phase + (0.0 if leg in ("FR", "RL") else np.pi)
        swing = np.maximum(np.sin(own), 0.0)
        hip = (forwards + turn * np.sign(y)) * np.cos(own)
        abduction = (aside + turn * np.sign(x)) * np.cos(own) * 0.3
        knee = -walk.lift * swing
        slow = _waves(rng, time, 3)
        columns = [abduction, hip - 0.5 * knee, knee]
        for place, column in enumerate(columns):
            reach = walk.restless * (0.4 if place == 0 else 1.0)
            targets.append(STANCE[place] + begins * (column + reach * slow[place]))
    return np.stack(targets, axis=1)


def _hold(robot: Robot, command: Array, steps: int) -> None:
    """Hold a command (12,) for some physics steps."""
    for _ in range(steps):
        robot.advance(command)


def _balance(state: Array, walk: Walk) -> Array:
    """(12,) what targets add so that feet land where the trunk falls to [rad]."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, state[3:7])
    forwards, aside, _ = turn.reshape(3, 3).T @ state[19:22]
    return np.tile([walk.balance * aside, -walk.balance * forwards, 0.0], 4)


def _waves(rng: np.random.Generator, time: Array, count: int) -> Array:
    """(count, n) sums of three slow sines each, of variance 1."""
    rates = rng.uniform(0.2, 1.5, (count, 3, 1))
    phases = rng.uniform(0, 2 * np.pi, (count, 3, 1))
    waves = np.sin(2 * np.pi * rates * time + phases).sum(axis=1)
    return np.asarray(waves * np.sqrt(2 / 3))


if __name__ == "__main__":
    given = [one for one in sys.argv[1:] if one != "--imu"]
    walked_with = replace(WALK, imu="--imu" in sys.argv)
    for path in write_quadruped(given[0] if given else ".", walk=walked_with):
        print(path)
