"""Simulated machines: Gymnasium's walkers and two arms, each with what drives it and where it
starts, and problems on their data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.data import healthy, hopper_policy, start_states
from dropo.problems.hopper.problem import hopper_simulator
from dropo.problems.simulated.recording import Controller, record
from dropo.simulators.mujoco.simulator import MujocoSimulator

TORQUE_ARM = """<mujoco><compiler angle="radian"/><option timestep="0.005" gravity="0 0 -9.81"/><worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.1" armature="0.01"/>
    <geom name="upper_geom" type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" mass="1"/>
    <body name="fore" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" damping="0.05" armature="0.005" range="-2 2" limited="true"/>
      <geom name="fore_geom" type="capsule" size="0.025" fromto="0 0 0 0 0 -0.3" mass="0.6"/></body></body>
</worldbody><actuator><motor name="shoulder_motor" joint="shoulder" gear="8" ctrllimited="true" ctrlrange="-1 1"/>
  <motor name="elbow_motor" joint="elbow" gear="4" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""

POSITION_ARM = """<mujoco><compiler angle="radian"/><option timestep="0.005"/><worldbody>
  <body name="turret" pos="0 0 0.5"><joint name="yaw" axis="0 0 1" damping="0.5" armature="0.05"/>
    <geom type="cylinder" size="0.06 0.05" mass="1.5"/>
    <body name="boom" pos="0 0 0.05"><joint name="lift" axis="0 1 0" damping="0.5" armature="0.05"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.35 0 0" mass="1"/>
      <body name="stick" pos="0.35 0 0"><joint name="bend" axis="0 1 0" damping="0.3" armature="0.03"/>
        <geom type="capsule" size="0.025" fromto="0 0 0 0.3 0 0.02" mass="0.6"/></body></body></body>
</worldbody><actuator><position name="yaw_servo" joint="yaw" kp="40" kv="2" ctrlrange="-1.5 1.5" ctrllimited="true"/>
  <position name="lift_servo" joint="lift" kp="60" kv="3" ctrlrange="-1.5 1.5" ctrllimited="true"/>
  <position name="bend_servo" joint="bend" kp="30" kv="1.5" ctrlrange="-1.5 1.5" ctrllimited="true"/></actuator></mujoco>"""


@dataclass(frozen=True, eq=False)
class Machine:
    """starts(rng, n): observations (n, p) to begin at; alive: (n, p) -> (n,); memory: of the
    controller's random numbers.
    """

    simulator: MujocoSimulator
    starts: Callable[[np.random.Generator, int], Array]
    controller: Controller
    alive: Callable[[Array], NDArray[np.bool_]]
    steps: int
    episodes: int
    memory: float = 0.0

    @property
    def actions(self) -> int:
        """q, the numbers of a command."""
        return len(self.simulator.controls)

    def record(
        self,
        effects: Sequence[tuple[EffectInstance, Array]] = (),
        *,
        noise: float,
        rng: np.random.Generator,
        values: Array | None = None,
    ) -> Trajectories:
        """Closed-loop data of the machine with effects of those sizes, under parameters (d,), the
        nominal ones by default.
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


def machine(name: str, parameters: Sequence[FieldParameter] = (), threads: int = 1) -> Machine:
    """One of MACHINES, with those parameters declared (the hopper: its four masses, always)."""
    return MACHINES[name](parameters, threads)


def _hopper(parameters: Sequence[FieldParameter], threads: int) -> Machine:
    upright = lambda rows: healthy(np.pad(rows, ((0, 0), (1, 0))))
    return Machine(
        hopper_simulator(threads),
        lambda rng, n: start_states(rng, n)[:, 1:],
        hopper_policy(),
        upright,
        60,
        44,
    )


def _walking(
    file: str,
    frame_skip: int,
    rest: Array,
    gains: tuple[float, float, float],
    alive: Callable[[Array], NDArray[np.bool_]],
    steps: int,
    episodes: int,
) -> Callable[[Sequence[FieldParameter], int], Machine]:
    """A machine of Gymnasium's: feedback to rest, and random commands beside it."""

    def build(parameters: Sequence[FieldParameter], threads: int) -> Machine:
        with as_file(files("gymnasium") / "envs" / "mujoco" / "assets" / file) as path:
            spec = _without_total(mujoco.MjSpec.from_file(str(path)))
        simulator = MujocoSimulator(
            spec,
            parameters,
            observation=["qpos[1:]", "qvel"],
            frame_skip=frame_skip,
            threads=threads,
        )
        nv = simulator.model.nv
        nu = simulator.model.nu

        def controller(rows: Array, push: Array) -> Array:
            bent = rows[:, nv - 1 - nu : nv - 1]
            speed = rows[:, -nu:]
            return np.clip(gains[2] * push - gains[0] * bent - gains[1] * speed, -1, 1)

        def starts(rng: np.random.Generator, n: int) -> Array:
            return np.concatenate([rest, np.zeros(nv)]) + rng.uniform(-0.02, 0.02, (n, 2 * nv - 1))

        return Machine(simulator, starts, controller, alive, steps, episodes, 0.7)

    return build


def _without_total(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The same machine without a total mass to be scaled to, which newer versions of MuJoCo warn
    of.
    """
    total = spec.compiler.settotalmass
    spec.compiler.settotalmass = -1
    factor = total / float(spec.compile().body_mass.sum()) if total > 0 else 1.0
    for geom in spec.geoms:
        geom.density = factor * geom.density
        geom.mass = factor * geom.mass
    return spec


def _arm(
    xml: str, gains: tuple[float, float, float]
) -> Callable[[Sequence[FieldParameter], int], Machine]:
    def build(parameters: Sequence[FieldParameter], threads: int) -> Machine:
        simulator = MujocoSimulator(
            mujoco.MjSpec.from_string(xml), parameters, frame_skip=4, threads=threads
        )
        nv = simulator.model.nv

        def controller(rows: Array, push: Array) -> Array:
            return np.clip(
                gains[2] * push - gains[0] * rows[:, :nv] - gains[1] * rows[:, nv:],
                *simulator.model.actuator_ctrlrange[0],
            )

        def starts(rng: np.random.Generator, n: int) -> Array:
            return rng.uniform(-0.3, 0.3, (n, 2 * nv))

        return Machine(
            simulator, starts, controller, lambda rows: np.ones(len(rows), dtype=bool), 48, 26, 0.8
        )

    return build


MACHINES: dict[str, Callable[[Sequence[FieldParameter], int], Machine]] = {
    "torque-arm": _arm(TORQUE_ARM, (0.1, 0.02, 0.6)),
    "position-arm": _arm(POSITION_ARM, (0.0, 0.0, 0.6)),
    "hopper": _hopper,
    "half-cheetah": _walking(
        "half_cheetah.xml",
        2,
        np.zeros(8),
        (0.0, 0.0, 0.6),
        lambda rows: np.abs(rows[:, 1]) < 1.5,
        60,
        30,
    ),
    "walker2d": _walking(
        "walker2d_v5.xml",
        4,
        np.array([1.25, *[0.0] * 7]),
        (0.3, 0.03, 0.4),
        lambda rows: (rows[:, 0] > 0.8) & (np.abs(rows[:, 1]) < 1),
        60,
        44,
    ),
}
"""Names of machines -> machine(parameters, threads)."""


def masses(name: str) -> list[FieldParameter]:
    """The masses of all bodies, between half and twice their nominal values."""
    model = machine(name).simulator.model
    bodies = [(model.body(b).name, float(model.body_mass[b])) for b in range(1, model.nbody)]
    return [
        FieldParameter(f"{b}_mass", 0.5 * mass, 2 * mass, "kg", field="body_mass", element=b)
        for b, mass in bodies
    ]


def problem_of(name: str, robot: Machine, data: Trajectories, noise: float) -> Problem:
    """The masses to be found from data with so much noise (sd) on every sensor."""
    truth = dict(
        zip(robot.simulator.space.names, np.asarray(robot.simulator.nominal).tolist(), strict=True)
    )
    return Problem(name, robot.simulator, data, epsilon=noise**2, start_noise=True, truth=truth)
