"""A servo that holds a load with a dry joint, whose first model has no friction."""

from dataclasses import replace

import mujoco
import numpy as np

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.far_off.model import FarOffModel
from dropo.diagnosis.regression.quick import sides
from dropo.mjmodel.dynamics.dry_friction import IMPEDANCE, SHORTEST, SOFTEST
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.4"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="10" kv="0.5"/></actuator>
</mujoco>
"""
FRICTION = 0.3  # [N m]
NOISE = 5e-4  # [rad]
HELD = 50  # control steps of 20 ms


def servo(friction=0.0, holding=False, finer=1, *, gain=0.0, load=0.0, spring=0.0, turning=False):
    """The arm, with dry friction that creeps, holds or turns over little velocity (by Runge and
    Kutta), another drive, an end mass, a spring.
    """
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep /= finer
    (joint,) = spec.joints
    joint.frictionloss = friction
    joint.stiffness[0] = spring
    (drive,) = spec.actuators
    drive.gainprm = (1 + gain) * np.asarray(drive.gainprm)
    drive.biasprm = (1 + gain) * np.asarray(drive.biasprm)
    if load:
        end = spec.body("arm").add_body(pos=[0.2, 0, 0])
        end.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=load)
    if holding:
        joint.solimp_friction[:2] = IMPEDANCE
        joint.solref_friction = (SHORTEST, 1.0)
    if turning:
        joint.solimp_friction[:2] = SOFTEST
        joint.solref_friction = (SHORTEST, 1.0)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    return MujocoSimulator(spec, [], frame_skip=5 * finer, threads=1)


def recorded(holding, rng, *, runs=4, count=600, finer=4, reach=0.6, **other):
    """Runs under commands that jump and are held for a second, measured with noise."""
    made = servo(FRICTION, holding, finer, **other)
    actions = np.repeat(rng.uniform(-reach, reach, (runs * count // HELD, 1)), HELD, axis=0)
    rest = np.zeros((len(actions), 2))
    ends = np.arange(len(actions)) % count == count - 1
    segments = Trajectories(rest, actions, rest, ends).segments(count, every_step=True)
    after = made.predict(np.zeros((1, 0)), segments)[0].reshape(runs, count, -1)
    exact = np.concatenate([np.zeros((runs, 1, 2)), after], axis=1)
    measured = exact + NOISE * np.array([1.0, 20.0]) * rng.normal(size=exact.shape)
    return Trajectories(
        measured[:, :-1].reshape(-1, 2), actions, measured[:, 1:].reshape(-1, 2), ends
    )


def without_friction(holding, seed, finer=4):
    """The first model, with friction among its numbers, beside the recorded motion."""
    data = recorded(holding, np.random.default_rng(seed), finer=finer)
    problem = Problem("servo", servo(), data)
    fitted, held_out = sides(problem, 0.25)
    (friction,) = instances_of(problem.simulator.effect_context, "joint_friction")
    divided = replace(problem, trajectories=fitted, held_out=held_out)
    none = np.zeros(0, dtype=np.int64)
    return FarOffModel(divided, np.zeros(0), none, ((friction, np.zeros(1)),))
