"""A policy in closed loop with MuJoCo: many simulations at once, with models that may change."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array, check_shape, require
from dropo.mjmodel.timers import without_timers
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.mujoco.simulator import MAX_STATE, MujocoSimulator
from dropo.simulators.mujoco.worker import Worker

BatchPolicy = Callable[[Array, Ints, int], Array]
"""policy(states (m, nq + nv), ids (m,), step) -> actions (m, nu) of the simulations `ids`."""


@dataclass(frozen=True, eq=False)
class Rollouts:
    """n simulations of up to T control steps; NaN behind the end of a simulation.

    Attributes
    ----------
    states : (n, T + 1, nq + nv) array
        Positions, then velocities.
    actions : (n, T, nu) array
        Commands.
    lengths : (n,) array of int
        Control steps made.
    """

    states: Array
    actions: Array
    lengths: Ints


def closed_loop(
    model: mujoco.MjModel,
    policy: BatchPolicy,
    starts: Array,
    steps: int,
    *,
    frame_skip: int = 1,
    alive: Callable[[Array], NDArray[np.bool_]] | None = None,
    fields: Mapping[str, Array] | None = None,
    hold: int = 1,
    threads: int = 1,
) -> Rollouts:
    """Simulate a policy in closed loop with MuJoCo, many simulations at once.

    The numbers are the same for any number of threads.

    Parameters
    ----------
    model : MjModel
        The compiled model, which is not changed.
    policy : callable
        policy(states (m, nq + nv), ids (m,), step) -> commands (m, nu).
    starts : (n, nq + nv) array
        Start states: positions, then velocities.
    steps : int
        The largest number of control steps.
    frame_skip : int
        Physics steps under one action.
    alive : callable, optional
        alive(states (m, nq + nv)) -> (m,) bool. A simulation ends with the step after which it is
        False, or before the step in which it diverges.
    fields : mapping of str to (n, B, ...) array, optional
        Array fields of the model by MjModel's names. Row b holds during the control steps b * hold
        to (b + 1) * hold - 1; constants derived from a field stay as they are.
    hold : int
        Control steps for which the rows of `fields` hold.
    threads : int
        The number of threads.

    Returns
    -------
    Rollouts

    Raises
    ------
    BadArgument
        If `steps`, `frame_skip` or `hold` is below 1, or an array has another shape.
    """
    require(
        min(steps, frame_skip, hold) >= 1,
        "steps, frame_skip, hold",
        "at least 1",
        (steps, frame_skip, hold),
        "closed_loop",
    )
    check_shape("starts", starts, (None, model.nq + model.nv), "closed_loop")
    batch = Batch(_without_autoreset(model), len(starts), threads)
    blocks = -(-steps // hold)
    changing = [_expand(batch, name, rows, blocks) for name, rows in (fields or {}).items()]
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
    qpos[:], qvel[:] = np.split(starts, [model.nq], axis=1)
    rollouts = _empty(starts, steps, model.nu)
    ids = np.arange(len(starts))  # the simulations that go on
    for t in range(steps):
        if t % hold == 0:
            for live, rows in changing:
                live[:] = rows[:, t // hold]
        commands = policy(rollouts.states[ids, t], ids, t)
        ctrl[ids] = commands
        failed = advance(batch, ids, frame_skip)
        after = np.hstack([qpos[ids], qvel[ids]])
        valid = ~failed & (np.abs(after) < MAX_STATE).all(axis=1)  # also False for NaN
        ids = ids[valid]
        rollouts.states[ids, t + 1] = after[valid]
        rollouts.actions[ids, t] = commands[valid]
        rollouts.lengths[ids] = t + 1
        if alive is not None:
            ids = ids[alive(rollouts.states[ids, t + 1])]
        if not len(ids):
            break
    return rollouts


def _empty(starts: Array, steps: int, n_controls: int) -> Rollouts:
    """Simulations of which only the start is known."""
    n, size = starts.shape
    states = np.full((n, steps + 1, size), np.nan)
    states[:, 0] = starts
    return Rollouts(states, np.full((n, steps, n_controls), np.nan), np.zeros(n, dtype=np.int64))


def _expand(batch: Batch, name: str, rows: Array, blocks: int) -> tuple[Array, Array]:
    """The batch's own values of a field, (n, ...), and what they become, (n, B, ...)."""
    live = batch.expand(name)
    check_shape(name, rows, (len(live), blocks, *live.shape[1:]), "closed_loop")
    return live, rows


def _without_autoreset(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy in which a diverged simulation stays so; else MuJoCo starts it anew and goes on."""
    model = copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def advance(batch: Batch, ids: Ints, steps: int) -> NDArray[np.bool_]:
    """Advance some simulations of a batch by physics steps.

    Parameters
    ----------
    batch : Batch
        The simulations.
    ids : (m,) array of int
        Those that are advanced.
    steps : int
        The number of physics steps.

    Returns
    -------
    (m,) array of bool
        Which of them MuJoCo ended with an error.
    """
    try:
        with suppress_mujoco_warnings(), without_timers():
            batch.step(ids, steps)
    except SimulationError:
        failed: NDArray[np.bool_] = batch.status[ids] != 0
        return failed
    return np.zeros(len(ids), dtype=bool)


def fields_of(simulator: MujocoSimulator, values: Array) -> tuple[mujoco.MjModel, dict[str, Array]]:
    """Give parameter vectors as fields of a model, for `closed_loop`.

    Parameters
    ----------
    simulator : MujocoSimulator
        The simulator whose parameters they are.
    values : (n, d) array
        Parameter vectors.

    Returns
    -------
    model : mujoco.MjModel
        A model.
    fields : dict of (n, 1, ...) arrays
        Every field of it that the vectors change, derived ones too.
    """
    worker = Worker(simulator.model, simulator.bindings)
    arrays: dict[str, list[Array]] = {}
    for name in sorted(MODEL_FIELDS):
        if isinstance(getattr(simulator.model, name, None), np.ndarray):
            arrays[name] = []
    for value in values:
        worker.set(value)
        for name, own in arrays.items():
            own.append(getattr(worker.model, name).copy())
    fields = {}
    for name, own in arrays.items():
        stacked = np.stack(own)[:, None]
        if (stacked != getattr(worker.model, name)).any():
            fields[name] = stacked
    return worker.model, fields
