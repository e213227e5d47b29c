"""What a log says of each thing that its machine has and its model lacks, by plain MuJoCo."""

from collections.abc import Sequence

import mujoco
import numpy as np
from design import RandomDesign
from hidden import Machine, built
from logs import Log, Run

from dropo.core.services.validation import Array

SECONDS = 0.2
"""Length of the windows [s]."""


def worth(
    design: RandomDesign, machine: Machine, log: Log, things: Sequence[tuple[str, str | None]]
) -> dict[tuple[str, str | None], float]:
    """Compare the machine with the same but for one thing, in windows from its true states.

    What differs is compared with the noise of the positions, without what another place and speed
    at the beginning of a window would make up for; all other numbers are known. A fit to the same
    log, which has to find these too, knows less.

    Parameters
    ----------
    design : RandomDesign
        Its model.
    machine : Machine
        What moved.
    log : Log
        How it moved.
    things : sequence
        Effects and places of what is asked for.

    Returns
    -------
    dict
        By effect and place [nats].
    """
    found = {}
    for thing in things:
        others = [one for one in machine.hidden if (one.effect, one.place) != thing]
        found[thing] = _difference(machine, built(design, others), log)
    return found


def _difference(machine: Machine, other: Machine, log: Log) -> float:
    """Half the squared differences of two machines' windows in units of the noise."""
    length = max(4, round(SECONDS / log.control))
    shifts = np.stack([np.ones(length), np.arange(length)], axis=1)
    total = 0.0
    for run in log.runs:
        ways = [_windows(one, run, log.control, length) for one in (machine, other)]
        for difference in ways[1] - ways[0]:
            left = difference - shifts @ np.linalg.lstsq(shifts, difference, rcond=None)[0]
            total += 0.5 * float(np.sum((left / log.noise) ** 2))
    return total


def _windows(machine: Machine, run: Run, control: float, length: int) -> Array:
    """(W, length, n) positions after each control step of windows from true states."""
    model = machine.spec.compile()
    data = mujoco.MjData(model)
    every = round(control / model.opt.timestep)
    late = round(machine.delay / model.opt.timestep)
    told = np.concatenate([np.zeros((late, model.nu)), np.repeat(run.commands, every, axis=0)])
    found = []
    for start in range(0, len(run.positions) - length + 1, length):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = run.positions[start]
        data.qvel[:] = run.speeds[start]
        window = []
        for step in range(start * every, (start + length) * every):
            data.ctrl[:] = told[step]
            mujoco.mj_step(model, data)
            if (step + 1) % every == 0:
                window.append(data.qpos.copy())
        found.append(window)
    return np.array(found)
