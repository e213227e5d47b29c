"""A fit whose residuals have structure says which usual effect they look like."""

import mujoco
import numpy as np
import pytest

from dropo import Problem, hide, load
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.least_squares import LeastSquares
from dropo.evaluation.likely_cause import likely_cause
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.simulated.slide import slide
from dropo.simulators.mujoco.simulator import MujocoSimulator

HIDDEN = {
    "joint_friction:elbow=0.05": "joint friction at elbow, frictionloss about 0.0",
    "actuator_delay=0.012": "actuator delay of all commands, delay about 0.0",
    "joint_armature:shoulder=0.01": "joint armature at shoulder, armature about 0.0",
    "actuator_gain:elbow_motor=-0.1": "actuator gain at elbow_motor, gain about -0.",
}


def fitted(problem):
    """Least squares on windows of five steps."""
    return LeastSquares().fit(problem.using(horizon=5, transitions=400), rng=0)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_is_hidden_is_what_they_look_like(hidden):
    """With its place and the order of its size, in one sentence that says what to do next."""
    fit = fitted(hide("torque-arm", [hidden], seed=3, threads=1))
    (said,) = [text for text in fit.warnings if "residuals look like" in text]
    assert HIDDEN[hidden] in said
    assert said.endswith("run `dropo diagnose`")
    size = float(said.split(" about ")[1].split()[0].rstrip(","))
    assert size == pytest.approx(float(hidden.split("=")[1]), rel=0.5)


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ("actuator_delay=0.001", "actuator delay of all commands, delay about 0.00"),
        ("joint_friction:elbow=0.003", "joint friction at elbow, frictionloss about 0.00"),
    ],
)
def test_what_is_small_is_told_too(hidden, said):
    """A tenth of the above: the model is wrong, by the response to the effect itself."""
    fit = fitted(hide("torque-arm", [hidden], seed=3, threads=1))
    assert fit.trusted is False
    assert any(said in text for text in fit.warnings)


ONE_MOTOR = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="link"><joint name="hinge" axis="0 1 0" damping="0.3"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/></body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="0.8"/></actuator>
</mujoco>
"""


def one_motor(late):
    """Noisy runs of one hinge, whose command comes so many physics steps late, of ten."""
    model = mujoco.MjModel.from_xml_string(ONE_MOTOR)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    commands = np.repeat(rng.normal(0, 2, (80, 1)), 5, axis=0)
    before = commands[0]
    rows = []
    for command in commands:
        rows.append([*data.qpos, *data.qvel])
        data.ctrl[:] = before
        mujoco.mj_step(model, data, late)
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 10 - late)
        before = command
    noisy = np.array(rows) + 1e-4 * rng.standard_normal((len(rows), 2))
    ends = np.arange(len(rows) - 1) == len(rows) - 2
    trajectories = Trajectories(noisy[:-1], commands[:-1], noisy[1:], ends)
    damping = FieldParameter("damping", 0.1, 1.0, field="dof_damping", element="hinge")
    spec = mujoco.MjSpec.from_string(ONE_MOTOR)
    simulator = MujocoSimulator(spec, [damping], frame_skip=10, threads=1)
    return Problem("one-motor", simulator, trajectories)


def test_a_delay_of_the_only_command_is_told():
    """8 ms, of all commands or of the one that there is; a control without."""
    said = [text for text in LeastSquares().fit(one_motor(4), rng=0).warnings if "look" in text]
    (sentence,) = said
    assert "actuator delay" in sentence
    assert float(sentence.split("delay about ")[1].split()[0]) == pytest.approx(0.008, rel=0.2)
    fit = LeastSquares().fit(one_motor(0), rng=0)
    assert not any("look" in text for text in fit.warnings)


def test_a_right_model_looks_like_nothing():
    """Nothing is said where nothing speaks against the model."""
    fit = fitted(load("torque-arm", threads=1))
    assert fit.trusted
    assert not any("look like" in text for text in fit.warnings)


def test_a_free_body_has_no_such_effects():
    """Neither a joint that rubs nor a drive that is late."""
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body name='b'><freejoint/><geom size='.1' mass='1'/></body>"
        "</worldbody></mujoco>"
    )
    mass = FieldParameter("m", 0.5, 2.0, field="body_mass", element="b")
    simulator = MujocoSimulator(spec, [mass], threads=1)
    rest = np.zeros((20, 13))
    rest[:, 3] = 1.0
    data = Trajectories(rest, np.zeros((20, 0)), rest + 0.01, np.arange(20) == 19)
    problem = Problem("thrown", simulator, data)
    jacobian = np.ones((len(problem.segments), len(simulator.signals), 1))
    assert likely_cause(problem, np.array([1.0]), jacobian, np.ones(len(simulator.signals))) is None


def test_a_simulator_without_a_robot_has_no_effects():
    """The sliding block in closed form."""
    problem = slide()
    jacobian = np.ones((len(problem.segments), len(problem.simulator.signals), 2))
    assert likely_cause(problem, np.array([1.5, 0.8]), jacobian, np.ones(2)) is None
