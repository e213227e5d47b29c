"""Policies for distributions that different methods found, run on the target.

The distributions, and the tables that compare the policies.
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
"""What a run takes: method, number and size."""
Result = dict[str, Any]
"""What a run gives: `method`, `number`, `distances` [m] and more."""


def items(fits: int, bounds: int, size: Item, *, published: bool) -> list[Item]:
    """The runs of a study.

    Parameters
    ----------
    fits : int
        Number of data sets, each fitted by every method.
    bounds : int
        Runs of uniform randomization.
    size : dict
        How large the study is.
    published : bool
        Whether the method is also run once as published.

    Returns
    -------
    list of dict
        With `method`, `number` and `size`; last come two points for reference.
    """
    counts = dict.fromkeys(FITTED, fits)
    if published:
        counts[PUBLISHED] = 1
    counts |= {UNIFORM: bounds, NOMINAL: 1, TRUE: 1}
    return [
        {"method": method, "number": i, "size": size}
        for method, count in counts.items()
        for i in range(count)
    ]


def data_set(item: Item) -> int:
    """Give the seed of an item's data.

    Parameters
    ----------
    item : dict
        The item of a task, with its number and method.

    Returns
    -------
    int
        The number of the run; 0, the first data set, for methods that fit nothing.
    """
    return int(item["number"]) if item["method"] in (*FITTED, PUBLISHED) else 0


def estimator(item: Item, draws: int, epsilon: float) -> Estimator | None:
    """Build the item's method.

    Parameters
    ----------
    item : dict
        One of `items`.
    draws, epsilon : int, float
        The thesis' own, for its method as published.

    Returns
    -------
    Estimator or None
        None for a point.
    """
    method = item["method"]
    size = item["size"]
    if method in (NOMINAL, TRUE):
        return None
    if method == PUBLISHED:
        return DROPO(
            likelihood="monte-carlo",
            optimizer="cma-es",
            epsilon=epsilon,
            draws=draws,
            budget=size["published"],
        )
    if method == UNIFORM:
        return UniformRandomization(count=BOUNDS, which=item["number"] % BOUNDS, draws=2)
    if method == "droid":
        return DROID(budget=size["droid"])
    if method == "least squares":
        return LeastSquares(budget=20)
    return DROPO(likelihood="linear", epsilon="learn")


def distribution(
    item: Item, problem: Problem, method: Estimator | None, draws: int
) -> tuple[Array, dict[str, Any]]:
    """Draws of the item's distribution.

    Parameters
    ----------
    item : dict
        One of `items`.
    problem : Problem
        The problem that is fitted.
    method : Estimator or None
        What fits it; None for a point.
    draws : int
        Number of draws, K.

    Returns
    -------
    values : (K, d) array
        Parameter vectors, a single one if the distribution is a point.
    kept : dict
        Mean, standard deviation and cost of the fit.
    """
    if method is None:
        if item["method"] == NOMINAL:
            values = problem.simulator.nominal
        else:
            values = problem.space.vector(problem.truth or {})
        assert values is not None
        zeros = [0.0] * len(values)
        return values[None], {"mean": values.tolist(), "sd": zeros, "steps": 0, "seconds": 0.0}
    fit = method.fit(problem, rng=0 if item["method"] == UNIFORM else item["number"])
    kept = {
        "mean": fit.mean.tolist(),
        "sd": fit.sd.tolist(),
        "steps": fit.simulator_steps,
        "seconds": fit.wall_time_s,
    }
    values = fit.sample(draws, np.random.default_rng([6, item["number"]]))
    return values[:1] if (values == values[0]).all() else values, kept


def by_method(runs: Sequence[Result], key: str) -> dict[str, Array]:
    """Collect for each method the numbers that its runs have under a key.

    Parameters
    ----------
    runs : sequence of dict
        Answers of tasks, with their method.
    key : str
        Under which a number or a list of numbers stands.

    Returns
    -------
    dict of str to array
        By method, a row for each run.
    """
    rows: dict[str, list[Any]] = {}
    for run in runs:
        rows.setdefault(run["method"], []).append(run[key])
    return {method: np.array(own) for method, own in rows.items()}


def by_unit(runs: Sequence[Result], key: str) -> dict[str, Array]:
    """For each method the means of what was drawn independently.

    Parameters
    ----------
    runs : sequence of dict
        The runs.
    key : str
        Under which numbers are averaged.

    Returns
    -------
    dict of (n,) arrays
        A mean for each data set or bound; runs on one bound count as one.
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
    """Compute a mean and its standard error.

    Parameters
    ----------
    units : (n,) array
        Independent values, of any unit.

    Returns
    -------
    mean, error : float
        In the same unit; the error is NaN of a single value.
    """
    if len(units) == 1:
        return float(units.mean()), np.nan
    return float(units.mean()), float(units.std(ddof=1) / np.sqrt(len(units)))


def apart(one: Array, other: Array) -> float:
    """Compute how many standard errors one mean lies above another.

    Parameters
    ----------
    one : (n,) array
        Independent values.
    other : (m,) array
        Independent values, whose mean is compared with that of `one`.

    Returns
    -------
    float
        The difference of the means in its standard error; NaN if either is a single value.
    """
    one_mean, one_error = mean_and_error(one)
    other_mean, other_error = mean_and_error(other)
    return (other_mean - one_mean) / float(np.hypot(one_error, other_error))


def comparison(runs: Sequence[Result], near: float, rewards: bool = True) -> Table:
    """How policies do on the target, by method.

    Parameters
    ----------
    runs : sequence of dict
        The runs.
    near : float
        Distance [m] within which tries are counted.
    rewards : bool
        Whether runs have rewards.

    Returns
    -------
    Table
        Mean distance [cm], that of the worst run, how many lie near, and rewards.
    """
    distances = by_unit(runs, "distances")
    reward = by_unit(runs, "rewards") if rewards else {}
    lines = []
    for method, values in by_method(runs, "distances").items():
        cells = [
            method,
            str(len(values)),
            _with_error(*mean_and_error(100 * distances[method]), 2),
            f"{100 * values.reshape(len(values), -1).mean(axis=1).max():.2f}",
            f"{np.mean(values <= near):.0%}",
        ]
        if rewards:
            cells.append(_with_error(*mean_and_error(reward[method]), 3))
        lines.append(tuple(cells))
    header = ["", "runs", "distance [cm]", "worst run", f"within {100 * near:.0f} cm"]
    if rewards:
        header.append("reward")
    title = "On the target: mean, and standard error between data sets or bounds"
    return Table(title, tuple(header), tuple(lines))


def differences(runs: Sequence[Result]) -> Table:
    """How much farther from the goal each method's runs end than each other's.

    Parameters
    ----------
    runs : sequence of dict
        The runs; methods with a single one are left out.

    Returns
    -------
    Table
        Differences of the mean distances in standard errors.
    """
    distances = {}
    for method, values in by_unit(runs, "distances").items():
        if len(values) > 1:
            distances[method] = values
    lines = []
    for row, own in distances.items():
        cells = [
            "-" if row == column else f"{apart(other, own):+.1f}"
            for column, other in distances.items()
        ]
        lines.append((row, *cells))
    title = "Farther from the goal by so many standard errors, row than column"
    return Table(title, ("", *distances), tuple(lines))


def found(
    runs: Sequence[Result], problem: Problem, thesis: Mapping[str, Mapping[str, str]]
) -> Table:
    """What the methods found, by parameter.

    Parameters
    ----------
    runs : sequence of dict
        The runs.
    problem : Problem
        Its truth is the target's.
    thesis : mapping
        What the thesis found on its robot: name -> parameter -> text.

    Returns
    -------
    Table
        Mean and standard deviation of the first run, and the root mean square error over all.
    """
    space = problem.space
    truth = space.vector(problem.truth or {})
    means = by_method(runs, "mean")
    sds = by_method(runs, "sd")
    shown = [method for method in (*FITTED, PUBLISHED) if method in means]
    with_sd = [method for method in shown if sds[method].any()]
    columns = []
    for method in shown:
        names = ("mean", "sd", "error") if method in with_sd else ("mean", "error")
        columns += [f"{method} {name}" for name in names]
    lines = []
    for i, parameter in enumerate(space):
        cells = [parameter.name, parameter.unit, number(truth[i], 4)]
        for method in shown:
            error = np.sqrt(np.mean((means[method][:, i] - truth[i]) ** 2))
            cells.append(number(means[method][0, i], 4))
            if method in with_sd:
                cells.append(number(sds[method][0, i], 2))
            cells.append(number(float(error), 2))
        cells += [values.get(parameter.name, "-") for values in thesis.values()]
        lines.append(tuple(cells))
    title = (
        "Found: the first data set's mean and standard deviation, and the root mean square "
        "error over all"
    )
    return Table(title, ("parameter", "unit", "target", *columns, *thesis), tuple(lines))


def cost(runs: Sequence[Result]) -> Table:
    """Tabulate simulator steps of fits, and of the policies made for them.

    Parameters
    ----------
    runs : sequence of dict
        Answers of tasks, with their steps.

    Returns
    -------
    Table
        Medians over runs, a row for each method.
    """
    policies = by_method(runs, "policy_steps")
    lines = []
    for method, fits in by_method(runs, "steps").items():
        lines.append((method, f"{np.median(fits):,.0f}", f"{np.median(policies[method]):,.0f}"))
    return Table("Cost: simulator steps, medians", ("", "of a fit", "of a policy"), tuple(lines))


def verdict(runs: Sequence[Result], target: float) -> tuple[str, str]:
    """Two sentences: whether DROPO's policies come near, and whether others' stay farther away.

    Parameters
    ----------
    runs : sequence of dict
        The runs.
    target : float
        Distance [m] within which DROPO's policies should come on average.

    Returns
    -------
    (str, str)
        The others are those of uniform randomization, which should be farther by two standard
        errors.
    """
    distances = by_unit(runs, "distances")
    mean, error = mean_and_error(distances["dropo"])
    reached = "within" if mean <= target else "not within"
    first = (
        f"DROPO's policies come to {_with_error(100 * mean, 100 * error, 2)} cm of the "
        f"goal on average, {reached} {100 * target:.0f} cm."
    )
    difference = apart(distances["dropo"], distances[UNIFORM])
    if not np.isfinite(difference):
        return first, "With a single run of a method, differences have no standard error."
    return first, (
        f"Uniform randomization's end {difference:+.1f} standard errors farther away: "
        f"{'more' if difference > 2 else 'not more'} than two."
    )


def draw(figure: Any, runs: Sequence[Result]) -> None:
    """Draw each run's mean distance to the goal by method, and their mean.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Where to draw.
    runs : sequence of dict
        The runs.
    """
    axes = figure.subplots()
    distances = by_method(runs, "distances")
    for place, (method, values) in enumerate(distances.items()):
        each = 100 * values.reshape(len(values), -1).mean(axis=1)
        axes.plot(np.full(len(each), place), each, "o", markersize=4, alpha=0.6, label=method)
        axes.plot([place - 0.25, place + 0.25], [each.mean()] * 2, color="black", linewidth=1)
    axes.set_xticks(range(len(distances)), list(distances), rotation=15)
    axes.set(ylabel="distance to the goal [cm]", ylim=(0, None))


def _with_error(mean: float, error: float, digits: int) -> str:
    """A mean with its standard error, if it has one."""
    return f"{mean:.{digits}f}" + (f" +- {error:.{digits}f}" if np.isfinite(error) else "")
