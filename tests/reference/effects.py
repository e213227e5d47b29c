"""Slow, obvious twins of effects: one mj_step after the other, commands filtered by hand."""

import mujoco
import numpy as np
from scipy.signal import lsim

FINE = 2000  # parts of a physics step


def replay(model, robot, commands=None, applied_force=None, wrench=None, move=0.0):
    """(R, nq + nv) states after every control step of the robot's segments.

    commands: (T, nu) one a physics step of all rows, by default the rows' actions; push(model,
    data) -> generalised forces;
    wrench: (body, (6,)); move: (nq + nv,) added to starts, or (N, nq + nv).
    """
    skip = robot.simulator.frame_skip
    rows = []
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    held = np.repeat(robot.data.actions, skip, axis=0) if commands is None else commands
    for steps, start in zip(robot.segments.steps, robot.segments.starts + move, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq : model.nq + model.nv]
        data.act[:] = start[model.nq + model.nv :][: model.na]
        if wrench is not None:
            data.xfrc_applied[wrench[0]] = wrench[1]
        for row in steps:
            for i in range(skip):
                data.ctrl[:] = held[row * skip + i]
                if applied_force is not None:
                    mujoco.mj_forward(model, data)
                    data.qfrc_applied[:] = applied_force(model, data)
                mujoco.mj_step(model, data)
            rows.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(rows)


def held(robot, column):
    """The clamped commands of one actuator, for each trajectory (T,), one a physics step."""
    model = robot.simulator.model
    skip = robot.simulator.frame_skip
    low, high = (
        model.actuator_ctrlrange[column]
        if model.actuator_ctrllimited[column]
        else (-np.inf, np.inf)
    )
    for first, last in robot.data.spans:
        yield np.repeat(
            [min(max(u, low), high) for u in robot.data.actions[first:last, column]], skip
        )


def changed(robot, column, change):
    """(T, nu) commands of all rows, one a physics step, with one column put through `change`, each
    trajectory on its own.
    """
    columns = [np.concatenate(list(held(robot, i))) for i in range(robot.simulator.model.nu)]
    columns[column] = np.concatenate([change(one) for one in held(robot, column)])
    return np.stack(columns, axis=1)


def late(signal, steps):
    """A signal (T,), constant in each step, so many steps late: the mean over each step, from fine
    samples.
    """
    times = (np.arange(len(signal) * FINE) + 0.5) / FINE - steps
    return signal[np.maximum(np.floor(times), 0).astype(int)].reshape(-1, FINE).mean(axis=1)


def lagging(signal, step, time):
    """The mean over each step of x, T dx/dt = u - x, by scipy's simulation of x and integral."""
    system = ([[-1 / time, 0], [1, 0]], [[1 / time], [0]], [[0, 1]], [[0]])
    times = step * np.arange(len(signal) + 1)
    _, integral, _ = lsim(system, np.append(signal, 0), times, X0=[signal[0], 0], interp=False)
    return np.diff(integral) / step


def with_play(signal, width):
    """A follower that is drawn along at either end of a gap."""
    out = []
    at = signal[0]
    for value in signal:
        if value - at > width / 2:
            at = value - width / 2
        elif at - value > width / 2:
            at = value + width / 2
        out.append(at)
    return np.array(out)


def through_lash(signal, step, impulse):
    """What passes a gear with play: a rotor crosses it against its drag, in many small steps."""
    out = []
    taken = 0.0 if signal[0] < 0 else impulse
    for value in signal:
        passed = 0
        for _ in range(FINE):
            free = (value > 0 and taken < impulse) or (value < 0 and taken > 0)
            taken += free * value * step / FINE
            passed += not free
        out.append(value * passed / FINE)
    return np.array(out)
