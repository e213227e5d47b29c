"""The machines in which laws are hidden: their models, and recordings by finer simulations.

A recording comes from Runge-Kutta's integrator with physics steps several times finer than the
model's, so that the model is never the machine, even where nothing is hidden.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import command_limits
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.problems.simulated.robots import SimulatedRobot, masses, problem_of, simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator

FINER = 4
"""Physics steps of the hidden machine for one of the model."""
TROLLEY = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="trolley" pos="0 0 1">
      <joint name="rail" type="slide" axis="1 0 0" damping="1.5" frictionloss="0.3"/>
      <geom type="box" size="0.1 0.05 0.04" mass="3" contype="0" conaffinity="0"/>
      <body name="load">
        <joint name="hook" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="0.7" contype="0"
              conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="winch" joint="rail" gear="25" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
PENDULUM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0025"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="pivot" axis="0 1 0" damping="0.03" armature="0.003" frictionloss="0.02"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.35" mass="0.5" contype="0"
            conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="pivot" gear="2" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
GANTRY = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="bridge" pos="0 0 1">
      <joint name="along" type="slide" axis="1 0 0" damping="20" frictionloss="4"/>
      <geom type="box" size="0.05 0.4 0.05" mass="6" contype="0" conaffinity="0"/>
      <body name="carriage">
        <joint name="across" type="slide" axis="0 1 0" damping="10" frictionloss="2"/>
        <geom type="box" size="0.06 0.06 0.06" mass="2.5" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="along_servo" joint="along" kp="1500" kv="60" ctrllimited="true"
              ctrlrange="-0.6 0.6"/>
    <position name="across_servo" joint="across" kp="800" kv="30" ctrllimited="true"
              ctrlrange="-0.4 0.4"/>
  </actuator>
</mujoco>
"""
ARMS = ("torque-arm", "position-arm")


@dataclass(frozen=True, eq=False)
class LawMachine:
    """A machine that is recorded with something hidden, or nothing.

    Attributes
    ----------
    robot : SimulatedRobot
        Its model, with the controller that drives it.
    noise : (p,) array
        Standard deviation of the noise of each of its signals.
    positions : bool
        Whether positions alone are logged.
    """

    robot: SimulatedRobot
    noise: Array
    positions: bool = False

    def record(
        self, hidden: Sequence[tuple[EffectInstance, Array]], rng: np.random.Generator, part: float
    ) -> Trajectories:
        """Record the machine itself, by a finer simulation with another integrator.

        Parameters
        ----------
        hidden : sequence of (EffectInstance, array)
            What it has and the model lacks.
        rng : numpy.random.Generator
            Source of starts, commands and noise.
        part : float
            Of the noise: 1 for all of it.

        Returns
        -------
        Trajectories
            Of all signals.
        """
        made = self.robot.simulator.with_integrator("RK4").with_finer_steps(FINER)
        return replace(self.robot, simulator=made).record(hidden, noise=part * self.noise, rng=rng)

    def problem(self, name: str, data: Trajectories) -> Problem:
        """Put a recording together with the model that is to be diagnosed.

        Parameters
        ----------
        name : str
            The problem's name.
        data : Trajectories
            What `record` gave.

        Returns
        -------
        Problem
            Whose velocities are estimated where positions alone are logged.
        """
        simulator = self.robot.simulator
        if name == "torque-arm":
            return problem_of(name, self.robot, data, float(self.noise[0]))
        if not self.positions:
            return Problem(name, simulator, data, start_noise=True)
        logged = simulator.model.nq
        cut = replace(
            data,
            observations=data.observations[:, :logged],
            next_observations=data.next_observations[:, :logged],
        )
        return with_velocities(Problem(name, simulator.observing(["qpos"]), cut))


def law_machine(name: str) -> LawMachine:
    """Build a machine by its name.

    Parameters
    ----------
    name : str
        One of `MACHINES`.

    Returns
    -------
    LawMachine
        On one thread.

    Raises
    ------
    KeyError
        If there is no such machine.
    """
    if name in ARMS:
        declared = masses(name) if name == "torque-arm" else []
        robot = simulated_robot(name, declared, 1)
        positions = name == "position-arm"
        size = 1e-4 if positions else 1e-3
        return LawMachine(robot, np.full(2 * robot.simulator.model.nv, size), positions)
    xml, frame_skip, feedback, sizes, positions = _OWN[name]
    spec = mujoco.MjSpec.from_string(xml)
    simulator = MujocoSimulator(spec, [], frame_skip=frame_skip, threads=1)
    nv = simulator.model.nv
    low, high = command_limits(simulator.model)[:, 0]
    drives = len(sizes)

    def controller(rows: Array, random: Array) -> Array:
        """Random commands, held near the middle."""
        return np.clip(np.array(sizes) * random - feedback * rows[:, :drives], low, high)

    def starts(rng: np.random.Generator, n: int) -> Array:
        return np.asarray(rng.uniform(-0.1, 0.1, (n, 2 * nv)))

    robot = SimulatedRobot(
        simulator, starts, controller, _always, steps=150, episodes=10, memory=0.93
    )
    return LawMachine(robot, np.repeat([1e-4, 1e-3], nv), positions)


def _always(rows: Array) -> np.ndarray:
    """None of these machines falls."""
    return np.ones(len(rows), dtype=bool)


_OWN: dict[str, tuple[str, int, float, tuple[float, ...], bool]] = {
    "trolley": (TROLLEY, 5, 0.3, (0.6,), False),
    "pendulum": (PENDULUM, 4, 0.1, (0.6,), False),
    "gantry": (GANTRY, 5, 0.0, (0.25, 0.15), True),
}
"""Model, physics steps of a control step, feedback, sizes of commands, whether positions alone."""
MACHINES = (*ARMS, *_OWN)
