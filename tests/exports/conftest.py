"""An arm with a servo and a motor, fits of it that are known, and what is exported of them."""

import ast

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.registry import find
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.hidden_in_arm import instance
from tests.models.robots import ARM

MASS = FieldParameter("mass", 0.5, 3.0, "kg", field="body_mass", element="upper")
PARAMETERS = (
    MASS,
    FieldParameter("damping", 0.05, 1.0, field="dof_damping", element="shoulder"),
    FieldParameter("dry", 0.0, 0.5, field="dof_frictionloss", element="shoulder"),
    FieldParameter("armature", 0.2, 5.0, field="dof_armature", element="shoulder", relative=True),
    FieldParameter("kp", 3.0, 40.0, field="actuator_kp", element="servo"),
    FieldParameter("gravity", -15.0, -5.0, field="gravity", index=2),
)
MEANS = np.array([1.3, 0.4, 0.15, 1.2, 15.0, -9.7])
SCALES = np.array([0.1, 0.05, 0.02, 0.1, 1.0, 0.05])
ERRORS = np.array([0.05, 0.01, 0.01, 0.02, 0.5, 0.02])


def arm_problem(parameters=PARAMETERS, free=(), fixed=()):
    """The arm with a little data; effects by label, the fixed ones with their magnitudes."""
    spec = mujoco.MjSpec.from_string(ARM)
    simulator = MujocoSimulator(spec, parameters, frame_skip=4, threads=1)
    found = [(instance(simulator, label), np.array(sizes)) for label, sizes in fixed]
    effects = [instance(simulator, label) for label in free]
    simulator = simulator.with_effects(effects, found)
    rows = np.zeros((6, 4))
    data = Trajectories(rows, np.zeros((6, 2)), rows, np.arange(6) % 3 == 2)
    return Problem("arm", simulator, data)


def known_fit(
    problem, means=MEANS, scales=SCALES, errors=ERRORS, family="truncated_gaussian", phi=None
):
    """A fit with these numbers."""
    space = problem.space
    member = find("families", family)(space)
    phi = member.phi(means, scales) if phi is None else phi
    return Fit(
        method="dropo",
        problem=problem.name,
        space=space,
        family=family,
        phi=phi,
        mean=np.asarray(member.mean(phi)),
        scale=np.asarray(member.scale(phi)),
        sd=np.asarray(member.sd(phi)),
        mean_se=np.array(errors),
        scale_se=np.full(len(space), np.nan),
        correlation=np.asarray(member.correlation(phi)),
        epsilon=np.full(4, 1e-6),
        log_likelihood=0.0,
        mse=0.0,
        transitions=6,
        simulator_steps=0,
        failed_simulations=0,
        objective_evaluations=0,
        status=Status.DONE,
        message="",
    )


@pytest.fixture(scope="session")
def arm():
    """The arm and its fit."""
    problem = arm_problem()
    return problem, known_fit(problem)


def beyond(draws, mean, sd):
    """How many standard errors the draws' (n, d) means and standard deviations are off at most.

    The error of a standard deviation is that of the draws' own fourth moment.
    """
    n = len(draws)
    off = draws - draws.mean(axis=0)
    of_mean = np.abs(draws.mean(axis=0) - mean) / (sd / np.sqrt(n))
    of_variance = np.sqrt(((off**2 - (off**2).mean(axis=0)) ** 2).mean(axis=0) / n)
    of_sd = np.abs((off**2).mean(axis=0) - sd**2) / of_variance
    return float(np.max([of_mean, of_sd]))


def run_file(path):
    """What a Python file defines, run where this package cannot be imported by it."""
    text = path.read_text()
    imports = [one for one in ast.walk(ast.parse(text)) if isinstance(one, ast.ImportFrom)]
    assert all(not one.module.startswith("dropo") for one in imports)
    assert "import dropo" not in text
    scope = {"__name__": path.stem, "__file__": str(path)}
    exec(compile(text, str(path), "exec"), scope)
    return scope
