"""Small servo machines drawn at random, as somebody would bring them, with their logs.

One to three joints, hinges and slides, upright and level. The model has the kinematics, the masses
and the servos of the data sheet; rotors, viscous and dry friction are missing at every joint, and
in every other machine each servo's gain is another. Machines are simulated four times finer than
models and by another integrator; a few runs of 6 to 10 s, positions alone, by coarse encoders.
"""

import mujoco
import numpy as np
from numpy.random import Generator

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.studies.first_models.machines import (
    Design,
    MissingNumbers,
    Numbers,
    built,
    first_model,
    measured,
    problem_of,
)


def random_design(rng: Generator) -> Design:
    """Draw a chain of one to three joints on position servos.

    Parameters
    ----------
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    Design
        Slides, if there are any, before hinges.
    """
    count = int(rng.integers(1, 4))
    axes: list[str] = []
    along: list[str] = []
    gains: list[float] = []
    for i in range(count):
        # Slides carry hinges, not the other way around.
        slides = i < count - 1 and (not axes or axes[-1].startswith("slide"))
        kind = "slide" if slides and rng.random() < 0.3 else "hinge"
        axis, length = rng.permutation(list("xyz"))[:2].tolist()
        axes.append(f"{kind} {axis}")
        along.append(axis if kind == "slide" else length)
        weakest, strongest = (300, 1500) if kind == "slide" else (20, 60)
        gains.append(float(rng.uniform(weakest, strongest)) * 0.6**i)
    return Design(
        tuple(axes),
        tuple(rng.uniform(0.15, 0.35, count).tolist()),
        tuple((rng.uniform(0.3, 1.2, count) * 0.7 ** np.arange(count)).tolist()),
        tuple(gains),
        loaded=False,
        along=tuple(along),
        rate=float(rng.choice([0.0, 0.02, 0.05])),
    )


def random_stranger(design: Design, rng: Generator) -> MissingNumbers:
    """Draw what a machine has that its model lacks.

    Parameters
    ----------
    design : Design
        The machine.
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    MissingNumbers
        With rotors and friction; for one machine in two also with a wrong gain at each drive.
    """
    gains = np.array(design.gains)
    count = len(gains)
    differ = rng.random() < 0.5
    return MissingNumbers(
        armature=gains * rng.uniform(2e-4, 8e-4, count),
        damping=gains * rng.uniform(0.004, 0.015, count),
        friction=gains * rng.uniform(0.003, 0.008, count),
        payload=0.0,
        place=np.zeros(3),
        gain=rng.uniform(0.08, 0.15, count) * rng.choice([-1.0, 1.0], count) * differ,
        delay=0.0,
    )


def stranger(seed: int, *, missing: bool = True) -> tuple[Problem, Numbers]:
    """A machine's log with a model, and what the model lacks.

    Parameters
    ----------
    seed : int
        Decides everything.
    missing : bool
        Whether the model lacks anything; else it has all of the machine's numbers.

    Returns
    -------
    problem : Problem
    truth : dict
        Numbers by effect, place and quantity.
    """
    rng = np.random.default_rng([seed, 1])
    design = random_design(rng)
    machine = random_stranger(design, rng)
    control = float(rng.choice([0.01, 0.02]))
    spec = first_model(design)
    made = built(spec, machine)
    made.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = _log(made, design, control, rng)
    truth = machine.numbers()
    if not missing:
        step = spec.option.timestep
        spec = built(spec, machine)
        spec.option.timestep = step
        truth = {}
    return problem_of(f"stranger-{seed}", spec, data, control), truth


def _log(made: mujoco.MjSpec, design: Design, control: float, rng: Generator) -> Trajectories:
    """Three to six runs."""
    runs = int(rng.integers(3, 7))
    count = round(rng.uniform(6.0, 10.0) / control)
    hinges = np.array([axis.startswith("hinge") for axis in design.axes])
    reach = np.where(hinges, 0.6, 0.1)
    commands = np.stack([_commands(len(hinges), count, control, rng) for _ in range(runs)])
    tick = 2 * np.pi / 2 ** int(rng.integers(12, 15))
    return measured(made, commands * reach, 0.0, rng, control=control, noise=0.3 * tick, tick=tick)


def _commands(drives: int, count: int, control: float, rng: Generator) -> Array:
    """(count, drives) commands of about 1: sums of sines, steps that are rounded off, or ramps."""
    kind = rng.integers(3)
    time: Array = control * np.arange(count, dtype=float)
    found = np.zeros((count, drives))
    for i in range(drives):
        if kind == 0:
            found[:, i] = sum_of_sines(time, 3, (0.1, 1.5), (0.2, 0.6), rng)
        else:
            found[:, i] = between_levels(time, (0.7, 1.5), rng, held=kind == 1)
    return found - found[0]


def sum_of_sines(
    time: Array, count: int, hertz: tuple[float, float], sizes: tuple[float, float], rng: Generator
) -> Array:
    """Add sines of random frequency, phase and size.

    Parameters
    ----------
    time : (T,) array
        When it is wanted [s].
    count : int
        How many sines.
    hertz : tuple of float
        The lowest and the highest frequency [Hz].
    sizes : tuple of float
        The smallest and the largest amplitude.
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    (T,) array
    """
    found = np.zeros(len(time))
    for _ in range(count):
        phase = 2 * np.pi * rng.uniform(*hertz) * time + rng.uniform(0, 2 * np.pi)
        found += rng.uniform(*sizes) * np.sin(phase)
    return found


def between_levels(time: Array, every: tuple[float, float], rng: Generator, *, held: bool) -> Array:
    """Go from one random level between -1 and 1 to the next, in steps or in ramps.

    Parameters
    ----------
    time : (T,) array
        When it is wanted, from 0 on [s].
    every : tuple of float
        The shortest and the longest time between two levels [s].
    rng : numpy.random.Generator
        What random numbers come from.
    held : bool
        Whether each level is held until the next.

    Returns
    -------
    (T,) array
    """
    apart = rng.uniform(*every)
    knots = np.arange(0.0, time[-1] + 2 * apart, apart)
    levels = rng.uniform(-1.0, 1.0, len(knots))
    if held:
        return np.asarray(levels[np.searchsorted(knots, time, side="right") - 1])
    return np.asarray(np.interp(time, knots, levels))
