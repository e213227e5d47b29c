"""An arm of one joint, its logs, with pushes that no command explains or with other payloads."""

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """<mujoco><option timestep="0.005"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" frictionloss="0.15" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.6"/></body></worldbody>
<actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
STEP = 0.01
NOISE = np.array([1e-3, 0.02])
PUSHES = {(0, 250, 290): 2.0, (2, 500, 540): -1.5}
"""Rows of trajectories, and the torque [N m] that acts there beside the command."""


def pushed_arm():
    """Its simulator, of which friction and mass are parameters."""
    friction = FieldParameter(
        "friction", 0.0, 0.6, "N m", field="dof_frictionloss", element="hinge"
    )
    mass = FieldParameter("mass", 0.3, 1.2, "kg", field="body_mass", element="link")
    return MujocoSimulator(
        mujoco.MjSpec.from_string(XML), [friction, mass], frame_skip=2, threads=1
    )


def recorded(simulator, pushes, spikes=0, seed=0, abrupt=False, noise=NOISE):
    """Three runs of 8 s under random commands, with noise, and if asked some wild velocities, or
    commands that change at once, every 0.4 s.
    """
    rng = np.random.default_rng(seed)
    model = simulator.model
    rows = 800
    parts = []
    for run in range(3):
        data = mujoco.MjData(model)
        command = (
            1.5 * np.sin(2 * np.pi * np.cumsum(rng.uniform(0.1, 1.5, rows)) * STEP)
            + 0.5 * rng.normal()
        )
        if abrupt:
            command = np.repeat(rng.uniform(-1.5, 1.5, rows // 40), 40)
        states = [np.concatenate([data.qpos, data.qvel])]
        for t in range(rows):
            data.ctrl[0] = command[t]
            data.qfrc_applied[0] = sum(
                torque for (r, a, b), torque in pushes.items() if r == run and a <= t < b
            )
            mujoco.mj_step(model, data, 2)
            states.append(np.concatenate([data.qpos, data.qvel]))
        states = np.array(states) + noise * rng.normal(size=(rows + 1, 2))
        states[rng.integers(0, rows, spikes), 1] += 3.0
        parts.append((states[:-1], command[:, None], states[1:]))
    ends = np.arange(3 * rows) % rows == rows - 1
    return Trajectories(
        *(np.concatenate(part) for part in zip(*parts, strict=True)), terminals=ends
    )


def with_payloads(payloads, seed=0):
    """A run of 3 s for each mass [kg]."""
    rng = np.random.default_rng(seed)
    parts = []
    for mass in payloads:
        model = mujoco.MjModel.from_xml_string(XML)
        model.body_mass[1] = mass
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        command = 1.2 * np.sin(2 * np.pi * np.cumsum(rng.uniform(0.1, 1.5, 300)) * STEP)
        states = [np.concatenate([data.qpos, data.qvel])]
        for torque in command:
            data.ctrl[0] = torque
            mujoco.mj_step(model, data, 2)
            states.append(np.concatenate([data.qpos, data.qvel]))
        states = np.array(states) + NOISE * rng.normal(size=(301, 2))
        parts.append((states[:-1], command[:, None], states[1:]))
    ends = np.arange(300 * len(payloads)) % 300 == 299
    return Trajectories(
        *(np.concatenate(part) for part in zip(*parts, strict=True)), terminals=ends
    )
