"""How far fits are from the truth where states are noisy or velocities are not logged."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.services.validation import require
from dropo.estimators.dropo import DROPO
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.unlogged_states.machines import NOISES, simulate_log

METHODS = {"as it comes": "auto", "from measured states": "emulated"}
"""`dropo fit` as it comes, and with the likelihood that takes measurements for states."""
Case = tuple[str, str]
"""Machine and noise."""
CASES: tuple[Case, ...] = (*(("arm", noise) for noise in NOISES), ("spring-mass", "all noisy"))


@dataclass(frozen=True)
class UnloggedStatesSettings:
    """How large the study is, and what counts.

    Attributes
    ----------
    development : int
        Number of logs of each case that were at hand while the method was written.
    evaluation : int
        Number of other logs of each case.
    controls : int
        Number of the evaluation's logs that are fitted from measured states too.
    first_evaluation : int
        The first seed of the evaluation; the development's begin at 0.
    accepted : (float, float)
        Coverage of 95 % intervals, outside of which a remark says so.
    widest : float
        Width of intervals over the optimum, above which a remark says so.
    spread : float
        A fitted spread above this fraction of the mean is one that is not there.
    """

    development: int = 10
    evaluation: int = 30
    controls: int = 3
    first_evaluation: int = 500_000
    accepted: tuple[float, float] = (0.90, 0.98)
    widest: float = 1.5
    spread: float = 0.01


DEFAULT = UnloggedStatesSettings()


def unlogged_states(
    work: Work,
    seeds: int | None = None,
    *,
    cases: tuple[Case, ...] = CASES,
    settings: UnloggedStatesSettings = DEFAULT,
) -> Study:
    """Bias, coverage and width of intervals, over the Cramer-Rao bound.

    Parameters
    ----------
    work : Work
        Runs the fits.
    seeds : int or None
        Logs of each case in development and evaluation alike; None for the settings' numbers.
    cases : tuple of Case
        Machine and noise.
    settings : UnloggedStatesSettings

    Returns
    -------
    Study
        A row for each case, set of seeds and method.

    Raises
    ------
    BadArgument
        If `seeds` is below 2.
    """
    require(seeds is None or seeds >= 2, "seeds", "at least 2", seeds, "unlogged_states")
    first = settings.first_evaluation
    parts = [
        ("development", "as it comes", 0, seeds or settings.development),
        ("evaluation", "as it comes", first, seeds or settings.evaluation),
        ("evaluation", "from measured states", first, seeds or settings.controls),
    ]
    items = []
    for machine, noise in cases:
        for _, method, begin, count in parts:
            items += [[machine, noise, method, begin + i] for i in range(count)]
    answers = iter(work.map(replication, items))

    rows = []
    remarks = []
    data = {}
    for machine, noise in cases:
        for name, method, _, count in parts:
            own = [next(answers) for _ in range(count)]
            found = summary(own, settings)
            rows.append((f"{machine}, {noise}", name, method, f"{count}", *_cells(found)))
            data[f"{machine}, {noise}, {name}, {method}"] = found
            if method == "as it comes":
                remarks += _remarks(f"{machine}, {noise}, {name}", found, settings)
    remarks.append(
        "Bias is the mean error in optimal standard errors, ± its own standard error; error is"
        " its root mean square; width the claimed standard error over the optimal one, a median."
    )
    remarks.append(
        f"Spread: fits with a standard deviation above {settings.spread:.0%} of a mean; there is"
        " none in the data. Trusted: fits that say nothing against their model, which is right."
    )
    header = (
        "log",
        "seeds",
        "fit",
        "logs",
        "bias",
        "error",
        "coverage",
        "of all",
        "width",
        "spread",
        "trusted",
        "steps",
    )
    return Study(
        "unlogged-states",
        "Fits of noisy and unlogged states, against the Cramer-Rao bound",
        (Table("95 % intervals, a number for each parameter", header, tuple(rows)),),
        tuple(remarks),
        data,
    )


def replication(item: list[Any]) -> dict[str, Any]:
    """One log and its fit.

    Parameters
    ----------
    item : list
        Machine, noise, method and seed.

    Returns
    -------
    dict
        error and width (d,) in optimal standard errors, inside (d,), spread (d,) as a fraction of
        the mean, trusted, the likelihood and the steps.
    """
    machine, noise, method, seed = item
    log = simulate_log(machine, noise, seed)
    fit = DROPO(likelihood=METHODS[method]).fit(log.problem, rng=seed)
    low, high = fit.interval().T
    return {
        "error": ((fit.mean - log.truth) / log.optimum).tolist(),
        "width": (fit.mean_se / log.optimum).tolist(),
        "inside": ((low <= log.truth) & (log.truth <= high)).tolist(),
        "spread": (fit.sd / fit.mean).tolist(),
        "trusted": fit.trusted is True,
        "likelihood": fit.likelihood,
        "steps": fit.simulator_steps,
    }


def summary(own: list[dict[str, Any]], settings: UnloggedStatesSettings) -> dict[str, Any]:
    """Summarise the fits of one row.

    Parameters
    ----------
    own : list of dict
        What `replication` gives.
    settings : UnloggedStatesSettings

    Returns
    -------
    dict
    """
    errors = np.array([answer["error"] for answer in own])
    inside = np.array([answer["inside"] for answer in own])
    spread = np.array([answer["spread"] for answer in own])
    return {
        "logs": len(own),
        "bias": errors.mean(axis=0),
        "bias_error": errors.std(axis=0, ddof=1) / np.sqrt(len(own)),
        "rms": np.sqrt(np.mean(errors**2, axis=0)),
        "coverage": inside.mean(axis=0),
        "coverage_of_all": float(inside.mean()),
        "width": np.nanmedian([answer["width"] for answer in own], axis=0),
        "spread": float((spread > settings.spread).any(axis=1).mean()),
        "trusted": float(np.mean([answer["trusted"] for answer in own])),
        "along_runs": float(np.mean([answer["likelihood"] == "trajectory" for answer in own])),
        "steps": float(np.mean([answer["steps"] for answer in own])),
    }


def _cells(found: dict[str, Any]) -> tuple[str, ...]:
    """The numbers of a row of the table."""
    pairs = zip(found["bias"], found["bias_error"], strict=True)
    bias = ", ".join(f"{value:+.2f} ± {error:.2f}" for value, error in pairs)
    return (
        bias,
        ", ".join(f"{value:.3g}" for value in found["rms"]),
        ", ".join(f"{value:.0%}" for value in found["coverage"]),
        f"{found['coverage_of_all']:.1%}",
        ", ".join(f"{value:.3g}" for value in found["width"]),
        f"{found['spread']:.0%}",
        f"{found['trusted']:.0%}",
        f"{found['steps']:.3g}",
    )


def _remarks(name: str, found: dict[str, Any], settings: UnloggedStatesSettings) -> list[str]:
    """What is outside of what is accepted."""
    said = []
    low, high = settings.accepted
    coverage = found["coverage_of_all"]
    if not low <= coverage <= high:
        said.append(f"{name}: {coverage:.1%} is not within {low:.0%} to {high:.0%}.")
    if not (found["width"] <= settings.widest).all():
        said.append(f"{name}: intervals are more than {settings.widest:g} times the optimum.")
    if found["along_runs"] < 1:
        said.append(f"{name}: {found['along_runs']:.0%} of the fits found starts along runs.")
    return said
