"""An arm of one joint and a mass on a spring, their logs, and the best that a fit could do."""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.signal import lfilter

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array, known
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.options import physics_step
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.simulators.mujoco.closed_loop import closed_loop
from dropo.simulators.mujoco.simulator import MujocoSimulator

ARM = """<mujoco><option timestep="0.002"/><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
SPRING = """<mujoco><option timestep="0.002"/><worldbody><body name="ball" pos="0 0 0.1">
  <inertial pos="0 0 0" mass="1" diaginertia="0.001 0.001 0.001"/>
  <joint name="slide" type="slide" axis="1 0 0" stiffness="100" damping="5"/></body></worldbody>
  <actuator><motor name="push" joint="slide"/></actuator></mujoco>"""
RHO = 0.9  # correlation of neighbouring errors, of the noise with a memory
DEGREES = 3.0  # degrees of freedom of the noise with long tails
BITS = 12  # of the encoder that gives positions alone
NOISES = ("positions, white", "positions, 12 bit", "all noisy", "AR(1) 0.9", "Student t 3")
"""Positions alone with white noise or rounded by an encoder; positions and velocities with noise
that is white, of first order, or has long tails.
"""


@dataclass(frozen=True)
class LoggedMachine:
    """A model, what is fitted, and how it is logged.

    Attributes
    ----------
    xml : str
        The MJCF text.
    parameters : tuple of FieldParameter
    truth : tuple of float
        Their true values.
    sd : (float, float)
        Standard deviations of the errors of position and velocity.
    runs, rows : int
        Runs of so many control steps each.
    frame_skip : int
        Physics steps in a control step.
    """

    xml: str
    parameters: tuple[FieldParameter, ...]
    truth: tuple[float, ...]
    sd: tuple[float, float]
    runs: int
    rows: int
    frame_skip: int

    def simulator(self, observation: tuple[str, ...] = ("qpos", "qvel")) -> MujocoSimulator:
        """Make the machine's simulator, on one thread.

        Parameters
        ----------
        observation : tuple of str
            Fields of the state that are observed.

        Returns
        -------
        MujocoSimulator
            With the machine's parameters.
        """
        spec = mujoco.MjSpec.from_string(self.xml)
        return MujocoSimulator(
            spec, self.parameters, observation=observation, frame_skip=self.frame_skip, threads=1
        )


MACHINES = {
    "arm": LoggedMachine(
        ARM,
        (
            FieldParameter("damping", 0.02, 1.0, "N m s/rad", field="dof_damping", element="hinge"),
            FieldParameter("motor", 0.5, 1.5, field="actuator_gainprm", element="motor", index=0),
        ),
        (0.1, 1.0),
        (1e-3, 1e-2),
        runs=24,
        rows=60,
        frame_skip=5,
    ),
    "spring-mass": LoggedMachine(
        SPRING,
        (
            FieldParameter("mass", 0.3, 3.0, "kg", field="body_mass", element="ball"),
            FieldParameter("stiffness", 30.0, 300.0, "N/m", field="jnt_stiffness", element="slide"),
            FieldParameter("damping", 0.0, 20.0, "N s/m", field="dof_damping", element="slide"),
        ),
        (1.0, 100.0, 5.0),
        (2e-3, 2e-2),
        runs=1,
        rows=1500,
        frame_skip=1,
    ),
}


@dataclass(frozen=True, eq=False)
class SimulatedLog:
    """A simulated log.

    Attributes
    ----------
    problem : Problem
        As it would be read from files.
    truth : (d,) array
    optimum : (d,) array
        The least standard errors that any unbiased estimate can have (Cramer-Rao).
    """

    problem: Problem
    truth: Array
    optimum: Array


def simulate_log(name: str, noise: str, seed: int) -> SimulatedLog:
    """Simulate a log of a machine under random or swept forces.

    Parameters
    ----------
    name : {"arm", "spring-mass"}
    noise : str
        One of `NOISES`.
    seed : int

    Returns
    -------
    SimulatedLog

    Raises
    ------
    UnknownName
        If there is no such machine or noise.
    """
    machine = MACHINES[known("machine", name, MACHINES)]
    known("noise", noise, NOISES)
    rng = np.random.default_rng([seed, list(MACHINES).index(name), NOISES.index(noise)])
    states, actions = _motion(machine, name, rng)
    measured = states + _errors(machine, noise, states, rng)
    if noise == "positions, 12 bit":
        step = 2 * np.pi / 2**BITS
        measured = np.round(states / step) * step
    alone = noise.startswith("positions")
    columns = 1 if alone else 2
    clean = _trajectories(states, actions, 2)
    data = _trajectories(measured, actions, columns)
    simulator = machine.simulator(("qpos", "qvel")[:columns])
    problem = with_velocities(Problem(f"{name}, {noise}", simulator, data))
    return SimulatedLog(problem, np.array(machine.truth), _optimum(machine, noise, clean, columns))


def _motion(machine: LoggedMachine, name: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """True states (runs, rows + 1, 2) and actions (runs, rows, 1)."""
    model = mujoco.MjModel.from_xml_string(machine.xml)
    starts = np.zeros((machine.runs, 2))
    actions = np.empty((machine.runs, machine.rows, 1))
    for run in range(machine.runs):
        if name == "arm":
            starts[run, 0] = rng.uniform(-0.5, 0.5)
            held = rng.normal(0, 2, -(-machine.rows // 5))
            actions[run, :, 0] = np.repeat(held, 5)[: machine.rows]
        else:
            time = np.arange(machine.rows) * physics_step(model) * machine.frame_skip
            first, second = rng.uniform(0, 2 * np.pi, 2)
            slow = 5 * np.sin(2 * np.pi * 1.5 * time + first)
            actions[run, :, 0] = slow + 3 * np.sin(2 * np.pi * 3.7 * time + second)

    def commands(states: Array, ids: Ints, step: int) -> Array:
        return actions[ids, step]

    skip = machine.frame_skip
    runs = closed_loop(model, commands, starts, machine.rows, frame_skip=skip)
    return runs.states, actions


def _errors(machine: LoggedMachine, noise: str, states: Array, rng: np.random.Generator) -> Array:
    """Errors of all measurements, of variance sd^2."""
    errors = rng.standard_normal(states.shape)
    if noise == "Student t 3":
        errors = rng.standard_t(DEGREES, states.shape) / np.sqrt(DEGREES / (DEGREES - 2))
    if noise == "AR(1) 0.9":
        before = rng.standard_normal((len(states), 100, 2))
        whole = np.concatenate([before, errors], axis=1)
        errors = lfilter([np.sqrt(1 - RHO**2)], [1, -RHO], whole, axis=1)[:, 100:]
    return np.asarray(errors * machine.sd)


def _trajectories(states: Array, actions: Array, columns: int) -> Trajectories:
    """The first columns of states as rows that follow each other."""
    runs, rows = actions.shape[:2]
    return Trajectories(
        states[:, :-1, :columns].reshape(-1, columns),
        actions.reshape(runs * rows, 1),
        states[:, 1:, :columns].reshape(-1, columns),
        np.tile(np.arange(rows) == rows - 1, runs),
    )


def _optimum(machine: LoggedMachine, noise: str, clean: Trajectories, columns: int) -> Array:
    """(d,) Cramer-Rao bound from true states, with the noise law known and every start unknown."""
    simulator = machine.simulator()
    segments = clean.segments(reset="start")
    truth = np.array(machine.truth)
    by_value = simulator.linearize(truth, segments)[1][:, :columns]
    by_start = simulator.linearize_starts(truth, segments)[1][:, :columns]
    sd = np.array(machine.sd[:columns])
    factor = 1.0
    if noise == "positions, 12 bit":
        sd = np.array([2 * np.pi / 2**BITS / np.sqrt(12)])
    if noise == "Student t 3":  # information (nu + 1) / (nu + 3) of a scale of sd sqrt((nu - 2)/nu)
        factor = (DEGREES + 1) / (DEGREES + 3) * DEGREES / (DEGREES - 2)

    information = np.zeros((len(truth), len(truth)))
    for start, stop in clean.spans:
        first = np.concatenate([np.eye(2)[:columns], np.zeros((columns, len(truth)))], axis=1)
        later = np.concatenate([by_start[start:stop], by_value[start:stop]], axis=2)
        whole = np.concatenate([first[None], later]) / sd[:, None]
        if noise == "AR(1) 0.9":
            news = (whole[1:] - RHO * whole[:-1]) / np.sqrt(1 - RHO**2)
            whole = np.concatenate([whole[:1], news])
        gram = factor * np.einsum("tpa,tpb->ab", whole, whole)
        both = gram[2:, :2] @ np.linalg.solve(gram[:2, :2], gram[:2, 2:])
        information += gram[2:, 2:] - both
    return np.sqrt(np.diagonal(np.linalg.inv(information)))
