"""Built-in problems with effects hidden in their data, which the model does not have."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require
from dropo.effects.law import law_of_text
from dropo.problems.hopper.problem import hopper_problem
from dropo.problems.simulated.robots import ROBOTS, masses, problem_of, simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator

NOISE = dict.fromkeys(ROBOTS, 1e-3) | {"hopper-noisy": 10**-2.5}
"""Built-in problems in whose data effects can be hidden -> standard deviation of every sensor's
noise, in its unit.
"""


def hide(problem: str, effects: Sequence[str], *, seed: int = 0, threads: int = 0) -> Problem:
    """A built-in problem on data of a robot with effects that its model does not have.

    Parameters
    ----------
    problem : str
        Name of a built-in problem on simulated data.
    effects : sequence of str
        Effects as "EFFECT:TARGET=VALUE". The target is left out if the effect is global, and may be
        followed by ".variant". Values are in the effect's own units, several with commas between
        them.
    seed : int
        Seed of the recording.
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        Whose simulator is the model without the effects.

    Raises
    ------
    UnknownName
        If there is no such problem or effect; the message gives the nearest name.
    BadArgument
        If `effects` is a string, or a value is missing, not a number, or below its lower bound.
    SimulationFailed
        If no trajectory of the recording lasts a control step.
    """
    require(
        not isinstance(effects, str), "effects", 'a list, ["EFFECT:TARGET=VALUE"]', effects, "hide"
    )
    noise = NOISE[known("problem to hide effects in", problem, NOISE)]
    name = problem.removesuffix("-noisy")
    robot = simulated_robot(name, masses(name), threads)
    hidden = [_hidden(text, robot.simulator) for text in effects]
    data = robot.record(hidden, noise=noise, rng=np.random.default_rng(seed))
    if name == "hopper":
        made = hopper_problem(problem, data, noise**2, threads)
    else:
        made = problem_of(name, robot, data, noise)
    return replace(made, start_noise=True)


def _hidden(text: str, simulator: MujocoSimulator) -> tuple[EffectInstance, Array]:
    """A text such as "joint_damping:leg_joint=0.6" as an effect with its magnitudes."""
    name, _, values = text.partition("=")
    effect, _, place = name.partition(":")
    if effect == "law":
        instance = law_of_text(simulator.effect_context, place)
    else:
        instances = {
            one.label: one
            for one in instances_of(simulator.effect_context, effect.partition(".")[0], place)
        }
        instance = instances[known("effect", name, instances)]
    quantities = instance.quantities
    wanted = ", ".join(f"{quantity.name} [{quantity.unit}]" for quantity in quantities)
    try:
        magnitudes = np.array([float(value) for value in values.split(",")])
    except ValueError:
        magnitudes = np.zeros(0)
    if len(magnitudes) != len(quantities):
        raise BadArgument(
            f"--hide {text!r} must give a number for {wanted} behind '='. Got {values!r}."
        )
    lowest = np.array([quantity.low for quantity in quantities])
    if not np.all((lowest <= magnitudes) & (magnitudes < np.inf)):
        bounds = ", ".join(f"{low:g}" for low in lowest)
        raise BadArgument(
            f"--hide {text!r}: {wanted} must be finite and at least {bounds}. Got {values!r}."
        )
    return instance, magnitudes
