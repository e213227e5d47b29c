"""Problem files whose data hold positions alone."""

import numpy as np
import pytest

from dropo import load
from dropo.core.services.files.strict_yaml import format_yaml, read_yaml
from dropo.estimators.least_squares import LeastSquares
from tests.models.hidden_in_arm import UPPER
from tests.models.hidden_in_arm import problem as arm_problem

MODEL = """<mujoco><option timestep="0.005" integrator="RK4"/><worldbody><body name="arm">
<joint name="pivot" axis="0 1 0" damping="0.002"/>
<inertial pos="0 0 -0.2" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody></mujoco>"""
PROBLEM = {
    "model": "model.xml",
    "frame_skip": 4,
    "data": "data.npz",
    "lambda": 10,
    "observation": ["qpos"],
    "parameters": {"damping": {"field": "dof_damping", "name": "pivot", "low": 0.0, "high": 0.02}},
}


def free_swings(folder, noise, reset=None):
    """A problem file of an arm that swings freely, its positions alone logged with noise."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    rows = []
    ends = []
    for _ in range(6):
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.qvel[0] = rng.uniform(-1, 1), rng.uniform(-2, 2)
        for step in range(150):
            rows.append(data.qpos.copy())
            ends.append(step == 149)
            mujoco.mj_step(model, data, 4)
    measured = np.array(rows) + noise * rng.standard_normal((len(rows), 1))
    np.savez(
        folder / "data.npz",
        observations=measured,
        actions=np.zeros((len(rows), 0)),
        terminals=np.array(ends),
    )
    (folder / "model.xml").write_text(MODEL)
    (folder / "problem.yaml").write_text(format_yaml(PROBLEM | ({"reset": reset} if reset else {})))
    return folder / "problem.yaml"


def test_velocities_are_estimated_and_said_so(tmp_path):
    """They stand behind the positions, are told of in a warning, and carry their noise into the
    starts.
    """
    problem = load(free_swings(tmp_path, 1e-4))
    assert [signal.name for signal in problem.simulator.signals] == ["qpos.pivot", "qvel.pivot"]
    assert problem.start_noise
    assert "qvel.pivot: estimated" in problem.warnings[-1]
    one = problem.trajectories.select([0])
    slopes = np.gradient(one.observations[:, 0], problem.simulator.control_step)
    np.testing.assert_allclose(one.observations[3:-3, 1], slopes[3:-3], atol=0.08)


def test_a_fit_of_positions_alone_finds_the_damping(tmp_path):
    """0.002 N m s/rad within four standard errors; without velocities, arms that start at rest
    would be fitted to something else.
    """
    fit = LeastSquares().fit(load(free_swings(tmp_path, 1e-3)))
    assert abs(fit.mean[0] - 0.002) < 4 * fit.mean_se[0] < 0.002
    at_rest = LeastSquares().fit(load(free_swings(tmp_path, 1e-3, reset={"set": ["qpos"]})))
    assert abs(at_rest.mean[0] - 0.002) > 4 * fit.mean_se[0]


def test_observed_velocities_are_left_alone():
    """A problem that observes them stays the same object."""
    from dropo.problems.file.estimated_velocities import with_velocities

    whole = arm_problem([], parameters=[UPPER], episodes=4, steps=10)
    assert with_velocities(whole) is whole


@pytest.mark.parametrize("reset", ["start", {"set": ["qpos"]}])
def test_other_resets_take_velocities_from_the_simulation(tmp_path, reset):
    """Where segments go on from each other, or begin with a trajectory, nothing is estimated."""
    path = free_swings(tmp_path, 1e-4, reset)
    content = read_yaml(path, "a problem file")
    if reset == "start":
        del content["lambda"]
    path.write_text(format_yaml(content))
    assert len(load(path).simulator.signals) == 1
