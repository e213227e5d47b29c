"""Estimates that are those of the model's physics step are named, and no others."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.dropo import DROPO
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.toy import SlidingBlock, simulate

SERVO = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>
  <body><joint name="rail" type="slide" axis="1 0 0" damping="5"/>
    <geom size="0.1" mass="1"/></body></worldbody>
  <actuator><position joint="rail" kp="300"/></actuator></mujoco>"""
TRUTH = np.array([5.0])
NOISE = np.array([2e-5, 2e-3])
ROWS = 200


def servo(step: float = 0.01, made_by: int = 8, noise: float = 1.0) -> Problem:
    """Steps of 20 ms of a servo, by a machine whose physics steps are so many times finer."""
    damping = FieldParameter("damping", 0.5, 10.0, "N s/m", field="dof_damping", element="rail")
    spec = mujoco.MjSpec.from_string(SERVO.format(step=step))
    simulator = MujocoSimulator(spec, [damping], frame_skip=round(0.02 / step), threads=1)
    rng = np.random.default_rng(0)
    rows = rng.normal(0, 1, (ROWS, 2)) * [0.002, 0.3]
    log = Trajectories(rows, np.zeros((ROWS, 1)), rows, np.ones(ROWS, dtype=bool))
    machine = simulator.with_finer_steps(made_by)
    after = machine.predict(TRUTH[None], log.segments(1))[0]
    after = after + noise * NOISE * rng.standard_normal(after.shape)
    return Problem("servo", simulator, replace(log, next_observations=after))


def said(fit: Fit) -> list[str]:
    """What a fit says of the physics step."""
    return [warning for warning in fit.warnings if warning.startswith("physics steps of half")]


def test_what_shorter_steps_would_move() -> None:
    """Long steps move the damping by more than its error. That is said, with the size of the move,
    which is that of a fit with steps of half the length, within 10 %, and the fit is not trusted.
    """
    problem = servo()
    fit = DROPO().fit(problem, rng=0)
    (sentence,) = said(fit)
    assert "would move damping by " in sentence
    assert 'timestep="0.005"' in sentence
    assert "frame_skip: 4" in sentence
    assert fit.trusted is False
    assert abs(fit.mean[0] - TRUTH[0]) > 4 * fit.mean_se[0]
    moved = float(sentence.split("damping by ")[1].split()[0])
    finer = problem.simulator.with_finer_steps(2)
    again = DROPO().fit(replace(problem, simulator=finer), rng=0)
    assert again.mean[0] - fit.mean[0] == pytest.approx(moved, rel=0.1)


@pytest.mark.parametrize(
    ("step", "made_by", "noise"), [(0.0005, 8, 1.0), (0.01, 1, 1.0), (0.01, 1, 0.0)]
)
def test_where_nothing_is_said(step: float, made_by: int, noise: float) -> None:
    """Steps that are short, and data that the model's own steps made, with noise and without: the
    truth is found within 4 standard errors and rounding. Nothing else speaks against a fit of the
    latter.
    """
    fit = DROPO().fit(servo(step, made_by, noise), rng=0)
    assert said(fit) == []
    assert fit.trusted or made_by > 1
    assert abs(fit.mean[0] - TRUTH[0]) < 4 * fit.mean_se[0] + 1e-6


def test_what_it_costs() -> None:
    """At most a twentieth of what the fit takes without it; nothing where the truth is known."""
    problem = servo()
    asked = DROPO().fit(problem, rng=0)
    known = DROPO().fit(replace(problem, truth={"damping": 5.0}), rng=0)
    assert said(known) == []
    assert known.simulator_steps < asked.simulator_steps <= 1.05 * known.simulator_steps
    np.testing.assert_array_equal(known.mean, asked.mean)


def test_executors_say_the_same() -> None:
    """A fit on an executor has the same sentence."""
    problem = servo()
    alone = DROPO().fit(problem, rng=0)
    with ThreadPoolExecutor(2) as executor:
        shared = DROPO().fit(problem.using(executor=executor), rng=0)
    assert said(alone) == said(shared) != []


def test_a_simulator_without_physics_steps() -> None:
    """None is finer, and nothing is said."""
    block = SlidingBlock()
    assert block.with_finer_steps(2) is None
    forces = np.random.default_rng(1).normal(0, 3, (10, 12, 1))
    data = simulate(block, np.broadcast_to([1.5, 0.8], (10, 2)), forces, np.zeros(2))
    fit = DROPO().fit(Problem("block", block, data), rng=0)
    assert said(fit) == []
