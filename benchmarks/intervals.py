"""What the errors that a fit prints are worth, beyond the study of coverage in papers/intervals.

`python benchmarks/intervals.py clean` fits 20 hopper data sets without noise and prints errors and
RMS z of each mean. `late` fits dampings and rotor inertias of a simulated SO-101 arm whose commands
are 12 ms late and whose elbow rubs, and prints what the fit says of its model. `starts` fits the
hopper's masses from 20 random starts in boxes ten times wider, and counts where they end.
"""

import sys
from dataclasses import replace

import mujoco
import numpy as np

from dropo import DROPO, Fit, Problem
from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, TRUTH, hopper_spec
from dropo.problems.hopper.problem import hopper_problem
from dropo.problems.measured.recordings import find_runs
from dropo.problems.simulated.recording import record
from dropo.simulators.mujoco.simulator import MujocoSimulator

SETS = 20
FIRST = 7100  # the first seed of the data sets
DELAY = 0.012  # [s]
FRICTION = 0.2  # [N m]
NOISE = np.repeat([5e-4, 5e-3], 6)  # [rad], [rad/s]
LARGEST = {"dof_damping": (2.0, "N m s/rad"), "dof_armature": (0.1, "kg m^2")}


def clean(count: int = SETS, first: int = FIRST) -> None:
    """One line a data set, then RMS z of each mean, and of all."""
    scores = []
    for seed in range(first, first + count):
        data, _ = simulate(500, 2, rng=np.random.default_rng(seed))
        fit = DROPO().fit(hopper_problem("hopper", data, 1e-8, 1), rng=seed)
        error = fit.mean - _truth(fit)
        scores.append(error / fit.mean_se)
        shown = ", ".join(f"{e:+.1e} (z {z:+.1f})" for e, z in zip(error, scores[-1], strict=True))
        print(f"{seed}: {shown}; {fit.simulator_steps:,} steps", flush=True)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    largest = np.abs(scores).max(axis=0)
    for name, z, most in zip(TRUTH, rms, largest, strict=True):
        print(f"{name}: RMS z {z:.2f}, at most {most:.1f}, over {count} data sets")
    print(f"all means: RMS z {np.sqrt(np.mean(np.square(scores))):.2f}")


def late(seed: int = FIRST) -> None:
    """The fits without and with what is hidden: trusted or not, and what they say."""
    arm = _arm()
    hidden = [
        (_instance(arm, "actuator_delay"), np.array([DELAY])),
        (_instance(arm, "joint_friction:elbow_flex"), np.array([FRICTION])),
    ]
    centre = arm.model.actuator_ctrlrange.mean(axis=1)
    half = 0.4 * np.ptp(arm.model.actuator_ctrlrange, axis=1) / 2

    def controller(_: Array, random: Array) -> Array:
        return centre + half * np.tanh(random)

    rng = np.random.default_rng(seed)
    starts = np.zeros((12, 12))
    starts[:, :6] = centre
    nominal = np.asarray(arm.nominal)
    for label, effects in (("nothing hidden", []), ("late, and rubbing at the elbow", hidden)):
        data = record(
            arm,
            effects,
            nominal,
            starts,
            controller,
            100,
            actions=6,
            noise=NOISE,
            alive=lambda states: np.ones(len(states), dtype=bool),
            rng=rng.spawn(1)[0],
            memory=0.95,
        )
        fit = DROPO().fit(Problem("arm", arm, data, horizon=5, start_noise=True), rng=seed)
        worst = np.nanmax(np.abs((fit.mean - nominal) / fit.mean_se))
        print(f"{label}: trusted {fit.trusted}, the farthest of 12 means {worst:.1f} errors off")
        for text in fit.warnings:
            print(f"  warning: {text}")


def starts(count: int = SETS) -> None:
    """Where fits from random starts end, in boxes from a twentieth to twenty times the truth."""
    data, _ = simulate(500, 2, rng=np.random.default_rng(FIRST), noise_variance=1e-5)
    wide = [
        FieldParameter(
            f"{body}_mass",
            TRUTH[f"{body}_mass"] / 20,
            20 * TRUTH[f"{body}_mass"],
            "kg",
            field="body_mass",
            element=body,
            derived=False,
        )
        for body in BODIES
    ]
    simulator = MujocoSimulator(
        hopper_spec(), wide, observation=["qpos[1:]", "qvel"], frame_skip=FRAME_SKIP, threads=1
    )
    problem = replace(hopper_problem("hopper", data, 1e-5, 1), simulator=simulator)
    fits = []
    for seed in range(FIRST, FIRST + count):
        fits.append(DROPO(start="random").fit(problem, rng=seed))
        error = np.abs(fits[-1].mean / _truth(fits[-1]) - 1).max()
        print(f"{seed}: {fits[-1].log_likelihood:.3f}, means within {error:.1e}", flush=True)
    best = max(fit.log_likelihood for fit in fits)
    there = [fit.log_likelihood > best - 1 for fit in fits]
    said = [bool(fit.warnings) for fit in fits]
    silent = sum(not a and not b for a, b in zip(there, said, strict=True))
    print(f"in the best optimum {sum(there)} of {count}, elsewhere without a word {silent}")


def _truth(fit: Fit) -> Array:
    """The true values of a fit's parameters."""
    return np.array([fit.truth[name] for name in fit.space.names])


def _arm() -> MujocoSimulator:
    """The SO-101's simulator: damping and rotor inertia of each of its six joints."""
    _, path = find_runs("so101", "model.xml", "the SO-101 arm")
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    joints = [model.joint(i).name for i in range(model.njnt)]
    parameters = [
        FieldParameter(
            f"{joint}_{field.removeprefix('dof_')}", 0.0, high, unit, field=field, element=joint
        )
        for field, (high, unit) in LARGEST.items()
        for joint in joints
    ]
    return MujocoSimulator(spec, parameters, observation=["qpos", "qvel"], frame_skip=10, threads=1)


def _instance(simulator: MujocoSimulator, label: str) -> EffectInstance:
    """The effect of that label."""
    found = instances_of(simulator.effect_context, label.partition(":")[0])
    return next(one for one in found if one.label == label)


if __name__ == "__main__":
    {"clean": clean, "late": late, "starts": starts}[sys.argv[1]](*map(int, sys.argv[2:]))
