"""What the physics step does is said to be the step's, and no cause."""

import mujoco
import numpy as np
import pytest

from dropo import Diagnose, Problem
from dropo.core.contracts.effect import instances_of
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.findings.premises.numerics import _share_of_step, short_delay
from dropo.diagnosis.search.arithmetic import ArithmeticAlternatives
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body>
      <joint name="pivot" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
</mujoco>
"""
DAMPING = 0.03  # [N m s/rad]
NOISE = np.array([2e-4, 2e-3])  # [rad, rad/s]
RUNS, STEPS = 12, 60
EFFECTS = ("joint_damping", "joint_armature", "sensor_delay", "actuator_delay")


def pendulum(damping=0.0, finer=1, integrator="mjINT_EULER"):
    """A pendulum on a motor, its physics steps so many times shorter."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.integrator = getattr(mujoco.mjtIntegrator, integrator)
    spec.option.timestep /= finer
    spec.joints[0].damping[0] = damping
    return MujocoSimulator(spec, [], frame_skip=2 * finer, threads=1)


def recorded(finer, integrator, late=0.0):
    """A log of a pendulum that has damping, beside the model that has none.

    late: of its positions [s].
    """
    rng = np.random.default_rng(3)
    phase = rng.uniform(0, 2 * np.pi, (RUNS, 1))
    torque = 0.5 * np.sin(0.15 * np.arange(STEPS) + phase).reshape(-1, 1)
    rest = np.zeros((len(torque), 2))
    ends = np.arange(len(torque)) % STEPS == STEPS - 1
    segments = Trajectories(rest, torque, rest, ends).segments(STEPS, every_step=True)
    machine = pendulum(DAMPING, finer, integrator)
    delay, _ = instances_of(machine.effect_context, "sensor_delay")
    machine = machine.with_effects((), [(delay, np.array([late]))])
    after = machine.predict(np.zeros((1, 0)), segments)[0]
    exact = np.concatenate([np.zeros((RUNS, 1, 2)), after.reshape(RUNS, STEPS, 2)], axis=1)
    measured = exact + NOISE * rng.normal(size=exact.shape)
    before = measured[:, :-1].reshape(-1, 2)
    return Problem(
        "pendulum", pendulum(), Trajectories(before, torque, measured[:, 1:].reshape(-1, 2), ends)
    )


SEARCH = Diagnose(EFFECTS, windows=20, disturbances=False)
STEPS_SAID = "act like delays, inertia and damping"


@pytest.mark.parametrize(
    ("finer", "integrator"), [(4, "mjINT_RK4"), (10, "mjINT_EULER"), (1, "mjINT_EULER")]
)
def test_exact_steps_stand_beside_the_cause(finer, integrator):
    """A machine in other, shorter steps: its damping is named, alone, with its size, and the steps
    are said to be the model's, whether it is exact or another simulation, which steps as the model
    does. Control: in the model's own steps, nothing is said of them.
    """
    found = SEARCH.run(recorded(finer, integrator), rng=0)
    (cause,) = found.causes
    assert cause.effect == "joint_damping"
    estimate = cause.estimate["damping"]
    assert abs(estimate.value - DAMPING) < 4 * estimate.se
    assert found.verdict == "explained"
    assert any(STEPS_SAID in text for text in found.numerics) == (finer > 1)


def test_a_delay_below_a_step_is_no_cause_where_something_remains(monkeypatch):
    """Where exact steps are not tried, half a step of delay is accepted, refused in the end, and
    said, beside what half the steps would explain. So this is the control of the test above, too.
    """
    monkeypatch.setattr(ArithmeticAlternatives, "__call__", lambda *given: False)
    found = SEARCH.run(recorded(4, "mjINT_RK4"), rng=0)
    assert [cause.effect for cause in found.causes] == ["joint_damping"]
    estimate = found.causes[0].estimate["damping"]
    assert abs(estimate.value - DAMPING) > 4 * estimate.se
    assert found.verdict == "partly"
    better, refused = found.numerics
    assert "physics steps of half the length (5 ms)" in better
    assert refused.startswith("The sensor delay at qpos.pivot of 4.")
    assert "qpos.pivot" not in {leader.target for leader in found.leaders}


def test_a_delay_below_a_step_is_a_cause_where_all_is_explained():
    """In the model's own steps they are no rivals of positions that are 4 ms late."""
    found = SEARCH.run(recorded(1, "mjINT_EULER", late=0.004), rng=0)
    causes = {cause.effect: cause for cause in found.causes}
    assert set(causes) == {"joint_damping", "sensor_delay"}
    estimate = causes["sensor_delay"].estimate["delay"]
    assert abs(estimate.value - 0.004) < 4 * estimate.se
    assert not any(STEPS_SAID in text for text in found.numerics)


@pytest.mark.parametrize(("late", "told"), [(0.004, 0.004), (0.012, None)])
def test_short_delays_are_shorter_than_a_physics_step(late, told):
    """Of a step of 10 ms; other effects are none, whatever their size."""
    context = pendulum().effect_context
    (delay, _), (damping,) = (
        instances_of(context, name) for name in ("sensor_delay", "joint_damping")
    )
    assert short_delay(delay, np.array([late]), 0.01) == told
    assert short_delay(damping, np.array([late]), 0.01) is None


def test_where_the_model_that_came_diverges_steps_change_less_than_causes():
    """Without a warning; elsewhere the share is that of the rows that are known."""
    found = np.zeros((2, 6))
    came = np.full((2, 6), 4.0)
    finer = np.full((2, 6), 1.0)
    spread = np.array([1.0, 2.0])
    assert _share_of_step(finer, came, found, spread) == pytest.approx(0.25)
    came[0] = np.nan
    finer[0] = 9.0
    assert _share_of_step(finer, came, found, spread) == pytest.approx(0.25)
    came[1] = np.nan
    assert _share_of_step(finer, came, found, spread) == 0.0
