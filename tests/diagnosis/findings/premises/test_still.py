"""A joint that never moves is named, and the diagnosis goes on with the others."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument
from dropo.diagnosis.diagnose import Diagnose
from dropo.diagnosis.findings.premises.short import ShortSettings, short_sentences
from dropo.diagnosis.findings.premises.still import still_sentences
from dropo.diagnosis.regression.quick import QuickDiagnose, QuickSettings
from dropo.problems.simulated.recording import record
from dropo.problems.simulated.robots import simulated_robot
from tests.models.hidden_in_arm import instance

STAYS = 0.3  # [rad]
EFFECTS = ("joint_damping", "joint_friction", "actuator_gain")
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


@pytest.fixture(scope="module")
def stuck():
    """The position arm with more damping at its lift, and a last joint that something holds."""
    arm = simulated_robot("position-arm", ())
    holding = arm.simulator.with_held_joints({2: STAYS})
    rng = np.random.default_rng(3)
    starts = arm.starts(rng, arm.episodes)
    starts[:, 2] = STAYS
    starts[:, 5] = 0.0
    data = record(
        holding,
        [(instance(arm.simulator, "joint_damping:lift"), np.array([0.5]))],
        np.zeros(0),
        starts,
        arm.controller,
        arm.steps,
        actions=arm.actions,
        noise=1e-3,
        alive=arm.alive,
        rng=rng,
        memory=arm.memory,
    )
    rows, after = data.observations.copy(), data.next_observations.copy()
    rows[:, 2] = after[:, 2] = STAYS
    rows[:, 5] = after[:, 5] = 0.0
    quiet = replace(data, observations=rows, next_observations=after)
    return Problem("stuck", arm.simulator, quiet, start_noise=True)


@pytest.fixture(scope="module")
def found(stuck):
    """What a diagnosis says of it."""
    return Diagnose(EFFECTS, windows=24, disturbances=False).run(stuck)


def test_the_others_are_diagnosed(found):
    """What is hidden at another joint is named with its size, and nothing else."""
    (cause,) = found.causes
    assert (cause.effect, cause.target) == ("joint_damping", "lift")
    assert cause.estimate["damping"].value == pytest.approx(0.5, rel=0.02)
    assert found.verdict == "explained"


def test_the_joint_is_named(found):
    """In one sentence, with where it stays; what cannot be told of it is listed."""
    (said,) = [text for text in found.warnings if "'bend'" in text]
    assert "never moves" in said
    assert "0.3 rad" in said
    (untold,) = [text for text in found.undetermined if "never moves" in text]
    for label in ("joint_damping:bend", "joint_friction:bend", "actuator_gain:bend_servo"):
        assert label in untold


def test_the_extended_model_is_free(found, stuck):
    """It has what was found, and no joint is held in it."""
    extended = found.problem.simulator
    assert found.problem.trajectories is stuck.trajectories
    assert extended.observation == stuck.simulator.observation
    np.testing.assert_array_equal(extended.model.qpos0, stuck.simulator.model.qpos0)
    np.testing.assert_allclose(extended.model.body_pos, stuck.simulator.model.body_pos)
    np.testing.assert_array_equal(extended.model.dof_armature, stuck.simulator.model.dof_armature)
    assert [one.effect for one, _ in extended.fixed] == ["joint_damping"]


def test_regression_leaves_it_out(stuck):
    """The joint is named, its drive's force is no force that is missing."""
    quick = QuickDiagnose().run(stuck)
    assert any("'bend' never moves" in text for text in quick.warnings)
    assert quick.verdict == "explained"
    assert not [cause for cause in quick.causes if cause.target in ("bend", "bend_servo")]


TICK = 2 * np.pi / 65536


def by_encoders(stuck, flickers, tick=TICK):
    """What encoders read, the last joint's going to and fro by so many ticks."""
    data = stuck.trajectories
    rows, after = data.observations.copy(), data.next_observations.copy()
    around = np.arange(len(rows)) % (flickers + 1)
    for table in (rows, after):
        table[:, 2] = STAYS + around * tick
        table[:, :3] = np.round(table[:, :3] / tick) * tick
    return replace(stuck, trajectories=replace(data, observations=rows, next_observations=after))


@pytest.mark.parametrize("ticks", [1, 60])
def test_a_joint_that_only_flickers_is_named(stuck, ticks):
    """By a tick, or by many that are little beside the other joints' motion."""
    (said,) = still_sentences(by_encoders(stuck, ticks))
    assert said.startswith("The joint 'bend' hardly moves in these data:")
    count = "1 tick" if ticks == 1 else f"{ticks} ticks"
    assert f"over {count} of its encoder ({ticks * TICK:.3g} rad)" in said


def test_the_search_by_simulation_says_so_too(stuck):
    """Of a joint that flickers, in the same sentence."""
    flickering = by_encoders(stuck, 60)
    data = flickering.trajectories
    rows, after = data.observations.copy(), data.next_observations.copy()
    for table in (rows, after):
        table[:, 5] = 1e-3 * np.sin(np.arange(len(table)))
    moving = replace(data, observations=rows, next_observations=after)
    flickering = replace(flickering, trajectories=moving)
    found = Diagnose(("joint_damping",), windows=16, disturbances=False).run(flickering)
    assert set(still_sentences(flickering)) <= set(found.warnings)


def test_a_joint_that_moves_is_not_named(stuck):
    """Over thousands of ticks; over as few as a coarse encoder has, as all joints do; and little,
    without an encoder's ticks.
    """
    assert still_sentences(by_encoders(stuck, 3000)) == ()
    assert still_sentences(by_encoders(stuck, 20, tick=0.02)) == ()
    data = by_encoders(stuck, 1).trajectories
    rows, after = data.observations.copy(), data.next_observations.copy()
    rows[:, 2] += 1e-3 * np.random.default_rng(0).normal(size=len(rows))
    smooth = replace(data, observations=rows, next_observations=after)
    assert still_sentences(replace(stuck, trajectories=smooth)) == ()


def test_a_short_log_is_named(stuck):
    """With its length, and what is enough; not one that is as long as that."""
    long = len(stuck.trajectories) * stuck.simulator.control_step
    assert short_sentences(stuck, ShortSettings(short=0.9 * long)) == ()
    short = ShortSettings(short=1.1 * long, enough=60.0)
    (said,) = short_sentences(stuck, short)
    assert said.startswith(f"The data are {long:.3g} s long")
    assert "60 s" in said
    assert said in QuickDiagnose(settings=QuickSettings(short=short)).run(stuck).warnings


def test_a_joint_is_held_where_it_stays():
    """Poses of the model that holds it are those of the model with the joint there, and it stays
    under forces.
    """
    free = simulated_robot("position-arm", ()).simulator
    held = free.with_held_joints({1: 0.4}).model
    assert held.qpos0[1] == 0.4
    for angle in (-0.5, 0.7):
        places = []
        for model in (free.model, held):
            data = mujoco.MjData(model)
            data.qpos[:] = [0.2, 0.4, angle]
            mujoco.mj_forward(model, data)
            places.append(np.concatenate([data.xpos.ravel(), data.xmat.ravel()]))
        np.testing.assert_allclose(*places, atol=1e-12)
    data = mujoco.MjData(held)
    data.qpos[:] = held.qpos0
    data.ctrl[:] = [1.0, -1.0, 1.0]
    mujoco.mj_step(held, data, 200)
    assert data.qpos[1] == pytest.approx(0.4, abs=1e-3)
    assert abs(data.qpos[0]) > 0.1


def test_a_stuck_sensor_beside_a_joint_that_moves_is_refused(stuck):
    """A position that moves and a velocity that does not is no joint that stays."""
    data = stuck.trajectories
    rows, after = data.observations.copy(), data.next_observations.copy()
    rows[:, 3] = after[:, 3] = 0.0
    broken = replace(stuck, trajectories=replace(data, observations=rows, next_observations=after))
    with pytest.raises(BadArgument, match=r"signal 'qvel\.yaw' is the same in all the data"):
        Diagnose(EFFECTS, windows=24).run(broken)
