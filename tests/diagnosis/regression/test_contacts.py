"""The friction of contacts, from short windows that are simulated."""

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.regression.contacts import (
    ContactSettings,
    FoundFriction,
    find_friction,
    knows_starts,
)
from dropo.simulators.mujoco.simulator import MujocoSimulator

MODEL = """<mujoco><option timestep="0.005"/><worldbody>
<geom name="floor" type="plane" size="9 9 1" friction="0.2"/>
<body name="block" pos="0 0 0.049"><freejoint name="block"/>
<geom name="block" type="box" size="0.2 0.15 0.05" mass="2" friction="0.5"/></body>
</worldbody></mujoco>"""
"""A block that slides on a floor: the larger of the two frictions counts."""
FEW = ContactSettings(lengths=(0.03, 0.06), windows=60)
BIAS = 0.02


def slides(friction: float, seed: int) -> Trajectories:
    """Throws of the block, measured at each step: it slides until it rests."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.geom_friction[model.geom("block").id, 0] = friction
    rows = []
    ends = []
    for _ in range(12):
        data = mujoco.MjData(model)
        data.qvel[:2] = rng.uniform(0.5, 2.0) * np.array([1.0, 0.3])
        for _ in range(40):
            rows.append(np.concatenate([data.qpos, data.qvel]))
            mujoco.mj_step(model, data)
        ends.append(len(rows) - 1)
    table = np.array(rows)
    table[:, :3] += 1e-4 * rng.standard_normal((len(table), 3))
    table[:, 7:] += 1e-2 * rng.standard_normal((len(table), 6))
    terminals = np.zeros(len(table), dtype=bool)
    terminals[np.array(ends)] = True
    following = np.roll(table, -1, axis=0)
    kept = ~terminals
    last = np.roll(terminals, -1)[kept]
    return Trajectories(table[kept], np.zeros((kept.sum(), 0)), following[kept], last)


@pytest.fixture(scope="module")
def robot() -> MujocoSimulator:
    """The model, all of whose state is measured."""
    return MujocoSimulator(mujoco.MjSpec.from_string(MODEL), [], action=[], threads=1)


def found(robot: MujocoSimulator, friction: float, seed: int) -> FoundFriction:
    """What windows of a block of another friction say."""
    assert knows_starts(robot)
    answer = find_friction(robot, slides(friction, seed), BIAS, FEW)
    assert answer is not None
    return answer


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_friction_of_a_block(robot: MujocoSimulator, friction: float) -> None:
    """A block that is more or less slippery than its model is found within 3 standard errors."""
    answer = found(robot, friction, seed=1)
    assert answer.is_certain(3.0)
    assert abs(answer.size - (friction / 0.5 - 1)) < 3 * answer.se < 3 * 0.1
    assert answer.after < answer.before


def test_a_right_friction_is_not_found(robot: MujocoSimulator) -> None:
    """Nothing is certain of blocks that are as their model says."""
    assert not any(found(robot, 0.5, seed).is_certain(3.0) for seed in (2, 3, 4))
