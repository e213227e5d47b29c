"""Real tosses of an acrylic cube onto a board, tracked at 148 Hz (Pfrommer, Halm, Posa 2020, ContactNets; BSD-3)."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dropo.core.checks import Array
from dropo.core.data import Trajectories
from dropo.core.problem import Problem
from dropo.problems.outside import find_data, missing
from dropo.simulators.fields import FieldParameter
from dropo.simulators.mujoco import MujocoSimulator

HORIZON = 15  # control steps of 1/148 s: 101 ms
HELD_OUT = 3  # every third toss is kept from the fit
FIRST = 90  # tosses fitted, of the 267 that are not held out, unless more transitions are asked for
SETTINGS = {"family": "log_normal", "parameters": ()}  # of a fit; a diagnosis is to find the contact's numbers itself
PARAMETERS = (
    FieldParameter("sliding_friction", 0.05, 1.0, field="geom_friction", element="box", index=0),
    FieldParameter("contact_time", 0.005, 0.08, "s", field="geom_solref", element="box", index=0),
    FieldParameter("contact_damping", 0.1, 2.0, field="geom_solref", element="box", index=1),
)


def cube_toss(threads: int = 0) -> Problem:
    """Sliding friction, contact time constant and damping ratio of a real cube on a board, over horizons of 101 ms."""
    runs, model = find_data("cube-toss/runs.npz"), find_data("cube-toss/model.xml")
    if runs is None or model is None:
        raise missing("cube-toss/runs.npz", "the ContactNets cube tosses")
    simulator = MujocoSimulator(cube_spec(model), PARAMETERS, observation=["qpos", "qvel"], frame_skip=4, threads=threads)
    with np.load(runs, allow_pickle=False) as kept:
        arrays = {name: kept[name] for name in kept.files}
    number = np.arange(len(arrays["names"]))
    kept_back = number % HELD_OUT == HELD_OUT - 1
    fitted, held_out = tosses(arrays, number[~kept_back]), tosses(arrays, number[kept_back])
    first = fitted.only(np.arange(FIRST))
    return Problem("cube-toss", simulator, first, length=HORIZON, held_out=held_out, everything=fitted, settings=SETTINGS)


def cube_spec(path: Path) -> mujoco.MjSpec:
    """The cube's numbers rule its contact with the board: MuJoCo would take the larger friction of the two."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.geom("box").priority = 1
    return spec


def tosses(arrays: Mapping[str, Any], which: Iterable[int]) -> Trajectories:
    """One trajectory a toss: qpos (7) and qvel (6) of the free joint, no command, and its number as the group."""
    parts = [(int(i), _states(arrays, int(i))) for i in which]
    return Trajectories(
        np.concatenate([states[:-1] for _, states in parts]),
        np.zeros((sum(len(states) - 1 for _, states in parts), 0)),
        np.concatenate([states[1:] for _, states in parts]),
        np.concatenate([np.arange(len(states) - 1) == len(states) - 2 for _, states in parts]),
        group=np.repeat([i for i, _ in parts], [len(states) - 1 for _, states in parts]),
        time=np.concatenate([arrays[f"{i:03d}/time"][:-1] for i, _ in parts]),
    )


def _states(arrays: Mapping[str, Any], i: int) -> Array:
    states = np.concatenate([arrays[f"{i:03d}/qpos"], arrays[f"{i:03d}/qvel"]], axis=1).astype(float)
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)  # stored as float32
    return states
