"""Simulation-based calibration of posteriors.

Under data drawn from the prior, the truth's rank among the posterior's draws is uniform.

References
----------
Talts, Betancourt, Simpson, Vehtari, Gelman, "Validating Bayesian inference algorithms with
simulation-based calibration", 2018, arXiv:1804.06788.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import find
from dropo.core.services.tables import number
from dropo.core.services.validation import Array, known, require
from dropo.estimators.posterior import Posterior
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.problem import hopper
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.testing.statistics import BINS, posterior_draws, ranks, uniformity

SAMPLERS: dict[str, dict[str, Any]] = {
    "emcee": {"walkers": 20, "steps": 200, "burn_in": 120},
    "pyro-nuts": {"chains": 1, "warmup": 80, "draws": 120},
    "pyro-svi": {"draws": 400, "steps": 600},
}
"""Samplers and their settings: of parameters emcee takes the simulator itself, all others and all
posteriors of distributions the emulated likelihood.
"""
METHODS: dict[str, dict[str, Any]] = {"epopt": {}, "npe": {"draws": 200}}
"""Methods that give a posterior of the parameters alone, and their settings."""
OF_DISTRIBUTION = ", distribution"
"""Ends the names of cases whose posterior is that of the distribution's means and scales."""
CASES = (
    "sliding block",
    "hopper",
    "sliding block" + OF_DISTRIBUTION,
    "hopper" + OF_DISTRIBUTION,
)
FAMILY = "truncated_gaussian"
"""Distributions of which parameters are drawn, one for each row."""
ROWS = 40
"""Rows of the cases with a distribution."""
TOO_NARROW = 1.5
"""Factor by which the control's posterior is narrower."""


@dataclass(frozen=True)
class CalibrationSettings:
    """How large the study is, and when ranks count as uniform.

    Attributes
    ----------
    replications : int
        Data sets of each case.
    minimum_p : float
        Lower bound of the p-value of uniform ranks, over all parameters.
    """

    replications: int = 100
    minimum_p: float = 0.01


DEFAULT = CalibrationSettings()


def calibration(
    work: Work,
    seeds: int | None = None,
    *,
    problems: Sequence[str] = CASES[:2],
    settings: CalibrationSettings = DEFAULT,
) -> Study:
    """Ranks of the truth under samplers and methods, on a sliding block and on the hopper.

    A control, whose posterior is too narrow, must fail.

    Parameters
    ----------
    work : Work
        Runs the replications.
    seeds : int or None
        Data sets of each case; None for the settings' number.
    problems : sequence of str
        Cases.
    settings : CalibrationSettings
        The number of data sets, and when ranks count as uniform.

    Returns
    -------
    Study
        p-values of each case and sampler.

    Raises
    ------
    UnknownName
        If there is no such case.
    BadArgument
        If `seeds` leaves fewer than five ranks in a bin.
    """
    chosen = [known("case", name, CASES) for name in problems]
    count = settings.replications if seeds is None else seeds
    require(
        count >= 5 * BINS, "seeds", f"at least {5 * BINS}, for five in a bin", count, "calibration"
    )
    rows = []
    data = {}
    for case in chosen:
        for sampler in methods_of(case):
            answers = work.map(replication, [[case, sampler, seed] for seed in range(count)])
            found = np.array([answer["ranks"] for answer in answers])
            p = uniformity(found)
            control_p = uniformity(np.array([answer["control"] for answer in answers]))
            data[f"{case}, {sampler}"] = {"ranks": found, "p": p, "p_control": control_p}
            rows.append((case, sampler, *_cells(p, settings), *_cells(control_p, settings)))
    header = (
        "data",
        "sampler",
        "p of each number",
        "ranks are",
        f"p, {TOO_NARROW} times too narrow",
        "ranks are",
    )
    remark = (
        f"'uniform' where the least of the d p-values, times d, is above {settings.minimum_p}.",
    )
    return Study(
        "calibration",
        f"Simulation-based calibration, {count} data sets each",
        (Table("Ranks", header, tuple(rows)),),
        remark,
        data,
    )


def _cells(p: Array, settings: CalibrationSettings) -> tuple[str, str]:
    """The p-values, and whether they allow uniform ranks (Bonferroni)."""
    shown = ", ".join(number(value, 2) for value in p)
    return shown, "uniform" if len(p) * p.min() > settings.minimum_p else "not uniform"


def replication(item: list[Any]) -> dict[str, Any]:
    """One truth from the flat prior, its data and its posterior.

    Parameters
    ----------
    item : list
        Case, sampler and seed.

    Returns
    -------
    dict
        ranks: the truth's; control: those among draws that are too narrow; warnings: the fit's.
    """
    case, name, seed = item
    rng = np.random.default_rng([seed, CASES.index(case)])
    make = (_block, _hopper, _varying_block, _varying_hopper)[CASES.index(case)]
    problem, truth = make(rng)
    fit = _estimator(case, name).fit(problem, rng=rng)
    draws = posterior_draws(fit)
    narrow = draws.mean(axis=0) + (draws - draws.mean(axis=0)) / TOO_NARROW
    return {
        "ranks": ranks(draws, truth).tolist(),
        "control": ranks(narrow, truth).tolist(),
        "warnings": list(fit.warnings),
    }


def methods_of(case: str) -> tuple[str, ...]:
    """List what gives a posterior of a case: samplers, and of parameters also other methods.

    Parameters
    ----------
    case : str
        Its name.

    Returns
    -------
    tuple of str
    """
    return tuple(SAMPLERS) if case.endswith(OF_DISTRIBUTION) else (*SAMPLERS, *METHODS)


def _estimator(case: str, name: str) -> Estimator:
    """The method or sampler of this name, set for a case."""
    if name in METHODS:
        method: Estimator = find("methods", name)(**METHODS[name])
        return method
    sampler = find("samplers", name)(**SAMPLERS[name])
    if case.endswith(OF_DISTRIBUTION):
        return Posterior(over="distribution", family=FAMILY, likelihood="emulated", sampler=sampler)
    return Posterior(sampler=sampler, start="least-squares")


def _block(rng: np.random.Generator) -> tuple[Problem, Array]:
    """A sliding block over 20 steps of 0.05 s, with errors of 5 mm and 5 mm/s; and its truth."""
    simulator = SlidingBlock()
    noise = 2.5e-5
    truth = simulator.space.from_unit(rng.random(2))
    forces = np.random.default_rng(0).normal(0.0, 3.0, (1, 20, 1))
    data = simulate(simulator, truth[None], forces, np.zeros(2), noise_variance=noise, rng=rng)
    return Problem("sliding block", simulator, data, epsilon=noise), truth


def _hopper(rng: np.random.Generator) -> tuple[Problem, Array]:
    """12 transitions of the hopper, with noise of variance 1e-5 on the next ones; and its truth.

    Starts are true states; the parameters are the four masses.
    """
    space = hopper(threads=1).space
    truth = space.from_unit(rng.random(len(space)))
    return _hopper_with(np.tile(truth, (12, 1)), rng), truth


def _hopper_with(masses: Array, rng: np.random.Generator) -> Problem:
    """As many transitions as there are rows of masses (N, 4) [kg], each with its own."""
    noise = 1e-5
    base = hopper(threads=1)
    data, _ = simulate_hopper(len(masses), 1, rng=0)
    problem = replace(
        base,
        name="hopper",
        trajectories=data,
        everything=None,
        held_out=None,
        epsilon=noise,
        truth=None,
        settings={},
    )
    of_each = np.arange(len(masses))
    predicted = base.simulator.predict(masses, problem.segments)[of_each, of_each]
    noisy = predicted + np.sqrt(noise) * rng.standard_normal(predicted.shape)
    return replace(problem, trajectories=replace(data, next_observations=noisy))


def _varying_block(rng: np.random.Generator) -> tuple[Problem, Array]:
    """Steps of 0.05 s from 2 m/s, each of a block of its own, with errors of 0.3 mm and 0.3 mm/s;
    and the member of the family (4,) that the blocks are drawn from.
    """
    simulator = SlidingBlock()
    noise = 1e-7
    family = find("families", FAMILY)(simulator.space)
    truth = family.unknowns.from_unit(rng.random(len(family.unknowns)))
    forces = np.random.default_rng(0).normal(0.0, 3.0, (ROWS, 1, 1))
    values = family.sample(truth, ROWS, rng)
    data = simulate(simulator, values, forces, np.array([0.0, 2.0]), noise_variance=noise, rng=rng)
    return Problem("varying block", simulator, data, epsilon=noise), truth


def _varying_hopper(rng: np.random.Generator) -> tuple[Problem, Array]:
    """Transitions of hoppers of their own, with noise of variance 1e-5 on the next states; and the
    member of the family (8,) that the masses are drawn from.
    """
    family = find("families", FAMILY)(hopper(threads=1).space)
    truth = family.unknowns.from_unit(rng.random(len(family.unknowns)))
    return _hopper_with(family.sample(truth, ROWS, rng), rng), truth
