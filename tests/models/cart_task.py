"""A cart that is to come to the middle of its rail: learned in a second."""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.task import Task
from dropo.core.records.trajectories import Trajectories
from dropo.families.full_gaussian import FullGaussian
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="cart"><joint name="rail" type="slide" axis="1 0 0" damping="0.5"/>
    <geom name="box" size="0.1" mass="2"/></body>
</worldbody><actuator>
  <motor name="push" joint="rail" gear="4" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  </mujoco>"""
STEPS = 30


def near(before, actions, after):
    """The less distance, the better."""
    return -np.abs(after[:, 0])


def aside(rng, n):
    """At rest, to either side."""
    return np.column_stack([rng.uniform(-0.5, 0.5, n), np.zeros(n)])


def on_rail(states):
    return np.abs(states[:, 0]) < 2


def to_goal(before, actions, after, goals):
    return -np.abs(after[:, 0] - goals[:, 0])


TASK = Task(near, aside, steps=STEPS, alive=on_rail, bonus=1.0)


def cart(task=TASK, **options):
    """A problem with two parameters and hardly any data."""
    mass = FieldParameter("mass", 1, 4, "kg", field="body_mass", element="cart")
    damping = FieldParameter("damping", 0.1, 1.0, "N s/m", field="dof_damping", element="rail")
    simulator = MujocoSimulator(
        mujoco.MjSpec.from_string(XML), [mass, damping], frame_skip=4, threads=1, **options
    )
    data = Trajectories(
        np.zeros((2, 2)), np.zeros((2, 1)), np.zeros((2, 2)), np.array([False, True])
    )
    return Problem("cart", simulator, data, task=task, truth={"mass": 2.0, "damping": 0.5})


def fit_of(space, mean, sd, *, correlation=0.0, epsilon=0.0, signals=2, problem="cart"):
    """A fit as a method returns it: Gaussian, the first two parameters correlated."""
    family = FullGaussian(space)
    phi = family.phi(mean, sd)
    if len(space) > 1:
        phi[2 * len(space)] = correlation
    d = len(space)
    return Fit(
        method="test",
        problem=problem,
        space=space,
        family="full",
        phi=phi,
        mean=np.asarray(family.mean(phi)),
        scale=family.scale(phi),
        sd=family.sd(phi),
        mean_se=np.full(d, np.nan),
        scale_se=np.full(d, np.nan),
        correlation=family.correlation(phi),
        epsilon=np.full(signals, float(epsilon)),
        log_likelihood=0.0,
        mse=0.0,
        transitions=2,
        simulator_steps=0,
        failed_simulations=0,
        objective_evaluations=0,
        status=Status.DONE,
        message="For a test.",
    )
