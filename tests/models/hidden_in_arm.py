"""Closed-loop data of the arm with two joints, with something hidden in it."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import find
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.simulated.recording import record
from dropo.problems.simulated.robots import simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator

SOME = (
    "joint_damping",
    "joint_friction",
    "joint_stiffness",
    "actuator_gain",
    "actuator_delay",
    "actuator_lag",
)
"""Effects among which a search is quick."""
UPPER = FieldParameter("upper_mass", 0.5, 2.0, "kg", field="body_mass", element="upper")


def instance(simulator, label):
    """The effect of that label."""
    kind = label.split(":")[0].split(".")[0]
    return next(
        one for one in find("effects", kind)(simulator.effect_context) if one.label == label
    )


def with_tendon(found):
    """The same problem on a model whose two hinges share a tendon, which does nothing as yet."""
    simulator = found.simulator
    spec = simulator.spec()
    belt = spec.add_tendon(name="belt")
    belt.wrap_joint("shoulder", 1.0)
    belt.wrap_joint("elbow", 0.5)
    parameters = [binding.parameter for binding in simulator.bindings]
    model = MujocoSimulator(spec, parameters, frame_skip=simulator.frame_skip, threads=1)
    return replace(found, simulator=model)


def problem(
    hidden,
    *,
    sigma=1e-3,
    seed=0,
    parameters=(),
    truth=None,
    name="torque-arm",
    episodes=None,
    steps=None,
):
    """Data of an arm with effects hidden, (label or instance, magnitudes) each, under true
    parameters, with noise on every sensor.
    """
    arm = simulated_robot(name, parameters)
    rng = np.random.default_rng(seed)
    there = [
        (
            instance(arm.simulator, one) if isinstance(one, str) else one,
            np.array(sizes, dtype=float),
        )
        for one, sizes in hidden
    ]
    values = np.asarray(arm.simulator.nominal if truth is None else truth, dtype=float)
    data = record(
        arm.simulator,
        there,
        values,
        arm.starts(rng, episodes or arm.episodes),
        arm.controller,
        steps or arm.steps,
        actions=arm.actions,
        noise=sigma,
        alive=arm.alive,
        rng=rng,
        memory=arm.memory,
    )
    return Problem(name, arm.simulator, data, start_noise=True)
