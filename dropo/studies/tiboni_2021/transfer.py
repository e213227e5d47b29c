"""Policies for distributions that different methods found, run on the target: the laws, and the
tables that compare them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.services.tables import Table, number
from dropo.core.services.validation import Array
from dropo.estimators.droid import DROID
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.uniform_randomization import UniformRandomization

PUBLISHED = "dropo, published"
FITTED = ("dropo", "droid", "least squares")
UNIFORM = "uniform randomization"
NOMINAL = "the model as it is"
TRUE = "the target's numbers"
BOUNDS = 10
"""How many random bounds of the uniform distributions the thesis takes."""
Item = dict[str, Any]


def items(fits: int, bounds: int, size: Item, *, published: bool) -> list[Item]:
    """What is run: each fitting method on every data set, uniform randomization on every bound, and
    two points for reference.
    """
    numbers = {
        **dict.fromkeys(FITTED, fits),
        **({PUBLISHED: 1} if published else {}),
        UNIFORM: bounds,
        NOMINAL: 1,
        TRUE: 1,
    }
    return [
        {"method": method, "number": i, "size": size}
        for method, count in numbers.items()
        for i in range(count)
    ]


def data_set(item: Item) -> int:
    """The seed of the item's data; what is not fitted looks at the first ones."""
    return int(item["number"]) if item["method"] in (*FITTED, PUBLISHED) else 0


def estimator(item: Item, draws: int, epsilon: float) -> Estimator | None:
    """The item's method, None for a point; `draws` and `epsilon` are the thesis' own, for its
    method as published.
    """
    size = item["size"]
    as_published = DROPO(
        likelihood="monte-carlo",
        optimizer="cma-es",
        epsilon=epsilon,
        draws=draws,
        budget=size["published"],
    )
    if item["method"] in (NOMINAL, TRUE):
        return None
    return {
        "dropo": DROPO(likelihood="linear", epsilon="learn"),
        PUBLISHED: as_published,
        "droid": DROID(budget=size["droid"]),
        "least squares": LeastSquares(budget=20),
        UNIFORM: UniformRandomization(count=BOUNDS, which=item["number"] % BOUNDS, draws=2),
    }[item["method"]]


def distribution(
    item: Item, problem: Problem, made: Estimator | None, draws: int
) -> tuple[Array, dict[str, Any]]:
    """Draws (K, d) of the item's distribution, one where it is a point, and what is kept of it;
    `made` fits it, None: a point.
    """
    if made is None:
        values = (
            problem.simulator.nominal
            if item["method"] == NOMINAL
            else problem.space.vector(problem.truth or {})
        )
        assert values is not None
        return values[None], {
            "mean": values.tolist(),
            "sd": [0.0] * len(values),
            "steps": 0,
            "seconds": 0.0,
        }
    fit = made.fit(problem, rng=0 if item["method"] == UNIFORM else item["number"])
    kept = {
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "steps": fit.simulator_steps,
        "seconds": fit.wall_time_s,
    }
    values = fit.sample(draws, np.random.default_rng([6, item["number"]]))
    return values[:1] if (values == values[0]).all() else values, kept


def by_method(runs: Sequence[dict[str, Any]], key: str) -> dict[str, Array]:
    """For each method the numbers under that key, a row a run."""
    return {
        method: np.array([run[key] for run in runs if run["method"] == method])
        for method in dict.fromkeys(r["method"] for r in runs)
    }


def by_unit(runs: Sequence[dict[str, Any]], key: str) -> dict[str, Array]:
    """For each method the means under that key of what was drawn independently: (data sets or
    bounds,); runs on one bound count as one.
    """
    means: dict[str, dict[int, list[float]]] = {}
    for run in runs:
        unit = run["number"] % BOUNDS if run["method"] == UNIFORM else run["number"]
        means.setdefault(run["method"], {}).setdefault(unit, []).append(float(np.mean(run[key])))
    return {
        method: np.array([np.mean(values) for values in units.values()])
        for method, units in means.items()
    }


def mean_and_error(units: Array) -> tuple[float, float]:
    """The mean (n,) and its standard error; NaN where there is one."""
    return float(units.mean()), float(units.std(ddof=1) / np.sqrt(len(units))) if len(
        units
    ) > 1 else np.nan


def apart(one: Array, other: Array) -> float:
    """How many standard errors the other units' mean lies above the one units'; NaN where either is
    a single one.
    """
    (a, error_a), (b, error_b) = mean_and_error(one), mean_and_error(other)
    return (b - a) / float(np.hypot(error_a, error_b))


def comparison(runs: Sequence[dict[str, Any]], near: float, rewards: bool = True) -> Table:
    """Distances [cm] on the target by method, the worst run's, how many lie within `near` [m], and
    rewards.
    """
    distances = by_unit(runs, "distances")
    reward = by_unit(runs, "rewards") if rewards else {}
    lines = []
    for method, values in by_method(runs, "distances").items():
        mean, error = mean_and_error(100 * distances[method])
        gained = [_with_error(*mean_and_error(reward[method]), 3)] if rewards else []
        worst = 100 * values.reshape(len(values), -1).mean(axis=1).max()
        lines.append(
            (
                method,
                str(len(values)),
                _with_error(mean, error, 2),
                f"{worst:.2f}",
                f"{np.mean(values <= near):.0%}",
                *gained,
            )
        )
    header = (
        "",
        "runs",
        "distance [cm]",
        "worst run",
        f"within {100 * near:.0f} cm",
        *(["reward"] if rewards else []),
    )
    return Table(
        "On the target: mean, and standard error between data sets or bounds", header, tuple(lines)
    )


def differences(runs: Sequence[dict[str, Any]]) -> Table:
    """How much farther from the goal each method's runs end than each other's, in standard errors;
    of methods with several runs.
    """
    distances = {
        method: values for method, values in by_unit(runs, "distances").items() if len(values) > 1
    }
    lines = [
        (
            row,
            *(
                "-" if row == column else f"{apart(distances[column], distances[row]):+.1f}"
                for column in distances
            ),
        )
        for row in distances
    ]
    return Table(
        "Farther from the goal by so many standard errors, row than column",
        ("", *distances),
        tuple(lines),
    )


def found(
    runs: Sequence[dict[str, Any]], problem: Problem, thesis: Mapping[str, Mapping[str, str]]
) -> Table:
    """Means and standard deviations by parameter of the first run, the error over all runs, and
    what the thesis found on its robot.
    """
    space = problem.space
    truth = problem.space.vector(problem.truth or {})
    means = by_method(runs, "mean")
    sds = by_method(runs, "sd")
    shown = [method for method in (*FITTED, PUBLISHED) if method in means]
    spreads = [method for method in shown if sds[method].any()]
    lines = []
    for i, parameter in enumerate(space):
        cells = []
        for method in shown:
            error = np.sqrt(np.mean((means[method][:, i] - truth[i]) ** 2))
            spread = [number(sds[method][0, i], 2)] if method in spreads else []
            cells += [number(means[method][0, i], 4), *spread, number(float(error), 2)]
        known = [told.get(parameter.name, "-") for told in thesis.values()]
        lines.append((parameter.name, parameter.unit, number(truth[i], 4), *cells, *known))
    columns = [
        f"{method} {what}"
        for method in shown
        for what in ("mean", *(["sd"] if method in spreads else []), "error")
    ]
    header = ("parameter", "unit", "target", *columns, *thesis)
    return Table(
        (
            "Found: the first data set's mean and standard deviation, and the root mean square "
            "error over all"
        ),
        header,
        tuple(lines),
    )


def cost(runs: Sequence[dict[str, Any]]) -> Table:
    """Simulator steps of fits, and of the policies made for them: medians."""
    fits = by_method(runs, "steps")
    policies = by_method(runs, "policy_steps")
    lines = tuple(
        (method, *(f"{np.median(steps[method]):,.0f}" for steps in (fits, policies)))
        for method in fits
    )
    return Table("Cost: simulator steps, medians", ("", "of a fit", "of a policy"), lines)


def verdict(runs: Sequence[dict[str, Any]], target: float) -> tuple[str, str]:
    """Whether dropo's policies come as near as they should, and whether uniform randomization's are
    farther by two standard errors.
    """
    distances = by_unit(runs, "distances")
    mean, error = mean_and_error(distances["dropo"])
    reached = "within" if mean <= target else "not within"
    difference = apart(distances["dropo"], distances[UNIFORM])
    told = (
        f"Uniform randomization's end {difference:+.1f} standard errors farther away: "
        f"{'more' if difference > 2 else 'not more'} than two."
    )
    return (
        (
            f"DROPO's policies come to {_with_error(100 * mean, 100 * error, 2)} cm of the "
            f"goal on average, {reached} {100 * target:.0f} cm."
        ),
        told
        if np.isfinite(difference)
        else "With a single run of a method, differences have no standard error.",
    )


def draw(figure: Any, runs: Sequence[dict[str, Any]]) -> None:
    """Each run's mean distance to the goal, by method, and their mean."""
    axes = figure.subplots()
    for place, (method, values) in enumerate(by_method(runs, "distances").items()):
        each = 100 * values.reshape(len(values), -1).mean(axis=1)
        axes.plot(np.full(len(each), place), each, "o", markersize=4, alpha=0.6, label=method)
        axes.plot([place - 0.25, place + 0.25], [each.mean()] * 2, color="black", linewidth=1)
    methods = list(by_method(runs, "distances"))
    axes.set_xticks(range(len(methods)), methods, rotation=15)
    axes.set(ylabel="distance to the goal [cm]", ylim=(0, None))


def _with_error(mean: float, error: float, digits: int) -> str:
    return f"{mean:.{digits}f}" + (f" +- {error:.{digits}f}" if np.isfinite(error) else "")
