"""The slow, obvious twin of MujocoSimulator: each segment on its own, one mj_step after the other
in a Python loop.
"""

import copy

import mujoco
import numpy as np


def load(xml):
    """A model as the simulator takes it: warm starts off, and a divergent simulation is not put
    back to its start.
    """
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_WARMSTART | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    return model


def replay_one_by_one(model, segments, columns, frame_skip=1):
    """(R, P) observations at the compared rows. columns: (field, place) of each of the P columns,
    such as ("qpos", 0).
    """
    seen = {}
    ends = {}
    for i, steps in enumerate(segments.steps):
        data = _start(model, segments, i, columns, ends)
        for j, transition in enumerate(steps[steps >= 0]):
            data.ctrl[:] = segments.trajectories.actions[transition]
            for _ in range(frame_skip):
                mujoco.mj_step(model, data)
            seen[i, j] = _observe(model, data, columns)
        ends[i] = data
    return np.array([seen[row] for row in zip(*segments.rows, strict=True)])


def _start(model, segments, i, columns, ends):
    data = mujoco.MjData(model)
    before = segments.previous[i]
    if before >= 0:
        data.qpos[:], data.qvel[:], data.act[:] = (
            ends[before].qpos,
            ends[before].qvel,
            ends[before].act,
        )
    for (field, place), value, is_set in zip(
        columns, segments.starts[i], segments.set_columns, strict=True
    ):
        if field != "sensordata" and (before < 0 or is_set):
            getattr(data, field)[place] = value
    return data


def _observe(model, data, columns):
    now = copy.copy(data)
    mujoco.mj_forward(
        model, now
    )  # the sensors of this state, and not of the one before the last step
    return [getattr(now, field)[place] for field, place in columns]
