"""Machines that touch something, with estimated velocities: fits end, and say what they are."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Status
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.dropo import DROPO
from dropo.estimators.random_effects import RandomEffects
from dropo.estimators.support.rough_starts import (
    SMOOTHED,
    SearchSettings,
    starts_are_rough,
)
from dropo.estimators.support.trust_region import TrustRegionSettings
from dropo.estimators.support.whole_runs import may_follow_runs
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.simulated.slide import slide
from dropo.simulators.mujoco.simulator import MujocoSimulator

SLED = """<mujoco><option timestep="0.002"/><worldbody>
  <geom name="floor" type="plane" size="9 9 1" friction="0.5" priority="1"/>
  <body name="sled" pos="0 0 0.1"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/>
    <geom type="sphere" size="0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="x"/><motor joint="z"/></actuator></mujoco>"""
TRUTH = np.array([0.35, 1.3])
ROWS, RUNS, SKIP = 200, 2, 5
NOISE = 5e-4


def sled(seed: int = 0) -> Problem:
    """Runs of a pushed sled that lifts off now and then; positions measured, velocities central
    differences.
    """
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(SLED)
    model.geom_friction[0, 0], model.body_mass[1] = TRUTH
    mujoco.mj_setConst(model, mujoco.MjData(model))
    rows, commands = [], []
    for _ in range(RUNS):
        data = mujoco.MjData(model)
        pushes = np.repeat(rng.normal(0, 8, (1 + ROWS // 10, 2)), 10, axis=0)[: ROWS + 2]
        positions = []
        for push in pushes:
            positions.append(data.qpos + NOISE * rng.standard_normal(2))
            data.ctrl[:] = push
            mujoco.mj_step(model, data, SKIP)
        measured = np.array(positions)
        speed = (measured[2:] - measured[:-2]) / (2 * SKIP * model.opt.timestep)
        rows.append(np.hstack([measured[1:-1], speed]))
        commands.append(pushes[1:-1])
    parameters = [
        FieldParameter("floor", 0.1, 1.5, "1", field="geom_friction", element="floor", index=0),
        FieldParameter("mass", 0.5, 3.0, "kg", field="body_mass", element="sled"),
    ]
    spec = mujoco.MjSpec.from_string(SLED)
    simulator = MujocoSimulator(spec, parameters, frame_skip=SKIP, threads=1)
    log = Trajectories(
        np.concatenate([run[:-1] for run in rows]),
        np.concatenate([run[:-1] for run in commands]),
        np.concatenate([run[1:] for run in rows]),
        np.tile(np.arange(ROWS - 1) == ROWS - 2, RUNS),
    )
    error = NOISE / (np.sqrt(2) * SKIP * model.opt.timestep)
    estimated = {"qvel.x": error, "qvel.z": error}
    return Problem("sled", simulator, log, horizon=20, start_noise=True, estimated=estimated)


def test_which_starts_are_rough() -> None:
    """Those of a machine in contact with estimated velocities, and no other."""
    problem = sled()
    assert starts_are_rough(problem)
    assert not starts_are_rough(replace(problem, estimated={}))
    high = problem.trajectories
    lifted = replace(high, observations=high.observations + np.array([0, 5, 0, 0]))
    assert not starts_are_rough(replace(problem, trajectories=lifted))


def test_whole_runs_that_are_asked_for_need_free_motion() -> None:
    """A contact at any row, not only where segments start, leaves segments; none lets runs be
    followed, in the windows that the problem names.
    """
    problem = replace(sled(), whole_runs=True)
    assert not may_follow_runs(problem)
    up = np.array([0, 5, 0, 0])
    data = problem.trajectories
    lifted = replace(
        data, observations=data.observations + up, next_observations=data.next_observations + up
    )
    assert may_follow_runs(replace(problem, trajectories=lifted))
    row = lifted.observations.copy()
    row[30, 1] = -0.001
    after = lifted.next_observations.copy()
    after[29] = row[30]
    once = replace(lifted, observations=row, next_observations=after)
    assert 30 % problem.horizon
    assert not may_follow_runs(replace(problem, trajectories=once))


def test_a_fit_through_contacts() -> None:
    """Friction and mass within 4.5 standard errors, which are below 5 % and nowhere near hiding
    the model as it came; errors of starts are not carried through contacts, and that is said.
    """
    problem = sled()
    fit = DROPO().fit(problem, rng=0)
    assert SMOOTHED in fit.message
    assert (fit.mean_se < 0.05 * TRUTH).all()
    assert (np.abs(fit.mean - TRUTH) < 4.5 * fit.mean_se).all(), (fit.mean, fit.mean_se)
    assert (np.abs(np.array([0.5, 1.0]) - TRUTH) > 4.5 * fit.mean_se).all()
    assert fit.simulator_steps < 2_000_000


def test_asked_for_they_are_carried() -> None:
    """Who asks for noise on starts gets it."""
    noise = DROPO(start_noise=True)._make_noise(sled(), 1e-6, "each")
    assert noise.start
    assert not DROPO()._make_noise(sled(), 1e-6, "each").start


@pytest.mark.parametrize("method", [DROPO, RandomEffects])
def test_how_it_searches_is_a_setting(method):
    """With one outer iteration at most a fit runs out of them; control: by default it converges."""
    short = SearchSettings(regions=TrustRegionSettings(max_iterations=1))
    assert method(search=short).fit(slide(), rng=0).status is Status.OUT_OF_BUDGET
    assert method().fit(slide(), rng=0).status is Status.CONVERGED
