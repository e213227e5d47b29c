"""Fits of the thesis' hopper data by each method, and laws compared by one likelihood: the tasks of
the studies.
"""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array
from dropo.estimators.droid import DROID
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.random_effects import RandomEffects
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.problems.hopper.published import hopper_published, hopper_published_noisy, published
from dropo.studies.tiboni_2021.hopper_sets import MEAN, Size, data_set, every

AUTHORS = "authors' data"
"""In the place of a table's number: the transitions that the authors published."""

Item = dict[str, Any]


def item(table: str, kind: str, seed: int, size: Size, **more: Any) -> Item:
    """What a task below takes: which data, and more, such as the method."""
    return {"table": table, "kind": kind, "seed": seed, "size": asdict(size), **more}


def problem_of(item: Item) -> tuple[Problem, Array]:
    """The item's problem, on one thread, and the masses (B, 4) [kg] behind its data."""
    size = Size(**item["size"])
    if item["table"] != AUTHORS:
        return data_set(item["table"], item["kind"], item["seed"], size.transitions)
    made = {"clean": hopper_published, "noisy": hopper_published_noisy}[item["kind"]](threads=1)
    return made.using(
        transitions=10 * size.transitions
        if item.get("method") == "dropo, all data"
        else size.transitions
    ), MEAN[None]


def at_hand() -> bool:
    """Whether the authors' data are here, or can be fetched."""
    try:
        return all(len(published(which)) > 0 for which in ("clean", "noisy-1e-5"))
    except (BadFile, OSError):
        return False


def estimator(method: str, size: Size) -> Estimator:
    """The method of that name in the studies' tables, with its defaults."""
    draws, budget, _ = size.published
    as_published: dict[str, Any] = {
        "likelihood": "monte-carlo",
        "optimizer": "cma-es",
        "start": "middle",
        "draws": draws,
        "budget": budget,
    }
    methods: dict[str, tuple[Callable[..., Estimator], dict[str, Any]]] = {
        "dropo": (DROPO, {}),
        "dropo, all data": (DROPO, {}),
        "dropo, learned epsilon": (DROPO, {"epsilon": "learn"}),
        "dropo, random start": (DROPO, {"start": "random"}),
        "dropo, published": (DROPO, as_published),
        "random effects": (RandomEffects, {}),
        "droid": (DROID, {"budget": size.droid}),
        "least squares": (LeastSquares, {}),
    }
    made, settings = methods[method]
    return made(**settings)


def fitted(item: Item) -> dict[str, Any]:
    """The item's `method` on its data: what the fit found, its cost on one thread, and the mean and
    sd of the masses drawn.
    """
    (problem, drawn), size = problem_of(item), Size(**item["size"])
    if item["method"] == "dropo, published":
        problem = every(size.published[2], problem)
    fit = estimator(item["method"], size).fit(problem, rng=item.get("start", 0))
    return {
        **found(fit),
        "drawn_mean": drawn.mean(axis=0).tolist(),
        "drawn_sd": drawn.std(axis=0).tolist(),
    }


def found(fit: Fit) -> dict[str, Any]:
    """What the tables keep of a fit."""
    with np.errstate(invalid="ignore", divide="ignore"):
        sd_se = fit.scale_se * np.where(fit.scale > 0, fit.sd / fit.scale, np.nan)
    arrays = {
        "mean": fit.mean,
        "mean_se": fit.mean_se,
        "sd": fit.sd,
        "sd_se": sd_se,
        "scale": fit.scale,
        "epsilon": fit.epsilon,
    }
    return {
        **{name: array.tolist() for name, array in arrays.items()},
        "log_likelihood": fit.log_likelihood,
        "mse": fit.mse,
        "steps": fit.simulator_steps,
        "evaluations": fit.objective_evaluations,
        "seconds": fit.wall_time_s,
        "status": fit.status.value,
        "certified": list(fit.constant_parameters or ()),
    }


def compared(item: Item) -> dict[str, Any]:
    """Log-likelihoods [nats] of `laws` {name: [mean, sd]} on the item's data, by the emulator
    around the first of them.

    exact: of the emulator, without sampling; simulator, emulator: both at the same `draws` draws of
    the law.
    """
    problem, _ = problem_of(item)
    family = TruncatedGaussian(problem.space)
    rng = np.random.default_rng(0)
    members = {
        name: distribution(family, *map(np.array, values)) for name, values in item["laws"].items()
    }
    phis = list(members.values())
    centre = family.mean(phis[0])
    reach = [np.maximum(family.scale(phi), np.abs(family.mean(phi) - centre)) for phi in phis]
    width = np.clip(np.max(reach, axis=0), 5e-5 * (problem.space.high - problem.space.low), None)
    assert problem.epsilon is not None
    local = Emulated().linearize_at(
        problem.simulator, problem.segments, family, problem.epsilon, centre, width, rng
    )
    base = family.base(Size(**item["size"]).draws, rng)
    targets = problem.simulator.targets(problem.segments)
    gaussian = MonteCarlo(base.shape[1])
    out = {}
    for name, phi in members.items():
        values = family.draw(phi, base)
        both = {
            "simulator": problem.simulator.predict(values, problem.segments),
            "emulator": local.predict(values),
        }
        sampled = {
            way: float(gaussian.log_density(made, targets, problem.epsilon).sum())
            for way, made in both.items()
        }
        out[name] = {"exact": float(local(phi)), **sampled}
    return out


def distribution(family: TruncatedGaussian, mean: Array, sd: Array) -> Array:
    """phi of the truncated Gaussian of that mean and standard deviation; the least scale where it
    is below.
    """
    share = family.sd(family.phi(mean, family.unknowns.high[4:])) / family.unknowns.high[4:]
    return family.phi(mean, sd / share)


def judged(item: Item) -> dict[str, Any]:
    """The thesis' log-likelihood [nats] of `laws` {name: [mean, sd]} on the item's data: each from
    `draws` simulations.
    """
    problem, _ = problem_of(item)
    family = TruncatedGaussian(problem.space)
    assert problem.epsilon is not None
    gaussian = MonteCarlo(Size(**item["size"]).draws)
    objective = gaussian.bind(
        problem.simulator, problem.segments, family, problem.epsilon, np.random.default_rng(0)
    )
    return {
        name: objective(distribution(family, *map(np.array, values)))
        for name, values in item["laws"].items()
    }
