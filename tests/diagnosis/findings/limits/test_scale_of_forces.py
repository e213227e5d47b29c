"""Of a drive whose load weighs nothing only ratios are told, which is said, and in the errors."""

import mujoco
import numpy as np

from dropo import Diagnose
from dropo.core.contracts.estimator import silent
from dropo.core.contracts.problem import Problem
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.diagnosis.findings.causes import standard_errors
from dropo.diagnosis.findings.limits.scale_of_forces import in_words, untold_scales
from dropo.diagnosis.setup import DiagnosisTask, SearchedEffects
from dropo.diagnosis.solving import with_known_scales
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.servo_runs import goals_of, logged, simulated

XML = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="{axis}"/>
      <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.002 0.002 0.001"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="8"/></actuator>
</mujoco>
"""
LEVEL, UPRIGHT = "0 1 0", "0 0 1"
ARMATURE, DAMPING, FRICTION, GAIN = 0.02, 0.4, 0.1, -0.05
RUNS = 6
EFFECTS = ("joint_armature", "joint_damping", "joint_friction", "actuator_gain", "body_mass")


def searched(axis, theta):
    """A search that ended with some numbers, fitted, of a machine in steps of 0.2 ms."""
    spec = mujoco.MjSpec.from_string(XML.format(axis=axis))
    machine = spec.copy()
    machine.option.timestep = 0.0002
    (joint,) = machine.joints
    joint.armature, joint.damping[0], joint.frictionloss = ARMATURE, DAMPING, FRICTION
    (servo,) = machine.actuators
    servo.gainprm[0] *= 1 + GAIN
    servo.biasprm[1] *= 1 + GAIN
    rng = np.random.default_rng(2)
    goals = goals_of([0.4], RUNS, 400, rng)
    made = simulated(MujocoSimulator(machine, [], frame_skip=50, threads=1), goals, RUNS)
    made[..., 0] += 2e-4 * rng.normal(size=made.shape[:2])
    model = MujocoSimulator(spec, [], observation=["qpos"], frame_skip=5, threads=1)
    problem = with_velocities(Problem("servo", model, logged(made[..., :1], goals)))
    task = DiagnosisTask(problem, problem, rng, EvaluationLog())
    setup = Diagnose(EFFECTS, windows=24)._set_up(task, None, silent)
    first = setup.first()
    chosen = [one for one in setup.instances if one.effect in theta]
    numbers = first.theta.copy()
    for one in chosen:
        numbers[setup.library.indices_of[one.label]] = theta[one.effect]
    last = setup.selection.polish(setup.selection.try_set(first, numbers, (), chosen, scanned=()))
    return setup, SearchedEffects(first, last, {})


def sizes_of(setup, last):
    """Each number by its effect, and its error with that of a scale that is not told."""
    errors, _ = standard_errors(setup.library, last)
    for scale in untold_scales(setup.library, last):
        errors = np.hypot(errors, scale.changes)
    places = {one.effect: setup.library.indices_of[one.label][0] for one in last.accepted}
    of = last.free.tolist()
    return {name: (last.theta[i], errors[of.index(i)]) for name, i in places.items()}


def test_a_servo_without_weight_tells_ratios():
    """A servo that is far too weak, without a rotor, does what a good one with a rotor does: that
    is named in its place, every number off by what the gain may be.
    """
    setup, ended = searched(
        UPRIGHT, {"actuator_gain": -0.78, "joint_damping": 0.09, "joint_friction": 0.02}
    )
    (scale,) = untold_scales(setup.library, ended.last)
    assert (scale.gain, scale.other.effect) == ("actuator_gain:servo", "joint_armature")
    further, better = with_known_scales(setup, ended)
    sizes = sizes_of(setup, better.last)
    assert set(sizes) == {"joint_armature", "joint_damping", "joint_friction"}
    scales = untold_scales(setup.library, better.last)
    (said,) = in_words(setup.library, better.last, scales)
    assert "only together: actuator_gain:servo 0 (0.2), " in said
    truth = {"joint_armature": ARMATURE, "joint_damping": DAMPING, "joint_friction": FRICTION}
    for effect, (value, error) in sizes.items():
        assert 0.1 * value < error < 0.4 * value
        assert abs(value - truth[effect]) < 2 * error
    ratio = sizes["joint_damping"][0] / sizes["joint_friction"][0]
    assert abs(ratio / (DAMPING / FRICTION) - 1) < 0.05
    assert with_known_scales(further, better) is None


def test_a_weight_tells_the_gain():
    """The control: with gravity nothing is told only together; where the mass is free, it is."""
    numbers = {"joint_armature": 0.02, "joint_damping": 0.4, "joint_friction": 0.1}
    setup, ended = searched(LEVEL, {**numbers, "actuator_gain": GAIN})
    assert untold_scales(setup.library, ended.last) == ()
    gain, error = sizes_of(setup, ended.last)["actuator_gain"]
    assert abs(gain - GAIN) < 4 * error
    setup, ended = searched(LEVEL, {**numbers, "body_mass": 0.03})
    (scale,) = untold_scales(setup.library, ended.last)
    assert scale.other.effect == "actuator_gain"
    _, better = with_known_scales(setup, ended)
    assert "body_mass" not in {one.effect for one in better.last.accepted}
