"""Fits of the thesis' hopper data by each method, and distributions compared by one likelihood.

These are the tasks of the studies.
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
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
from dropo.studies.engine.long_fits import long_fit
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_sets import MEAN, HopperStudySize, data_set, every

AUTHORS = "authors' data"
"""In the place of a table's number: the transitions that the authors published."""

AS_PUBLISHED = "dropo, as published"
"""The published method at the thesis' full size."""

Item = dict[str, Any]
"""What a task takes: table, kind, seed and size of the data, and more."""


def item(table: str, kind: str, seed: int, size: HopperStudySize, **more: Any) -> Item:
    """The item of a task.

    Parameters
    ----------
    table : str
        "6.1", "6.2", "6.3" or `AUTHORS`.
    kind : str
        "clean" or "noisy".
    seed : int
        Seed of the data.
    size : HopperStudySize
        How large the study is.
    **more
        What else the task takes, such as `method`.

    Returns
    -------
    dict
        Plain values, which name the task in the list of finished ones.
    """
    return {"table": table, "kind": kind, "seed": seed, "size": asdict(size), **more}


def variant_item(table: str, kind: str, seed: int, size: HopperStudySize, variant: Variant) -> Item:
    """Make the item of a task that fits by a variant of a method.

    Parameters
    ----------
    table : str
        "6.1", "6.2", "6.3" or `AUTHORS`.
    kind : str
        "clean" or "noisy".
    seed : int
        Seed of the data.
    size : HopperStudySize
        How large the study is.
    variant : Variant
        A method with parts exchanged.

    Returns
    -------
    dict
        As `item` gives it, with the variant and its label as the method.
    """
    return item(table, kind, seed, size, method=variant.label, variant=variant.to_json())


def problem_of(item: Item, threads: int = 1) -> tuple[Problem, Array]:
    """The data that an item names.

    Parameters
    ----------
    item : dict
        As `item` gives it.
    threads : int
        Of the simulator.

    Returns
    -------
    problem : Problem
        The problem.
    masses : (B, 4) array
        Masses [kg] behind its data.

    Raises
    ------
    BadFile
        If the authors' data are neither found nor fetched.
    """
    size = HopperStudySize(**item["size"])
    if item["table"] != AUTHORS:
        return data_set(
            item["table"], item["kind"], item["seed"], size.transitions, threads=threads
        )
    make = {"clean": hopper_published, "noisy": hopper_published_noisy}[item["kind"]]
    factor = 10 if item.get("method") == "dropo, all data" else 1
    return make(threads=threads).using(transitions=factor * size.transitions), MEAN[None]


def at_hand() -> bool:
    """Say whether the authors' data are found, or can be fetched.

    Returns
    -------
    bool
    """
    try:
        return all(len(published(which)) > 0 for which in ("clean", "noisy-1e-5"))
    except (BadFile, OSError):
        return False


def estimator(method: str, size: HopperStudySize) -> Estimator:
    """Build a method by its name in the studies' tables, with its defaults.

    Parameters
    ----------
    method : str
        Its name.
    size : HopperStudySize
        Settings of DROID and of the published method.

    Returns
    -------
    Estimator

    Raises
    ------
    KeyError
        If no method has that name.
    """
    draws, budget, _ = size.published
    full_draws, full_budget = size.full
    published: dict[str, Any] = {"likelihood": "monte-carlo", "start": "middle"}
    reduced = {"optimizer": "cma-es", "draws": draws, "budget": budget}
    full = {
        "optimizer": "cma-es-once",
        "draws": full_draws,
        "budget": full_budget,
        "redraw": True,
    }
    methods: dict[str, tuple[Callable[..., Estimator], dict[str, Any]]] = {
        "dropo": (DROPO, {}),
        "dropo, all data": (DROPO, {}),
        "dropo, learned epsilon": (DROPO, {"epsilon": "learn"}),
        "dropo, random start": (DROPO, {"start": "random"}),
        "dropo, published": (DROPO, published | reduced),
        AS_PUBLISHED: (DROPO, published | full),
        "random effects": (RandomEffects, {}),
        "droid": (DROID, {"budget": size.droid}),
        "least squares": (LeastSquares, {}),
    }
    made, settings = methods[method]
    return made(**settings)


def fitted(item: Item) -> dict[str, Any]:
    """Fit the item's data by its `method`.

    Parameters
    ----------
    item : dict
        As `item` gives it, with `method` and perhaps `start`, a seed of the fit, and `variant`, the
        method itself.

    Returns
    -------
    dict
        What the fit found, its cost on one thread, and mean and standard deviation of the masses
        drawn [kg].
    """
    problem, drawn = problem_of(item)
    size = HopperStudySize(**item["size"])
    if item["method"] == "dropo, published":
        problem = every(size.published[2], problem)
    if "variant" in item:
        made = Variant(**item["variant"]).estimator(problem)
    else:
        made = estimator(item["method"], size)
    fit = made.fit(problem, rng=item.get("start", 0))
    return {**found(fit), **_of_sample(drawn)}


def as_published(work: Work, item: Item) -> dict[str, Any]:
    """Fit the item's data at the thesis' full size; see `fitted`.

    It takes hours on all cores. What an interrupted run has evaluated is kept.

    Parameters
    ----------
    work : Work
        Keeps the evaluations.
    item : dict
        As `item` gives it.

    Returns
    -------
    dict
        As of `fitted`.
    """
    problem, drawn = problem_of(item, work.threads)
    made = estimator(AS_PUBLISHED, HopperStudySize(**item["size"]))
    fit = long_fit(work, json.dumps([AS_PUBLISHED, item]), made, problem)
    return {**found(fit), **_of_sample(drawn)}


def _of_sample(drawn: Array) -> dict[str, Any]:
    """Mean and standard deviation of the drawn masses (B, 4) [kg]."""
    return {"drawn_mean": drawn.mean(axis=0).tolist(), "drawn_sd": drawn.std(axis=0).tolist()}


def found(fit: Fit) -> dict[str, Any]:
    """Collect what the tables keep of a fit, as plain numbers.

    Parameters
    ----------
    fit : Fit
        The fit, of d parameters and p signals.

    Returns
    -------
    dict
        mean, mean_se, sd, sd_se and scale as lists of d numbers in the parameters' units, epsilon
        of p, log_likelihood [nats], mse, steps, evaluations, inner, seconds, status, and certified:
        the parameters that are constant.
    """
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
        "inner": fit.inner_evaluations,
        "seconds": fit.wall_time_s,
        "status": fit.status.value,
        "certified": list(fit.constant_parameters or ()),
    }


def compared(item: Item) -> dict[str, Any]:
    """Log-likelihoods of distributions, by the emulator around the first of them.

    Parameters
    ----------
    item : dict
        As `item` gives it, with `distributions` {name: [mean, sd]} [kg].

    Returns
    -------
    dict
        By name, in nats: exact: of the emulator, without sampling; simulator, emulator: of both at
        the same draws of the distribution.
    """
    problem, _ = problem_of(item)
    family = TruncatedGaussian(problem.space)
    rng = np.random.default_rng(0)
    members = {}
    for name, (mean, sd) in item["distributions"].items():
        members[name] = distribution(family, np.array(mean), np.array(sd))
    # The emulator covers all of the distributions.
    phis = list(members.values())
    centre = family.mean(phis[0])
    spans = [np.maximum(family.scale(phi), np.abs(family.mean(phi) - centre)) for phi in phis]
    width = np.clip(np.max(spans, axis=0), 5e-5 * (problem.space.high - problem.space.low), None)
    assert problem.epsilon is not None
    local = Emulated().linearize_at(
        problem.simulator, problem.segments, family, problem.epsilon, centre, width, rng
    )
    base = family.base(HopperStudySize(**item["size"]).draws, rng)
    targets = problem.simulator.targets(problem.segments)
    gaussian = MonteCarlo(base.shape[1])
    out = {}
    for name, phi in members.items():
        values = family.draw(phi, base)
        predictions = {
            "simulator": problem.simulator.predict(values, problem.segments),
            "emulator": local.predict(values),
        }
        out[name] = {"exact": float(local(phi))}
        for source, predicted in predictions.items():
            densities = gaussian.log_density(predicted, targets, problem.epsilon)
            out[name][source] = float(densities.sum())
    return out


def distribution(family: TruncatedGaussian, mean: Array, sd: Array) -> Array:
    """The truncated Gaussian of a mean and a standard deviation.

    Parameters
    ----------
    family : TruncatedGaussian
        The family.
    mean, sd : (4,) arrays
        Mean and standard deviation of the distribution itself [kg].

    Returns
    -------
    array
        Its phi; with the smallest scale where the standard deviation is below that.
    """
    widest = family.unknowns.high[4:]
    sd_per_scale = family.sd(family.phi(mean, widest)) / widest
    return family.phi(mean, sd / sd_per_scale)


def evaluated(item: Item) -> dict[str, Any]:
    """The thesis' log-likelihood of distributions on the item's data, by Monte Carlo.

    Parameters
    ----------
    item : dict
        As `item` gives it, with `distributions` {name: [mean, sd]} [kg].

    Returns
    -------
    dict
        Log-likelihoods by name [nats].
    """
    problem, _ = problem_of(item)
    family = TruncatedGaussian(problem.space)
    assert problem.epsilon is not None
    gaussian = MonteCarlo(HopperStudySize(**item["size"]).draws)
    objective = gaussian.bind(
        problem.simulator, problem.segments, family, problem.epsilon, np.random.default_rng(0)
    )
    out = {}
    for name, (mean, sd) in item["distributions"].items():
        out[name] = objective(distribution(family, np.array(mean), np.array(sd)))
    return out
