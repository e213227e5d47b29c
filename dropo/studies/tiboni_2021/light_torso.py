"""Distributions of the hopper's masses found with a torso 1 kg too light, and policies under them.

These are the tasks of figure 6.3.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo import Diagnose
from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.interactive_estimator import distribution
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.estimators.droid import DROID
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.uniform_randomization import random_bounds
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.problem import hopper_problem
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.tiboni_2021 import hopper_fits
from dropo.studies.tiboni_2021.hopper_sets import MEAN, HopperStudySize
from dropo.studies.tiboni_2021.table_6_4 import EPSILONS, THESIS, light_torso

TRUTH = "the truth"
EXTENDED = "diagnosed and extended"
AS_IT_IS = "other masses true"
UNIFORM = "uniform randomization"
PUBLISHED = "dropo, epsilon 1e-03"
TUNED = "dropo, tuned epsilon"
FITTED = (PUBLISHED, TUNED, "droid", "least squares")
LAWS = (TRUTH, EXTENDED, *FITTED, *THESIS, AS_IT_IS, UNIFORM)
BOUNDS_SEED = 63
Item = dict[str, Any]
"""What a task takes: the name of a distribution as `law`, and more."""


@dataclass(frozen=True)
class Training:
    """How a policy is trained and evaluated.

    Attributes
    ----------
    updates : int
        Updates of augmented random search.
    episodes : int
        Episodes on the target in which a policy is evaluated.
    steps : int
        Control steps of an episode.
    """

    updates: int = 100
    episodes: int = 100
    steps: int = 500


def estimator(method: str, droid: int) -> Estimator:
    """Build a method as in table 6.4; the tuned epsilon is one of those that it compares.

    Parameters
    ----------
    method : str
        One of `FITTED`.
    droid : int
        Evaluations of DROID.

    Returns
    -------
    Estimator

    Raises
    ------
    KeyError
        If the table has no such method.
    """
    methods: dict[str, Estimator] = {
        PUBLISHED: DROPO(epsilon=EPSILONS[0]),
        TUNED: DROPO(epsilon="tune", sweep=tuple(sorted(EPSILONS))),
        "droid": DROID(budget=droid),
        "least squares": LeastSquares(weights="equal"),
    }
    return methods[method]


def found(item: Item) -> dict[str, Any]:
    """Find a distribution by its name.

    Parameters
    ----------
    item : dict
        law: one of `LAWS`; data: "authors' data" or "6.1"; transitions: how many of them are
        fitted; droid: evaluations of DROID; number: which of the uniform bounds.

    Returns
    -------
    dict
        Family and phi, mean and standard deviation of the masses [kg], what a diagnosis added, and
        the cost.
    """
    name = item["law"]
    if name == TRUTH:
        return {"law": name, **_given(whole(), "point", MEAN)}
    size = HopperStudySize(transitions=item["transitions"])
    light = light_torso(hopper_fits.item(item["data"], "clean", 0, size))
    if name == EXTENDED:
        return {"law": name, **_extended(light)}
    if name in FITTED:
        return {"law": name, **_kept(estimator(name, item["droid"]).fit(light, rng=0))}
    if name == UNIFORM:
        low, high = random_bounds(light, item["number"] + 1, np.random.default_rng(BOUNDS_SEED))[-1]
        bounds = _given(light, "uniform", (low + high) / 2, (high - low) / 2)
        return {"law": name, "number": item["number"], **bounds}
    if name == AS_IT_IS:
        return {"law": name, **_given(light, "point", MEAN[1:])}
    mean, scale = THESIS[name]
    printed = _given(light, "truncated_gaussian", np.array(mean), np.array(scale))
    return {"law": name, **printed}


def _given(
    problem: Problem, family: str, mean: Array, scale: Array | None = None
) -> dict[str, Any]:
    """A distribution that is not fitted."""
    phi = mean if scale is None else find("families", family)(problem.space).phi(mean, scale)
    return _kept(distribution(problem, "given", family, phi))


def _kept(fit: Fit, other_steps: int = 0) -> dict[str, Any]:
    """What is kept of a fit; `other_steps` simulator steps were made before it."""
    return {
        "family": fit.family,
        "phi": fit.phi.tolist(),
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "effects": [],
        "epsilon": float(np.max(fit.epsilon)),
        "steps": fit.simulator_steps + other_steps,
    }


def _extended(light: Problem) -> dict[str, Any]:
    """DROPO's fit of the model that a diagnosis extends, and what the diagnosis says."""
    diagnosis = Diagnose().run(light)
    fit = DROPO(epsilon="learn").fit(diagnosis.problem, rng=0)
    simulator = diagnosis.problem.simulator
    assert isinstance(simulator, MujocoSimulator)
    effects = []
    for instance, magnitudes in simulator.fixed:
        effects.append([instance.effect, instance.label, magnitudes.tolist()])
    return {
        **_kept(fit, diagnosis.simulator_steps),
        "effects": effects,
        "verdict": diagnosis.verdict,
        "causes": [cause.sentence for cause in diagnosis.causes],
    }


def whole() -> Problem:
    """Make the target: the hopper with its true masses.

    Returns
    -------
    Problem
        Its data are a single transition.
    """
    data, _ = simulate(1, 1, rng=0)
    return hopper_problem("hopper", data, 1e-8, threads=1)


def extended_model(effects: list[list[Any]]) -> Problem:
    """The model with the torso too light, and with the effects that a diagnosis added.

    Parameters
    ----------
    effects : list of list
        Name, label and magnitudes of each effect.

    Returns
    -------
    Problem
        Of the other three masses; its data are two transitions.
    """
    light = light_torso(hopper_fits.item("6.1", "clean", 0, HopperStudySize(transitions=2)))
    simulator = light.simulator
    assert isinstance(simulator, MujocoSimulator)
    fixed = []
    for effect, label, magnitudes in effects:
        instances = instances_of(simulator.effect_context, effect)
        by_label = {instance.label: instance for instance in instances}
        fixed.append((by_label[label], np.array(magnitudes)))
    return replace(light, simulator=simulator.with_effects((), fixed))


def trained(item: Item) -> dict[str, Any]:
    """Train a policy under a distribution, and evaluate it on the target.

    Policies of the same seed share their search directions; all of them share the target's starts.
    What policies see has no noise.

    Parameters
    ----------
    item : dict
        law, number, seed: of the policy; family, phi, effects: of its distribution, as `found`
        gives them; training: as `Training`.

    Returns
    -------
    dict
        return, error: mean return on the target, and its standard error; upright: fraction of the
        target's episodes that do not end early; in_training: the best trial's mean return under
        the distribution itself; control_steps, broken: those of the training, and its failed
        simulations.
    """
    from dropo import ARS, evaluate, train

    size = Training(**item["training"])
    target = whole()
    model = target if item["law"] == TRUTH else extended_model(item["effects"])
    masses = distribution(model, item["law"], item["family"], np.array(item["phi"]))
    search = ARS(updates=size.updates)
    policy = train(model, masses, search, noise=0.0, steps=size.steps, rng=item["seed"])
    rollouts = evaluate(policy, target, episodes=size.episodes, steps=size.steps, noise=0.0, rng=0)
    trials = np.array(policy.about["history"])[:, 2]
    return {
        "law": item["law"],
        "number": item["number"],
        "seed": item["seed"],
        "return": rollouts.mean,
        "error": rollouts.standard_error,
        "upright": float(np.mean(rollouts.lengths == rollouts.steps)),
        "in_training": float(trials.max()),
        "control_steps": policy.about["control_steps"],
        "broken": policy.about["failed_simulations"],
    }
