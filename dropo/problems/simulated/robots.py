"""Simulated robots: Gymnasium's walkers and two arms, and problems on their data.

Each robot comes with the controller that drives it and the states at which it starts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import body_masses
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.files.loading import gymnasium_spec
from dropo.mjmodel.joints import command_limits
from dropo.mjmodel.names import element_names
from dropo.problems.hopper.data import healthy, hopper_policy, start_states
from dropo.problems.hopper.problem import hopper_simulator
from dropo.problems.simulated.recording import Controller, record
from dropo.simulators.mujoco.simulator import MujocoSimulator

TORQUE_ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.1" armature="0.01"/>
      <geom name="upper_geom" type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" mass="1"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" damping="0.05" armature="0.005" range="-2 2"
               limited="true"/>
        <geom name="fore_geom" type="capsule" size="0.025" fromto="0 0 0 0 0 -0.3" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder_motor" joint="shoulder" gear="8" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="elbow_motor" joint="elbow" gear="4" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""

POSITION_ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005"/>
  <worldbody>
    <body name="turret" pos="0 0 0.5">
      <joint name="yaw" axis="0 0 1" damping="0.5" armature="0.05"/>
      <geom type="cylinder" size="0.06 0.05" mass="1.5"/>
      <body name="boom" pos="0 0 0.05">
        <joint name="lift" axis="0 1 0" damping="0.5" armature="0.05"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.35 0 0" mass="1"/>
        <body name="stick" pos="0.35 0 0">
          <joint name="bend" axis="0 1 0" damping="0.3" armature="0.03"/>
          <geom type="capsule" size="0.025" fromto="0 0 0 0.3 0 0.02" mass="0.6"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="yaw_servo" joint="yaw" kp="40" kv="2" ctrlrange="-1.5 1.5"
              ctrllimited="true"/>
    <position name="lift_servo" joint="lift" kp="60" kv="3" ctrlrange="-1.5 1.5"
              ctrllimited="true"/>
    <position name="bend_servo" joint="bend" kp="30" kv="1.5" ctrlrange="-1.5 1.5"
              ctrllimited="true"/>
  </actuator>
</mujoco>
"""

Alive = Callable[[Array], NDArray[np.bool_]]
"""Which of the robots with true signals (n, p) go on, (n,)."""


@dataclass(frozen=True, eq=False)
class SimulatedRobot:
    """A simulator with the controller that drives it and the states at which it starts.

    Attributes
    ----------
    simulator : MujocoSimulator
        The robot's simulator, of p signals.
    starts : callable
        `starts(rng, n)` draws n observations (n, p) to begin at.
    controller : callable
        Commands from measurements and random numbers.
    alive : callable
        Which robots with true signals (n, p) go on, (n,).
    steps : int
        Maximum number of control steps of an episode.
    episodes : int
        Number of episodes of a recording.
    memory : float
        Correlation of the controller's random numbers from one control step to the next.
    """

    simulator: MujocoSimulator
    starts: Callable[[np.random.Generator, int], Array]
    controller: Controller
    alive: Alive
    steps: int
    episodes: int
    memory: float = 0.0

    @property
    def actions(self) -> int:
        """The number of commands, q."""
        return len(self.simulator.controls)

    def record(
        self,
        effects: Sequence[tuple[EffectInstance, Array]] = (),
        *,
        noise: Array | float,
        rng: np.random.Generator,
        values: Array | None = None,
    ) -> Trajectories:
        """Record closed-loop data of the robot.

        Parameters
        ----------
        effects : sequence of (EffectInstance, array)
            Effects that act on the robot, each with its magnitudes.
        noise : float or (p,) array
            Standard deviation of the noise on every sensor, or on each, in its unit.
        rng : numpy.random.Generator
            Source of the starts, commands and noise.
        values : (d,) array or None
            Parameters; None for the nominal ones.

        Returns
        -------
        Trajectories
            One trajectory an episode, without those that end before their first step.

        Raises
        ------
        SimulationFailed
            If no trajectory lasts a control step.
        """
        return record(
            self.simulator,
            effects,
            np.asarray(self.simulator.nominal) if values is None else values,
            self.starts(rng, self.episodes),
            self.controller,
            self.steps,
            actions=self.actions,
            noise=noise,
            alive=self.alive,
            rng=rng,
            memory=self.memory,
        )


RobotBuilder = Callable[[Sequence[FieldParameter], int], SimulatedRobot]
"""Builds a robot: builder(parameters, threads)."""


@dataclass(frozen=True)
class Feedback:
    """Gains of a controller: -position * angle - velocity * speed + random * random number.

    Attributes
    ----------
    position, velocity : float
        Command per rad, and per rad/s.
    random : float
        Command per standard normal number.
    """

    position: float
    velocity: float
    random: float


def simulated_robot(
    name: str, parameters: Sequence[FieldParameter] = (), threads: int = 1
) -> SimulatedRobot:
    """Build a robot by its name.

    Parameters
    ----------
    name : str
        One of `ROBOTS`.
    parameters : sequence of FieldParameter
        Parameters to declare; the hopper always declares its four masses instead.
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    SimulatedRobot

    Raises
    ------
    KeyError
        If there is no such robot.
    """
    return ROBOTS[name](parameters, threads)


def _hopper(parameters: Sequence[FieldParameter], threads: int) -> SimulatedRobot:
    """The hopper of the thesis under its stored policy."""

    def starts(rng: np.random.Generator, n: int) -> Array:
        return start_states(rng, n)[:, 1:]

    def alive(rows: Array) -> NDArray[np.bool_]:
        return healthy(np.pad(rows, ((0, 0), (1, 0))))

    return SimulatedRobot(
        hopper_simulator(threads), starts, hopper_policy(), alive, steps=60, episodes=44
    )


def _walking(
    file: str,
    frame_skip: int,
    rest: Array,
    feedback: Feedback,
    alive: Alive,
    episodes: int,
) -> RobotBuilder:
    """A robot of Gymnasium's under feedback to its rest, with random commands added."""

    def build(parameters: Sequence[FieldParameter], threads: int) -> SimulatedRobot:
        spec = _without_total_mass(gymnasium_spec(file))
        simulator = MujocoSimulator(
            spec,
            parameters,
            observation=["qpos[1:]", "qvel"],
            frame_skip=frame_skip,
            threads=threads,
        )
        nv = simulator.model.nv
        nu = simulator.model.nu
        start = np.concatenate([rest, np.zeros(nv)])

        def controller(rows: Array, random: Array) -> Array:
            angles = rows[:, nv - 1 - nu : nv - 1]
            speeds = rows[:, -nu:]
            commands = (
                feedback.random * random - feedback.position * angles - feedback.velocity * speeds
            )
            return np.clip(commands, -1, 1)

        def starts(rng: np.random.Generator, n: int) -> Array:
            return start + rng.uniform(-0.02, 0.02, (n, 2 * nv - 1))

        return SimulatedRobot(
            simulator, starts, controller, alive, steps=60, episodes=episodes, memory=0.7
        )

    return build


def _without_total_mass(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The same robot without `settotalmass`, of which newer versions of MuJoCo warn."""
    total = spec.compiler.settotalmass
    spec.compiler.settotalmass = -1
    factor = total / float(body_masses(spec.compile()).sum()) if total > 0 else 1.0
    for geom in spec.geoms:
        geom.density = factor * geom.density
        geom.mass = factor * geom.mass
    return spec


def _arm(xml: str, feedback: Feedback) -> RobotBuilder:
    """An arm under feedback to its zero position, with random commands added."""

    def build(parameters: Sequence[FieldParameter], threads: int) -> SimulatedRobot:
        spec = mujoco.MjSpec.from_string(xml)
        simulator = MujocoSimulator(spec, parameters, frame_skip=4, threads=threads)
        nv = simulator.model.nv
        low, high = command_limits(simulator.model)[:, 0]

        def controller(rows: Array, random: Array) -> Array:
            angles = rows[:, :nv]
            speeds = rows[:, nv:]
            commands = (
                feedback.random * random - feedback.position * angles - feedback.velocity * speeds
            )
            return np.clip(commands, low, high)

        def starts(rng: np.random.Generator, n: int) -> Array:
            return rng.uniform(-0.3, 0.3, (n, 2 * nv))

        return SimulatedRobot(
            simulator, starts, controller, _always, steps=48, episodes=26, memory=0.8
        )

    return build


def _always(rows: Array) -> NDArray[np.bool_]:
    """An arm never falls."""
    return np.ones(len(rows), dtype=bool)


def _cheetah_alive(rows: Array) -> NDArray[np.bool_]:
    """The cheetah has not turned over."""
    return np.abs(rows[:, 1]) < 1.5


def _walker_alive(rows: Array) -> NDArray[np.bool_]:
    """The walker's torso is high and upright."""
    return (rows[:, 0] > 0.8) & (np.abs(rows[:, 1]) < 1)


ROBOTS: dict[str, RobotBuilder] = {
    "torque-arm": _arm(TORQUE_ARM, Feedback(0.1, 0.02, 0.6)),
    "position-arm": _arm(POSITION_ARM, Feedback(0.0, 0.0, 0.6)),
    "hopper": _hopper,
    "half-cheetah": _walking(
        "half_cheetah.xml",
        frame_skip=2,
        rest=np.zeros(8),
        feedback=Feedback(0.0, 0.0, 0.6),
        alive=_cheetah_alive,
        episodes=30,
    ),
    "walker2d": _walking(
        "walker2d_v5.xml",
        frame_skip=4,
        rest=np.array([1.25, *[0.0] * 7]),
        feedback=Feedback(0.3, 0.03, 0.4),
        alive=_walker_alive,
        episodes=44,
    ),
}
"""Name of a robot -> its builder."""


def masses(name: str) -> list[FieldParameter]:
    """The masses of all bodies of a robot as parameters.

    Parameters
    ----------
    name : str
        One of `ROBOTS`.

    Returns
    -------
    list of FieldParameter
        Each between half and twice its nominal value [kg].
    """
    model = simulated_robot(name).simulator.model
    parameters = []
    own = body_masses(model).tolist()
    for body, index in list(element_names(model, "body").items())[1:]:
        mass = own[index]
        parameters.append(
            FieldParameter(
                f"{body}_mass", 0.5 * mass, 2 * mass, "kg", field="body_mass", element=body
            )
        )
    return parameters


def problem_of(name: str, robot: SimulatedRobot, data: Trajectories, noise: float) -> Problem:
    """A problem on the data of a robot, whose declared parameters are to be found.

    Parameters
    ----------
    name : str
        Name of the problem.
    robot : SimulatedRobot
        The robot that recorded the data.
    data : Trajectories
        Its data.
    noise : float
        Standard deviation of the noise on every sensor, in its unit.

    Returns
    -------
    Problem
        With the nominal parameters as its truth.
    """
    nominal = np.asarray(robot.simulator.nominal).tolist()
    truth = dict(zip(robot.simulator.space.names, nominal, strict=True))
    return Problem(name, robot.simulator, data, epsilon=noise**2, start_noise=True, truth=truth)
