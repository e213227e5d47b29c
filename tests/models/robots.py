"""Robots on which effects are tried, each with data in its own coordinates: three trajectories, cut
in their middle.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.mujoco.simulator import MujocoSimulator

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.004"/><worldbody>
  <body name="upper" pos="0 0 1">
    <joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02" frictionloss="0.1"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0.4 0 -0.1" mass="1.2"/>
    <body name="lower" pos="0.4 0 -0.1">
      <joint name="elbow" axis="0 1 0" range="-0.2 0.1" limited="true" stiffness="2"
      springref="0.1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.1 0.05 -0.3" mass="0.5"/></body></body>
</worldbody><actuator>
  <motor name="push" joint="shoulder" gear="20" ctrllimited="true" ctrlrange="-1 1"/>
  <position name="servo" joint="elbow" gear="1.5" kp="12" kv="0.4" ctrllimited="true"
    ctrlrange="-1 1"/></actuator></mujoco>"""

CUBE = """<mujoco><option timestep="0.004"/><worldbody>
  <geom name="floor" type="plane" size="2 2 1" friction="0.3"/>
  <body name="cube" pos="0 0 0.1"><freejoint/>
    <geom name="shell" type="box" size="0.1 0.1 0.1" mass="1" friction="0.6"/></body>
</worldbody></mujoco>"""

CART = """<mujoco><option timestep="0.005"/><worldbody>
  <body name="cart" pos="0 0 1"><joint name="rail" type="slide" axis="1 0 0"/>
    <geom type="box" size="0.1 0.05 0.05" mass="1"/>
    <body name="pole"><joint axis="0 1 0"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.05 0 0.6" mass="0.2"/></body></body>
</worldbody><actuator><motor joint="rail" gear="10"/></actuator></mujoco>"""

STRANGE = """<mujoco><option timestep="0.005" integrator="RK4" density="1.2" viscosity="2e-5"/>
  <worldbody>
  <geom name="post" type="box" size="0.1 0.1 0.1" pos="0 0 3" mass="5"/>
  <body name="ball" pos="0 0 1"><joint name="socket" type="ball" damping="0.05"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0.4 0 -0.1" mass="0.5"/>
    <body pos="0.4 0 -0.1"><joint axis="0 1 0"/><joint axis="1 0 0"/>
      <geom type="box" pos="0.1 0 0.02" size="0.1 0.02 0.03" mass="0.2"/>
      <site name="tip" pos="0.2 0 0"/></body></body>
  <body name="slider" pos="1 0 1"><joint name="track" type="slide" axis="0 0 1"/>
    <geom type="sphere" size="0.05" mass="0.3"/>
    <site name="eye"/></body>
</worldbody><tendon><fixed name="string"><joint joint="track" coef="2"/></fixed></tendon><actuator>
  <motor tendon="string"/><motor site="tip" gear="0 0 1 0 0 0"/>
    <motor joint="socket" gear="0.1 0 0"/>
  <general joint="track" dyntype="filter" dynprm="0.05" gainprm="3"/>
    <velocity name="speed" joint="track" kv="2"/></actuator>
<sensor><gyro name="gyro" site="tip"/><jointpos name="height" joint="track"/></sensor></mujoco>"""


@dataclass(frozen=True)
class Robot:
    """A simulator and segments that begin in the middle of trajectories."""

    simulator: MujocoSimulator
    data: Trajectories

    @property
    def segments(self):
        """Windows of three steps, the first behind two steps of its trajectory, every step
        compared.
        """
        return self.data.segments(horizon=3, every_step=True).take([1, 3, 5])


def simulator(xml, frame_skip=4, threads=1, parameters=(), observation=("qpos", "qvel")):
    """A simulator of an MJCF text."""
    spec = mujoco.MjSpec.from_string(xml)
    return MujocoSimulator(
        spec, parameters, observation=observation, frame_skip=frame_skip, threads=threads
    )


def trajectories(own, row, largest, length=6, count=3, seed=0):
    """Unrelated states (row(rng) gives one) under smooth commands up to the largest."""
    rng = np.random.default_rng(seed)
    n = length * count
    rows = np.array([row(rng) for _ in range(n)])
    steps = rng.normal(size=(n, own.model.nu))
    ends = np.arange(n) % length == length - 1
    return Trajectories(rows, largest * np.tanh(steps), np.roll(rows, -1, axis=0), ends)


def around(model, data, rng, spread, speed):
    """A state near the model's qpos0."""
    start = model.qpos0.copy()
    mujoco.mj_integratePos(model, start, spread * rng.normal(size=model.nv), 1.0)
    return np.concatenate([start, speed * rng.normal(size=model.nv), *data])


def mass(body, low, high):
    """The mass of a body as a declared parameter."""
    return FieldParameter(f"{body}_mass", low, high, "kg", field="body_mass", element=body)


def hopper(threads=1):
    """The hopper of the built-in problem, a little above the floor."""
    own = hopper_simulator(threads)

    def row(rng):
        return np.concatenate(
            [[rng.uniform(1.26, 1.34)], 0.03 * rng.normal(size=4), 0.5 * rng.normal(size=6)]
        )

    return Robot(own, trajectories(own, row, 1.2))


def plain(xml, threads, spread, speed, parameters=(), observation=("qpos", "qvel"), extra=0):
    """A robot near its qpos0."""
    own = simulator(xml, threads=threads, parameters=parameters, observation=observation)
    data = trajectories(
        own, lambda rng: around(own.model, [0.1 * rng.normal(size=extra)], rng, spread, speed), 1.2
    )
    return Robot(own, data)


ROBOTS = {
    "hopper": hopper,
    "arm": lambda threads=1: plain(ARM, threads, 0.15, 1.0, (mass("lower", 0.2, 1.0),)),
    "cube": lambda threads=1: plain(CUBE, threads, 0.01, 0.3),
    "cart": lambda threads=1: plain(CART, threads, 0.3, 1.0),
    "strange": lambda threads=1: plain(
        STRANGE, threads, 0.1, 0.5, (), ("qpos", "qvel", "act", "sensordata"), extra=5
    ),
}
