"""Closed-loop data of a simulator with effects hidden in it: what a robot would record that is not
what its model says.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require
from dropo.problems.hopper.problem import hopper_problem
from dropo.problems.simulated.robots import MACHINES, machine, masses, problem_of
from dropo.simulators.mujoco.simulator import MujocoSimulator

NOISE = dict.fromkeys(MACHINES, 1e-3) | {"hopper-noisy": 10**-2.5}
"""Built-in problems whose data can be recorded anew with something hidden in them, and the sd of
every sensor, in its unit.
"""


def hide(problem: str, effects: Sequence[str], *, seed: int = 0, threads: int = 0) -> Problem:
    """A built-in problem on data from a machine that has what its model lacks: effects as
    "EFFECT:TARGET=VALUE".

    The target may be left out where the effect is global, and be followed by ".variant"; values are
    in the effect's own units, several with commas between them. seed: of the recording; threads: of
    the simulator, 0 for all cores.
    """
    require(
        not isinstance(effects, str), "effects", 'a list, ["EFFECT:TARGET=VALUE"]', effects, "hide"
    )
    noise = NOISE[known("problem to hide effects in", problem, NOISE)]
    name = problem.removesuffix("-noisy")
    robot = machine(name, masses(name), threads)
    data = robot.record(
        [_hidden(text, robot.simulator) for text in effects],
        noise=noise,
        rng=np.random.default_rng(seed),
    )
    found = (
        hopper_problem(problem, data, noise**2, threads)
        if name == "hopper"
        else problem_of(name, robot, data, noise)
    )
    return replace(found, start_noise=True)


def _hidden(text: str, simulator: MujocoSimulator) -> tuple[EffectInstance, Array]:
    """ "joint_damping:leg_joint=0.6" as an atom with its sizes."""
    name, _, values = text.partition("=")
    effect, _, place = name.partition(":")
    instances = {
        instance.label: instance
        for instance in instances_of(simulator.effect_context, effect.partition(".")[0], place)
    }
    instance = instances[known("effect", name, instances)]
    try:
        sizes = np.array([float(value) for value in values.split(",")])
    except ValueError:
        sizes = np.zeros(0)
    wanted = ", ".join(f"{q.name} [{q.unit}]" for q in instance.quantities)
    if len(sizes) != len(instance.quantities):
        raise BadArgument(
            f"--hide {text!r} must give a number for {wanted} behind '='. Got {values!r}."
        )
    if not all(q.low <= size < np.inf for q, size in zip(instance.quantities, sizes, strict=True)):
        least = ", ".join(f"{q.low:g}" for q in instance.quantities)
        raise BadArgument(
            f"--hide {text!r}: {wanted} must be finite and at least {least}. Got {values!r}."
        )
    return instance, sizes
