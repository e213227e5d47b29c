"""Laws of the hopper's masses found with a torso 1 kg too light, and policies trained under them:
the tasks of figure 6.3.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo import Diagnose
from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.interactive_estimator import distribution
from dropo.core.contracts.problem import Problem
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
from dropo.studies.tiboni_2021.hopper_sets import MEAN, Size
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


@dataclass(frozen=True)
class Training:
    """updates: of augmented random search; episodes: in which a policy is judged on the target;
    steps: of an episode.
    """

    updates: int = 100
    episodes: int = 100
    steps: int = 500


def estimator(method: str, droid: int) -> Estimator:
    """The method as in table 6.4; the tuned epsilon is one of those that it compares."""
    methods: dict[str, Estimator] = {
        PUBLISHED: DROPO(epsilon=EPSILONS[0]),
        TUNED: DROPO(epsilon="tune", sweep=tuple(sorted(EPSILONS))),
        "droid": DROID(budget=droid),
        "least squares": LeastSquares(weights="equal"),
    }
    return methods[method]


def found(item: Item) -> dict[str, Any]:
    """The `law` by its name: family and phi, mean and sd of the masses [kg], what a diagnosis
    added, and what all that cost.

    Of the data ("authors' data" or "6.1") the first `transitions` are fitted; droid: its
    evaluations; number: of the uniform bounds.
    """
    name = item["law"]
    if name == TRUTH:
        return {"law": name, **_laid_down(whole(), "point", MEAN)}
    asked = hopper_fits.item(item["data"], "clean", 0, Size(transitions=item["transitions"]))
    light = light_torso(asked)
    if name == EXTENDED:
        return {"law": name, **_extended(light)}
    if name in FITTED:
        return {"law": name, **_kept(estimator(name, item["droid"]).fit(light, rng=0))}
    if name == UNIFORM:
        low, high = random_bounds(light, item["number"] + 1, np.random.default_rng(BOUNDS_SEED))[-1]
        return {
            "law": name,
            "number": item["number"],
            **_laid_down(light, "uniform", (low + high) / 2, (high - low) / 2),
        }
    if name == AS_IT_IS:
        return {"law": name, **_laid_down(light, "point", MEAN[1:])}
    mean, scale = (np.array(values) for values in THESIS[name])
    return {"law": name, **_laid_down(light, "truncated_gaussian", mean, scale)}


def _laid_down(
    problem: Problem, family: str, mean: Array, scale: Array | None = None
) -> dict[str, Any]:
    """A law that is not fitted."""
    phi = mean if scale is None else find("families", family)(problem.space).phi(mean, scale)
    return _kept(distribution(problem, "given", family, phi))


def _kept(fit: Any, more: int = 0) -> dict[str, Any]:
    return {
        "family": fit.family,
        "phi": fit.phi.tolist(),
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "effects": [],
        "epsilon": float(np.max(fit.epsilon)),
        "steps": fit.simulator_steps + more,
    }


def _extended(light: Problem) -> dict[str, Any]:
    """What a diagnosis says of the data, and DROPO's fit of the model that it extends."""
    diagnosis = Diagnose().run(light)
    fit = DROPO(epsilon="learn").fit(diagnosis.problem, rng=0)
    simulator = diagnosis.problem.simulator
    assert isinstance(simulator, MujocoSimulator)
    effects = [
        [instance.effect, instance.label, sizes.tolist()] for instance, sizes in simulator.fixed
    ]
    kept = _kept(fit, diagnosis.simulator_steps)
    return {
        **kept,
        "effects": effects,
        "verdict": diagnosis.verdict,
        "causes": [cause.sentence for cause in diagnosis.causes],
    }


def whole() -> Problem:
    """The target: the hopper with its true masses, and with data only because a problem has some."""
    return hopper_problem("hopper", simulate(1, 1, rng=0)[0], 1e-8, threads=1)


def machine(effects: list[list[Any]]) -> Problem:
    """The model with the torso too light, and with the effects that a diagnosis added: [effect,
    label, sizes] of each.
    """
    light = light_torso(hopper_fits.item("6.1", "clean", 0, Size(transitions=2)))
    simulator = light.simulator
    assert isinstance(simulator, MujocoSimulator)
    instances = [
        {
            instance.label: instance
            for instance in find("effects", effect)(simulator.effect_context)
        }[label]
        for effect, label, _ in effects
    ]
    fixed = [
        (instance, np.array(sizes))
        for instance, (_, _, sizes) in zip(instances, effects, strict=True)
    ]
    return replace(light, simulator=simulator.with_effects((), fixed))


def trained(item: Item) -> dict[str, Any]:
    """A policy trained from the item's seed under its `law`, and its returns on the target; no
    noise on what policies see.

    Policies of the same seed share their search directions and, all of them, the target's starts.
    in_training: the best trial's mean return under the law itself; upright: the share of the
    target's episodes that do not end early.
    """
    from dropo import ARS, evaluate, train

    size = Training(**item["training"])
    target = whole()
    model = target if item["law"] == TRUTH else machine(item["effects"])
    drawn = distribution(model, item["law"], item["family"], np.array(item["phi"]))
    policy = train(
        model, drawn, ARS(updates=size.updates), noise=0.0, steps=size.steps, rng=item["seed"]
    )
    played = evaluate(policy, target, episodes=size.episodes, steps=size.steps, noise=0.0, rng=0)
    trials = np.array(policy.about["history"])[:, 2]
    return {
        "law": item["law"],
        "number": item["number"],
        "seed": item["seed"],
        "return": played.mean,
        "error": played.standard_error,
        "upright": float(np.mean(played.lengths == played.steps)),
        "in_training": float(trials.max()),
        "control_steps": policy.about["control_steps"],
        "broken": policy.about["failed_simulations"],
    }
