"""A small quadrotor in normal flights and with known faults: blades cut, weights, tape.

Data: Masalimov, Muslimov, Kozlov, Munasypov, "CrazyPAD", Data 9, 2024; MIT.
"""

from functools import partial

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.logs.grids import held_means
from dropo.logs.signals.resampling import resample
from dropo.logs.signals.stamps import increasing
from dropo.mjmodel.joints import model_joints
from dropo.problems.measured.recordings import Channels, RecordedRuns, find_runs
from dropo.simulators.mujoco.simulator import MujocoSimulator

FRAME_SKIP = 10  # physics steps of 1 ms: 10 ms, a row of the log
GRAVITY = 9.81  # [m/s^2]
FULL_COMMAND = 65535.0
FULL_THRUST = 0.060 * GRAVITY / 4
"""[N] of a rotor under the full command.

The firmware takes commands for thrusts, of which all four at their fullest lift 60 g, and finds
the duty for that from the battery's voltage (Bitcraze, crazyflie-firmware, motors.c).
"""
AIRBORNE = 0.3
"""Height [m] above which a drone flies free of the ground; it cruises at 0.5 m."""
SMOOTHING = 0.08
"""Standard deviation [s] of the kernel that differentiates positions."""
REACH = 8.0
"""Half the length of that kernel, in its widths: cut at 4, a position gave an acceleration."""
LONGEST_GAP = 0.05
"""Seconds between rows beyond which a flight is cut."""
MARGIN = 0.2
"""Seconds around a gap in which smoothed positions are not trusted."""
SHORTEST = 1.0
"""Seconds of a stretch in the air below which it is left out."""
NORMAL = ("*normal_flight*",)
"""The runs that all others are compared with."""
EFFECTS = ("actuator_gain<0", "payload")
"""What a fault may be: a rotor that gives less, or something that is carried at one."""
TOLERANCES = {"body_com": 3e-4}
"""[m] of the centre of mass, from flight to flight: the battery is put back by hand."""

MODEL = """
<mujoco model="crazyflie">
  <!-- Crazyflie 2.x: x forward, y left, z up; thrusts [N] of four rotors as commands.
       Mass with battery 27 g, 92 mm between opposite motors: Bitcraze, data sheet of the
       Crazyflie 2.0. Inertia and torque by thrust (0.005964552 m): J. Foerster, System
       identification of the Crazyflie 2.0 nano quadrocopter, ETH Zurich, 2015.
       M1 front right, M2 rear right, M3 rear left, M4 front left; M1 and M3 turn
       counter-clockwise, so they turn the body clockwise. Decks, the motors' lag, drag and the
       ground's effect are left out. -->
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="crazyflie" pos="0 0 0.015">
      <freejoint name="free"/>
      <inertial pos="0 0 0" mass="0.027"
        fullinertia="16.571710e-6 16.655602e-6 29.261652e-6 0.830806e-6 0.718277e-6 1.800197e-6"/>
      <geom name="frame" type="box" size="0.035 0.035 0.0145" mass="0"/>
      <site name="M1" pos="0.032527 -0.032527 0"/>
      <site name="M2" pos="-0.032527 -0.032527 0"/>
      <site name="M3" pos="-0.032527 0.032527 0"/>
      <site name="M4" pos="0.032527 0.032527 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="M1" site="M1" gear="0 0 1 0 0 -0.005964552" ctrlrange="0 0.16"/>
    <motor name="M2" site="M2" gear="0 0 1 0 0 0.005964552" ctrlrange="0 0.16"/>
    <motor name="M3" site="M3" gear="0 0 1 0 0 -0.005964552" ctrlrange="0 0.16"/>
    <motor name="M4" site="M4" gear="0 0 1 0 0 0.005964552" ctrlrange="0 0.16"/>
  </actuator>
</mujoco>
"""


def crazypad(threads: int = 0) -> Problem:
    """Flights of a quadrotor, normal ones and ones with faults, which a diagnosis is to name.

    Nothing is to be fitted. `dropo diagnose crazypad` compares every flight with the normal ones (a
    normal one with the other normal ones), and says which rotor gives less, or carries a weight.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With the normal flights as its reference.

    Raises
    ------
    BadFile
        If the external data are not found.

    Notes
    -----
    Pitch was not logged, and positions alone are in both kinds of logs. Velocities and
    accelerations are derivatives of smoothed positions; thrust acts along the body's z, so that the
    acceleration gives the tilt, and its change the rates. The yaw is taken to be held.
    """
    runs, _ = find_runs("crazypad", "model.xml", "the CrazyPAD flights")
    return crazypad_problem(runs, threads)


def crazypad_problem(runs: RecordedRuns, threads: int = 0) -> Problem:
    """The problem of some of the flights.

    Parameters
    ----------
    runs : RecordedRuns
        With `time`, `pos` and either `motor` or `cmd`.
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With the stretches in which the drone flies; each flight is a group.
    """
    simulator = MujocoSimulator(
        mujoco.MjSpec.from_string(MODEL),
        (),
        observation=["qpos", "qvel"],
        frame_skip=FRAME_SKIP,
        threads=threads,
    )
    lag = model_joints(simulator.model).velocity_lag
    stretches = [flown(run, simulator.control_step, lag) for run in runs.channels]
    parts = [part for flight in stretches for part in flight]
    lengths = [len(time) - 1 for time, _, _ in parts]
    flight = np.repeat(np.arange(len(stretches)), [len(found) for found in stretches])
    data = Trajectories(
        np.concatenate([rows[:-1] for _, rows, _ in parts]),
        np.concatenate([actions[:-1] for _, _, actions in parts]),
        np.concatenate([rows[1:] for _, rows, _ in parts]),
        np.concatenate([np.arange(n) == n - 1 for n in lengths]),
        group=np.repeat(flight, lengths),
        time=np.concatenate([time[:-1] for time, _, _ in parts]),
    )
    return Problem(
        "crazypad",
        simulator,
        data,
        run_names=tuple(runs.names[i] for i in flight.tolist()),
        reference=NORMAL,
        settings={"effects": EFFECTS, "tolerances": TOLERANCES},
    )


def flown(run: Channels, step: float, lag: float = 0.0) -> list[tuple[Array, Array, Array]]:
    """The stretches of a flight in the air, on a grid of control steps.

    Parameters
    ----------
    run : mapping
        `time` (n,) [s], `pos` (n, 3) [m], and `motor` (n, 4) or `cmd` (n, 4) in firmware units.
    step : float
        Of the grid [s].
    lag : float
        Delay of the model's velocities behind its positions [s], which those given here share.

    Returns
    -------
    list of (time (m,), states (m, 13), thrusts (m, 4))
        Seconds from the log's first row; qpos and qvel of the free body; [N].
    """
    time = np.asarray(run["time"], dtype=float)
    keep = increasing(time)
    time = time[keep] - time[0]
    position = np.asarray(run["pos"], dtype=float)[keep]
    thrust = FULL_THRUST * commanded(run)[keep]
    grid = np.arange(0.0, time[-1], step)
    heading = resample(time, yaw(run)[keep][:, None], grid, method="linear")[:, 0]
    states = states_of(resample(time, position, grid), heading, step, lag)
    thrusts = held_means(time, thrust, grid, step)

    usable = states[:, 2] > AIRBORNE
    for gap in np.flatnonzero(np.diff(time) > LONGEST_GAP):
        usable &= (grid < time[gap] - MARGIN) | (grid > time[gap + 1] + MARGIN)
    found = []
    for rows in np.split(np.arange(len(grid)), np.flatnonzero(np.diff(usable)) + 1):
        if usable[rows[0]] and len(rows) * step >= SHORTEST:
            found.append((grid[rows], states[rows], thrusts[rows]))
    return found


def commanded(run: Channels) -> Array:
    """The commands of the four motors (n, 4), as fractions of the full one.

    Parameters
    ----------
    run : mapping
        `motor`, or the controller's `cmd`: thrust, roll, pitch, yaw, mixed as the firmware does
        (crazyflie-firmware, power_distribution).

    Returns
    -------
    (n, 4) array
        Between 0 and 1 where they are mixed.
    """
    if "motor" in run:
        return np.asarray(run["motor"], dtype=float) / FULL_COMMAND
    total, roll, pitch, yaw = np.asarray(run["cmd"], dtype=float).T
    roll = roll / 2
    pitch = pitch / 2
    mixed = np.stack(
        [
            total - roll + pitch + yaw,
            total - roll - pitch - yaw,
            total + roll - pitch + yaw,
            total + roll + pitch - yaw,
        ],
        axis=1,
    )
    return np.asarray(np.clip(mixed / FULL_COMMAND, 0.0, 1.0))


def yaw(run: Channels) -> Array:
    """The heading (n,) [rad]: as logged, else the integral of the gyro, else 0.

    Parameters
    ----------
    run : mapping
        `time`, and perhaps `yaw` or `gyro` [rad/s].

    Returns
    -------
    (n,) array
        The heading [rad], without jumps.
    """
    time = np.asarray(run["time"], dtype=float)
    if "yaw" in run:
        return np.unwrap(np.asarray(run["yaw"], dtype=float).reshape(len(time)))
    if "gyro" in run:
        rate = np.asarray(run["gyro"], dtype=float)[:, 2]
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)
        return np.concatenate([[0.0], np.cumsum(steps)])
    return np.zeros(len(time))


def states_of(position: Array, heading: Array, step: float, lag: float = 0.0) -> Array:
    """States (n, 13) of a body that thrusts along its z, from its positions and headings.

    Parameters
    ----------
    position : (n, 3) array
        In the world, on a grid [m].
    heading : (n,) array
        Turn about the body's z [rad].
    step : float
        Of the grid [s].
    lag : float
        Delay of the model's velocities behind its positions [s], which those given here share.

    Returns
    -------
    (n, 13) array
        Position, quaternion (w, x, y, z), velocity in the world, rates in the body.
    """
    smooth = partial(
        gaussian_filter1d, sigma=SMOOTHING / step, axis=0, mode="nearest", truncate=REACH
    )

    def derived(values: Array, order: int) -> Array:
        return np.asarray(smooth(values, order=order) / step**order)

    up = derived(position, 2) + np.array([0.0, 0.0, GRAVITY])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    # The shortest turn that takes z to `up`, after the turn about z.
    w = 1 + up[:, 2]
    x = -up[:, 1]
    y = up[:, 0]
    half = derived(heading, 0) / 2
    cos, sin = np.cos(half), np.sin(half)
    quaternion = np.stack([w * cos, x * cos + y * sin, y * cos - x * sin, w * sin], axis=1)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    # Rates in the body: twice the vector part of conj(q) dq/dt.
    change = np.gradient(quaternion, step, axis=0)
    vector = quaternion[:, 1:]
    rates = quaternion[:, :1] * change[:, 1:] - change[:, :1] * vector
    rates = 2 * (rates - np.cross(vector, change[:, 1:]))
    velocity = derived(position, 1) - lag * derived(position, 2)
    rates = rates - lag * np.gradient(rates, step, axis=0)
    return np.concatenate([derived(position, 0), quaternion, velocity, rates], axis=1)
