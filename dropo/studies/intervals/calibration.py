"""Simulation-based calibration of posteriors: under data drawn from the prior, the truth's rank
among the draws is uniform.

Talts, Betancourt, Simpson, Vehtari, Gelman (2018), arXiv:1804.06788.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.registry import find
from dropo.core.services.tables import number
from dropo.core.services.validation import Array, require
from dropo.estimators.posterior import Posterior
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.problem import hopper
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

# ranks 0 ... 99 in ten bins
LEVELS = 99
BINS = 10
REPLICATIONS = 100
TOO_NARROW = 1.5  # the control's posterior is narrower by this factor
LEAST = 0.01  # the p-value below which ranks are not uniform
SAMPLERS: dict[str, dict[str, Any]] = {
    "emcee": {"walkers": 20, "steps": 200, "burn_in": 120},
    "pyro-nuts": {"chains": 1, "warmup": 80, "draws": 120},
}
"""Samplers and their settings: emcee on the simulator itself, Pyro on the emulated likelihood."""
CASES = ("sliding block", "hopper")


def ranks(draws: Array, truth: Array, levels: int = LEVELS) -> Ints:
    """(d,) how many of `levels` draws, spread evenly over all draws (K, d), are below the truth
    (d,): 0 ... levels.
    """
    require(len(draws) >= levels, "draws", f"at least {levels}", len(draws), "ranks")
    chosen = draws[np.linspace(0, len(draws) - 1, levels).round().astype(int)]
    return np.asarray((chosen < truth).sum(axis=0), dtype=np.int64)


def uniformity(found: Ints, levels: int = LEVELS, bins: int = BINS) -> Array:
    """(d,) chi-square p-values of ranks (N, d) being uniform on 0 ... levels, in equal bins."""
    require((levels + 1) % bins == 0, "bins", f"a divisor of {levels + 1}", bins, "uniformity")
    counts = np.array(
        [np.bincount(column * bins // (levels + 1), minlength=bins) for column in found.T]
    )  # (d, bins)
    expected = len(found) / bins
    return np.asarray(chi2.sf(((counts - expected) ** 2 / expected).sum(axis=1), bins - 1))


def calibration(work: Work, seeds: int | None = None) -> Study:
    """Ranks of the true parameters under emcee and under Pyro, on a sliding block and on the
    Hopper; and a control that must fail.
    """
    count = REPLICATIONS if seeds is None else seeds
    require(
        count >= 5 * BINS, "seeds", f"at least {5 * BINS}, for five in a bin", count, "calibration"
    )
    rows = []
    data = {}
    for case in CASES:
        for sampler in SAMPLERS:
            answers = work.map(replication, [[case, sampler, seed] for seed in range(count)])
            found = {
                kind: np.array([answer[kind] for answer in answers])
                for kind in ("ranks", "control")
            }
            p = {kind: uniformity(values) for kind, values in found.items()}
            data[f"{case}, {sampler}"] = {
                "ranks": found["ranks"],
                "p": p["ranks"],
                "p_control": p["control"],
            }
            shown = [
                ", ".join(number(value, 2) for value in p[kind]) for kind in ("ranks", "control")
            ]
            rows.append(
                (case, sampler, shown[0], _verdict(p["ranks"]), shown[1], _verdict(p["control"]))
            )
    header = (
        "data",
        "sampler",
        "p of each parameter",
        "ranks are",
        f"p, {TOO_NARROW} times too narrow",
        "ranks are",
    )
    remark = (f"'uniform' where the least of the d p-values, times d, is above {LEAST}.",)
    return Study(
        "calibration",
        f"Simulation-based calibration, {count} data sets each",
        (Table("Ranks", header, tuple(rows)),),
        remark,
        data,
    )


def _verdict(p: Array) -> str:
    return "uniform" if len(p) * p.min() > LEAST else "not uniform"


def replication(item: list[Any]) -> dict[str, Any]:
    """One truth from the flat prior, its data and posterior: the truth's ranks, and those among
    draws that are too narrow.
    """
    case, name, seed = item
    rng = np.random.default_rng([seed, CASES.index(case)])
    problem, truth = {"sliding block": _block, "hopper": _hopper}[case](rng)
    sampler = find("samplers", name)(**SAMPLERS[name])
    fit = Posterior(sampler=sampler, start="least-squares").fit(problem, rng=rng)
    assert fit.posterior is not None
    draws = fit.posterior.chain.reshape(-1, len(truth))
    narrow = draws.mean(axis=0) + (draws - draws.mean(axis=0)) / TOO_NARROW
    return {
        "ranks": ranks(draws, truth).tolist(),
        "control": ranks(narrow, truth).tolist(),
        "warnings": list(fit.warnings),
    }


def _block(rng: np.random.Generator) -> tuple[Problem, Array]:
    """A sliding block over 20 steps of 0.05 s, position and velocity with errors of 5 mm and 5
    mm/s.
    """
    simulator = SlidingBlock()
    noise = 2.5e-5
    truth = simulator.space.from_unit(rng.random(2))
    forces = np.random.default_rng(0).normal(0.0, 3.0, (1, 20, 1))
    data = simulate(simulator, truth[None], forces, np.zeros(2), noise_variance=noise, rng=rng)
    return Problem("sliding block", simulator, data, epsilon=noise), truth


def _hopper(rng: np.random.Generator) -> tuple[Problem, Array]:
    """12 transitions of the Hopper from true states, with noise of variance 1e-5 on the next ones;
    four masses.
    """
    noise = 1e-5
    base = hopper(threads=1)
    truth = base.space.from_unit(rng.random(len(base.space)))
    data, _ = simulate_hopper(12, 1, rng=0)
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
    predicted = base.simulator.predict(truth[None], problem.segments)[0]
    noisy = predicted + np.sqrt(noise) * rng.standard_normal(predicted.shape)
    return replace(problem, trajectories=replace(data, next_observations=noisy)), truth
