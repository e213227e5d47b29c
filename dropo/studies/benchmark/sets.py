"""The data sets of the benchmark: one effect hidden in each, or none, by frozen seeds.

Data come from another integrator than the model that is handed out, with a step four times finer.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.validation import Array, known, require
from dropo.mjmodel.options import integrator
from dropo.problems.file.writer import write_problem
from dropo.problems.simulated.robots import SimulatedRobot, simulated_robot
from dropo.studies.engine.work import Work
from dropo.studies.hidden_effects.study import (
    Hidden,
    HiddenEffectSettings,
    draw,
    equivalent,
    every_magnitude_counts,
    gain_of,
    nats_between,
)

VERSION = "2026-11"
"""The benchmark's version: another seed, kind or rule is another version."""
SEED = 20_261_123
"""Drawn for this benchmark; no rule, threshold or default of dropo was chosen on its data."""
MACHINES = ("torque-arm", "position-arm", "hopper", "half-cheetah", "walker2d")
COUNT = 40
"""Data sets of each machine."""
KINDS = (
    "actuator_bias",
    "actuator_coupling",
    "actuator_deadband",
    "actuator_delay",
    "actuator_gain",
    "actuator_lag",
    "actuator_saturation",
    "actuator_torque_speed",
    "air_drag",
    "body_com",
    "body_inertia",
    "body_mass",
    "contact_friction",
    "contact_stiffness",
    "external_force",
    "gear_lash",
    "gravity_tilt",
    "joint_armature",
    "joint_cogging",
    "joint_damping",
    "joint_friction",
    "joint_limit",
    "joint_load_friction",
    "joint_stiffness",
    "joint_stribeck",
    "payload",
    "sensor_bias",
    "sensor_delay",
    "sensor_gain",
    "sensor_polling",
    "wind",
)
"""What may be hidden, whatever else the library of effects has."""
PROTOCOL = "protocol.json"
TRUTH = "truth.json"
SUMS = "checksums.json"


@dataclass(frozen=True)
class BenchmarkSettings:
    """How data sets are drawn.

    Attributes
    ----------
    nothing_every : int
        In every so many-th set, from the first on, nothing is hidden.
    sizes : (float, float)
        Bounds of an effect's first magnitude, in its largest probes: from hardly to be seen to
        plain.
    noise : (float, float)
        Bounds of the sensors' standard deviation, log-uniform.
    finer : int
        Physics steps of the recording in one of the model.
    minimum_rows : int
        Transitions that a recording must have: a machine that falls at once shows nothing.
    minimum_nats : float
        What an effect must at least be worth, to be one at all: friction of a geom that touches
        nothing is none.
    attempts : int
        Draws of an effect at most.
    """

    nothing_every: int = 5
    sizes: tuple[float, float] = (0.01, 2.0)
    noise: tuple[float, float] = (1e-4, 10**-2.5)
    finer: int = 4
    minimum_rows: int = 400
    minimum_nats: float = 1.0
    attempts: int = 100


SETTINGS = BenchmarkSettings()


@dataclass(frozen=True, eq=False)
class BenchmarkSet:
    """A data set with its truth.

    Attributes
    ----------
    name : str
        Such as "torque-arm-003".
    problem : Problem
        What is handed out: the model with its own integrator and step, and the data.
    truth : dict
        What is hidden, as JSON holds it.
    """

    name: str
    problem: Problem
    truth: dict[str, Any]


def set_names(machines: Sequence[str], count: int) -> list[tuple[str, int]]:
    """List the machine and number of every data set.

    Parameters
    ----------
    machines : sequence of str
        Some of `MACHINES`.
    count : int
        Sets of each.

    Returns
    -------
    list of (str, int)

    Raises
    ------
    UnknownName
        If there is no such machine; with the nearest name.
    BadArgument
        If there are more sets asked for than the benchmark has.
    """
    for machine in machines:
        known("machine", machine, MACHINES)
    require(1 <= count <= COUNT, "sets", f"from 1 to {COUNT}", count, "benchmark")
    return [(machine, number) for machine in machines for number in range(count)]


def make_set(machine: str, number: int, settings: BenchmarkSettings = SETTINGS) -> BenchmarkSet:
    """Make a data set of the benchmark; the same on every call.

    Parameters
    ----------
    machine : str
        One of `MACHINES`.
    number : int
        From 0 to `COUNT` - 1.
    settings : BenchmarkSettings

    Returns
    -------
    BenchmarkSet
    """
    rng = np.random.default_rng([SEED, number, MACHINES.index(machine)])
    given = simulated_robot(machine)
    model = given.simulator.without_parameters()
    truly = replace(given, simulator=finer(model, settings.finer))
    values = np.asarray(truly.simulator.nominal)
    sigma = float(np.exp(rng.uniform(*np.log(settings.noise))))
    nothing = number % settings.nothing_every == 0
    for _ in range(settings.attempts):
        effects: Hidden = []
        if not nothing:
            one = draw(truly, str(rng.choice(KINDS)), rng, settings.sizes)
            if one is None:
                continue
            effects = [one]
        data = truly.record(effects, noise=sigma, rng=rng.spawn(1)[0], values=values)
        if len(data) < settings.minimum_rows:
            continue
        nats = gain_of(truly, effects[0], effects, values, data, sigma) if effects else 0.0
        if nothing:
            break
        if nats >= settings.minimum_nats and _is_whole(truly, effects, values, data, sigma, nats):
            break
    name = f"{machine}-{number:03d}"
    of_steps = nats_between(truly.simulator, model, values, data, sigma)
    truth = {
        "machine": machine,
        "noise": sigma,
        "nats": nats,
        "integrator_nats": of_steps,
        **_hidden(effects),
    }
    return BenchmarkSet(name, Problem(machine, model, data, start_noise=True), truth)


def finer(simulator: Any, times: int) -> Any:
    """Make a simulator with another integrator and shorter steps.

    Parameters
    ----------
    simulator : MujocoSimulator
    times : int
        Steps in the place of one.

    Returns
    -------
    MujocoSimulator
        With Runge-Kutta's, or where the model has that, with MuJoCo's "implicitfast".
    """
    has_rk4 = integrator(simulator.model) == "RK4"
    other = "implicitfast" if has_rk4 else "RK4"
    return simulator.with_integrator(other).with_finer_steps(times)


def _is_whole(
    robot: SimulatedRobot,
    effects: Hidden,
    values: Array,
    data: Trajectories,
    sigma: float,
    nats: float,
) -> bool:
    """Whether each magnitude gives a tenth of what all give; else it is another effect."""
    rule = HiddenEffectSettings(minimum_gain=nats)
    return every_magnitude_counts(robot, effects[0], effects, values, data, sigma, rule)


def _hidden(effects: Hidden) -> dict[str, Any]:
    """The entries of what is hidden."""
    if not effects:
        return {"effect": None, "target": None, "variant": "", "sizes": {}, "same": []}
    instance, magnitudes = effects[0]
    names = [quantity.name for quantity in instance.quantities]
    return {
        "effect": instance.effect,
        "target": instance.target,
        "variant": instance.variant,
        "sizes": dict(zip(names, magnitudes.tolist(), strict=True)),
        "same": sorted([list(pair) for pair in equivalent(instance)], key=str),
    }


# --- files


def write_sets(
    work: Work, folder: Path, machines: Sequence[str] = MACHINES, count: int = COUNT
) -> dict[str, Any]:
    """Write the data sets, how to answer, checksums of all, and the truth apart.

    Parameters
    ----------
    work : Work
        Runs the recordings.
    folder : Path
        Made where it is missing.
    machines : sequence of str
    count : int
        Sets of each machine.

    Returns
    -------
    dict
        The protocol, as its file holds it.
    """
    chosen = set_names(machines, count)
    items = [[str(folder), machine, number] for machine, number in chosen]
    truths = work.map(_written, items)
    protocol = protocol_of(machines, count)
    write_json(folder / PROTOCOL, protocol)
    files = [path for path in sorted(folder.rglob("*")) if _is_handed_out(path, folder)]
    sums = {path.relative_to(folder).as_posix(): _sum(path) for path in files}
    write_json(folder / SUMS, sums)
    sets = dict(zip(protocol["sets"], truths, strict=True))
    write_json(folder / TRUTH, {"version": VERSION, "checksums": _sum(folder / SUMS), "sets": sets})
    return protocol


def protocol_of(machines: Sequence[str], count: int) -> dict[str, Any]:
    """Say which sets there are, and which answers there can be.

    Parameters
    ----------
    machines : sequence of str
    count : int

    Returns
    -------
    dict
        Version, machine of each set, and for each machine the targets of every effect; null stands
        for an effect of the whole machine.
    """
    targets = {machine: targets_of(simulated_robot(machine)) for machine in machines}
    sets = {f"{machine}-{number:03d}": machine for machine, number in set_names(machines, count)}
    return {"version": VERSION, "sets": sets, "targets": targets}


def targets_of(robot: SimulatedRobot) -> dict[str, list[str | None]]:
    """List where each effect can be on a robot.

    Parameters
    ----------
    robot : SimulatedRobot

    Returns
    -------
    dict
        Targets by effect, without effects that have no place.
    """
    context = robot.simulator.without_parameters().effect_context
    found: dict[str, list[str | None]] = {}
    for kind in KINDS:
        instances = instances_of(context, kind)
        places = list(dict.fromkeys(instance.target for instance in instances))
        if places:
            found[kind] = places
    return found


def _written(item: list[Any]) -> dict[str, Any]:
    """Write a set into its folder; the answer is its truth."""
    folder, machine, number = item
    made = make_set(machine, number)
    write_problem(made.problem, Path(folder) / "sets" / made.name)
    return made.truth


def _is_handed_out(path: Path, folder: Path) -> bool:
    """Whether a file is one of the data sets or the protocol."""
    return path.is_file() and (folder / "sets" in path.parents or path.name == PROTOCOL)


def _sum(path: Path) -> str:
    """The SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
