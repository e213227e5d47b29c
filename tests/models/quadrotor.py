"""Simulated flights of a small quadrotor that holds its place, whose rotors and load are known."""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.problems.measured.crazypad import FULL_COMMAND, FULL_THRUST, MODEL, crazypad_problem
from dropo.problems.measured.recordings import RecordedRuns

ARM = 0.032527  # [m] of each rotor from the axes of the frame
TORQUE = 0.005964552  # [m] reaction torque by thrust
SIGNS = np.array([[-1, 1, -1], [-1, -1, 1], [1, -1, -1], [1, 1, 1]]) * [ARM, -ARM, TORQUE]
"""Torques about x, y and z by the thrust of each rotor."""
MIXER = np.linalg.inv(np.column_stack([np.ones(4), SIGNS]).T)
"""Thrusts (4,) by total thrust and the three torques."""

GUST = np.array([3e-4, 3e-4, 3e-4, 1e-6, 1e-6, 1e-6])
"""Random forces [N] and torques [N m] that set in at each control step."""


@dataclass(frozen=True)
class Flight:
    """What is unusual in a flight.

    Attributes
    ----------
    gain : tuple of four floats
        By which each rotor's thrust is too strong.
    load : float
        Mass [kg] at the rotor `at`.
    at : str
        Name of a site.
    """

    gain: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    load: float = 0.0
    at: str = "M1"


def fly(flight, rng, seconds=5.0):
    """The log of a flight, as CrazyPAD's are: time, position, and the motors' commands.

    The drone begins in the air and follows a slow path under a cascade of proportional and integral
    control, with gusts and a position sensor of 1 mm.
    """
    spec = mujoco.MjSpec.from_string(MODEL)
    if flight.load:
        body = spec.body("crazyflie")
        place = next(site.pos for site in spec.sites if site.name == flight.at)
        held = body.add_body(name="load", pos=place)
        held.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0, 0], mass=flight.load)
    model = spec.compile()
    model.actuator_gainprm[:, 0] *= 1 + np.array(flight.gain)
    # Strength differs from flight to flight, as that of real motors does.
    model.actuator_gainprm[:, 0] *= 1 + 0.005 * rng.standard_normal(4)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.5
    integral = np.zeros(3)
    held = np.zeros(3)
    gust = np.zeros(6)
    rows = []
    wanted = np.array([0.0, 0.0, 0.5])
    for step in range(round(seconds / 0.01)):
        time = 0.01 * step
        wanted[0] = 0.2 * np.sin(time)
        error = wanted - data.qpos[:3]
        held += 0.01 * error
        push = 6 * error + 4 * held - 4 * data.qvel[:3]
        rotation = data.body("crazyflie").xmat.reshape(3, 3) if step else np.eye(3)
        total = 0.027 * (9.81 + push[2])
        # Small angles: tilt about x moves to -y, tilt about y to +x.
        tilt = np.array([-push[1], push[0], 0.0]) / 9.81
        now = np.array([rotation[2, 1], -rotation[2, 0], rotation[1, 0]])
        off = tilt - now
        integral += 0.01 * off
        wanted_rate = 8 * off + 8 * integral
        torque = np.array([1.7e-5, 1.7e-5, 2.9e-5]) * 25 * (wanted_rate - data.qvel[3:])
        thrust = np.clip(MIXER @ np.concatenate([[total], torque]), 0, 0.15)
        gust = 0.9 * gust + GUST * rng.standard_normal(6)
        seen = data.qpos[:3] + 1e-3 * rng.standard_normal(3)
        rows.append([time, *seen, *(thrust * FULL_COMMAND / FULL_THRUST)])
        data.ctrl[:] = thrust
        data.xfrc_applied[1] = gust
        mujoco.mj_step(model, data, 10)
    table = np.array(rows[50:])
    return {"time": table[:, 0], "pos": table[:, 1:4], "motor": table[:, 4:]}


def flights(unusual, seed, normal=5, seconds=5.0):
    """The problem of some normal flights ("normal 0", ...) and unusual ones, by name."""
    named = {f"normal {i}": Flight() for i in range(normal)} | unusual
    rngs = np.random.default_rng(seed).spawn(len(named))
    logs = [fly(flight, rng, seconds) for flight, rng in zip(named.values(), rngs, strict=True)]
    problem: Problem = crazypad_problem(RecordedRuns(tuple(named), tuple(logs)), threads=1)
    return problem
