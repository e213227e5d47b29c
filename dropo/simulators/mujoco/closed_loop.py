"""A policy in closed loop with MuJoCo: many simulations at once, whose model fields may change as
they go.
"""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array, check_shape, require
from dropo.simulators.mujoco.simulator import HUGE
from dropo.simulators.mujoco.warnings import quiet

Policy = Callable[[Array, Ints, int], Array]
"""Actions (m, nu) at a control step, from the states (m, nq + nv) of the simulations `ids` (m,):
policy(states, ids, step).
"""


@dataclass(frozen=True, eq=False)
class Runs:
    """n simulations of up to T control steps; NaN behind a simulation's end.

    states: (n, T + 1, nq + nv), qpos then qvel; actions: (n, T, nu); lengths: (n,) control steps
    made.
    """

    states: Array
    actions: Array
    lengths: Ints


def closed_loop(
    model: mujoco.MjModel,
    policy: Policy,
    starts: Array,
    steps: int,
    *,
    frame_skip: int = 1,
    alive: Callable[[Array], NDArray[np.bool_]] | None = None,
    fields: Mapping[str, Array] | None = None,
    hold: int = 1,
    threads: int = 1,
) -> Runs:
    """Runs n simulations for up to `steps` control steps, each of `frame_skip` physics steps under
    one action.

    starts: (n, nq + nv). alive: states (m, nq + nv) -> (m,) bool; a simulation ends with the step
    after which it is False, or before the step in which it diverges. fields: array fields of the
    model by MjModel's names, (n, B, ...);
    row b holds during control steps b * hold to (b + 1) * hold - 1, and constants derived from it
    stay as they are. `model` itself is not changed. The numbers are the same for any number of
    threads.
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
    changing = [
        _expanded(batch, name, values, -(-steps // hold)) for name, values in (fields or {}).items()
    ]
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
    qpos[:], qvel[:] = np.split(starts, [model.nq], axis=1)
    runs = _empty(starts, steps, model.nu)
    ids = np.arange(len(starts))
    for t in range(steps):
        for live, values in changing if t % hold == 0 else ():
            live[:] = values[:, t // hold]
        command = policy(runs.states[ids, t], ids, t)
        ctrl[ids] = command
        failed = advance(batch, ids, frame_skip)
        after = np.hstack([qpos[ids], qvel[ids]])
        sound = ~failed & (np.abs(after) < HUGE).all(axis=1)  # also False for NaN
        ids = ids[sound]
        runs.states[ids, t + 1] = after[sound]
        runs.actions[ids, t] = command[sound]
        runs.lengths[ids] = t + 1
        ids = ids if alive is None else ids[alive(runs.states[ids, t + 1])]
        if not len(ids):
            break
    return runs


def _empty(starts: Array, steps: int, n_controls: int) -> Runs:
    n, size = starts.shape
    states = np.full((n, steps + 1, size), np.nan)
    states[:, 0] = starts
    return Runs(states, np.full((n, steps, n_controls), np.nan), np.zeros(n, dtype=np.int64))


def _expanded(batch: Batch, name: str, values: Array, blocks: int) -> tuple[Array, Array]:
    """The batch's live values of a field, (n, ...), and what they are to become, (n, B, ...)."""
    live = batch.expand(name)
    check_shape(name, values, (len(live), blocks, *live.shape[1:]), "closed_loop")
    return live, values


def _without_autoreset(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy in which a divergent simulation stays so: MuJoCo else puts it back to its initial
    state and goes on.
    """
    model = copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def advance(batch: Batch, ids: Ints, steps: int) -> NDArray[np.bool_]:
    """Makes so many physics steps in some simulations; (m,) in which of them MuJoCo gave up with an
    error.
    """
    try:
        with quiet():
            batch.step(ids, steps)
    except SimulationError:
        failed: NDArray[np.bool_] = batch.status[ids] != 0
        return failed
    return np.zeros(len(ids), dtype=bool)
