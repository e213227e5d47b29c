"""Figure 6.3: returns on the target of policies trained with a torso 1 kg too light."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from dropo.core.numerics.multiple_tests import holm
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.hopper_fits import AUTHORS, at_hand
from dropo.studies.tiboni_2021.hopper_sets import MEAN
from dropo.studies.tiboni_2021.light_torso import (
    AS_IT_IS,
    EXTENDED,
    FITTED,
    LAWS,
    PUBLISHED,
    TRUTH,
    TUNED,
    UNIFORM,
    Training,
    found,
    trained,
)
from dropo.studies.tiboni_2021.table_6_4 import MISSING

CLAIMS = (
    (TRUTH, "thesis, dropo"),
    ("thesis, dropo", "thesis, droid"),
    ("thesis, dropo", UNIFORM),
    (TRUTH, PUBLISHED),
    (PUBLISHED, "droid"),
    (PUBLISHED, UNIFORM),
    (TRUTH, TUNED),
    (TUNED, "droid"),
    (TUNED, UNIFORM),
)
"""What figure 6.3 says: the first above the second.

Under the thesis' own distributions, and under our fits of its data.
"""
OURS = (
    (EXTENDED, "thesis, dropo"),
    (EXTENDED, PUBLISHED),
    (EXTENDED, TUNED),
    (EXTENDED, "droid"),
    (EXTENDED, UNIFORM),
    (EXTENDED, AS_IT_IS),
)
"""What we say: the first above the second."""
NOTES = (
    "A policy's return is its mean over episodes on the target. Intervals (95 %, Student's "
    "t) are over training seeds; those of uniform randomization over its bounds, each the mean of "
    "its seeds. The thesis trains one policy for each of its bounds.",
    "Tests are paired by the training seed, which decides the directions of the search; "
    "uniform randomization enters with the mean of its bounds, which are taken as they are.",
    "The thesis shows figure 6.3 as a picture without numbers: the truth above DROPO, "
    "DROPO above DROID and above the average of uniform randomization, of which some bounds do "
    "well. Its laws are those that it prints in table 6.4.",
    "Policies here are linear and found by augmented random search without the bonus for "
    "being alive; the thesis trains networks by SAC.",
    "Other masses true: the model as it was before any fit, the torso too light and the "
    "other masses right.",
)
Run = dict[str, Any]
"""What `light_torso.trained` gives."""
Distributions = Sequence[dict[str, Any]]
"""What `light_torso.found` gives, for each distribution."""


@dataclass(frozen=True)
class ReturnStudySize:
    """How large the study is.

    Attributes
    ----------
    transitions : int
        Transitions that are fitted.
    droid : int
        Evaluations of DROID.
    bounds : int
        Bounds of uniform randomization.
    seeds : int
        Training seeds.
    distributions : tuple of str
        Names of the distributions, some of `LAWS`.
    training : Training
        How a policy is trained and evaluated.
    """

    transitions: int = 1000
    droid: int = 1000
    bounds: int = 10
    seeds: int = 5
    distributions: tuple[str, ...] = LAWS
    training: Training = field(default_factory=Training)


@dataclass(frozen=True)
class ComparisonSettings:
    """When a claim is decided, and when two distributions are one.

    Attributes
    ----------
    level : float
        Level of the tests.
    tolerance : float
        Difference of means and standard deviations [kg] within which two distributions are one.
    """

    level: float = 0.05
    tolerance: float = 0.002


FULL = ReturnStudySize()
DEFAULT = ComparisonSettings()


def figure_6_3(
    work: Work,
    seeds: int | None = None,
    *,
    size: ReturnStudySize = FULL,
    settings: ComparisonSettings = DEFAULT,
) -> Study:
    """Returns on the target of policies trained with a torso 1 kg too light (figure 6.3).

    They are trained under DROPO's and DROID's distributions, uniform bounds, the extended model
    and the truth.

    Parameters
    ----------
    work : Work
        Runs the fits and trains the policies.
    seeds : int or None
        Number of training seeds; None for that of `size`.
    size : ReturnStudySize
        How large the study is.
    settings : ComparisonSettings
        When a claim is decided, and when two distributions are one.

    Returns
    -------
    Study
        Returns, tests of the thesis' claims and of all pairs, and the distributions.
    """
    count = seeds or size.seeds
    data = AUTHORS if at_hand() else "6.1"
    items = _distribution_items(size, data)
    distributions = work.map(found, items)
    runs = work.map(trained, _training_items(items, distributions, count, size.training))
    returns = by_distribution(runs, "return")
    tables = (
        _returns(runs),
        _verdicts(returns, settings),
        _pairs(returns),
        _distributions(distributions),
    )
    title = (
        f"Figure 6.3: policies trained with a torso {MISSING:.0f} kg too light, {count} "
        "training seeds"
    )
    chosen = "our data set 0, as the authors' data are not at hand"
    if data == AUTHORS:
        chosen = f"the {data}"
    training = size.training
    remarks = (
        f"Fitted: {chosen}, {size.transitions} transitions;"
        f" policies: {training.updates} updates, {training.episodes} episodes of "
        f"{training.steps} steps on the target.",
        *_diagnosed(distributions),
        *_same(distributions, settings),
        *_best(returns),
        *NOTES,
    )
    return Study(
        "figure-6.3",
        title,
        tables,
        remarks,
        {"laws": distributions, "runs": runs},
        lambda figure: _draw(figure, returns),
    )


def _distribution_items(size: ReturnStudySize, data: str) -> list[dict[str, Any]]:
    """What `found` takes for each distribution, and for each of the uniform bounds."""
    fit = {"data": data, "transitions": size.transitions, "droid": size.droid}
    items = []
    for name in size.distributions:
        count = size.bounds if name == UNIFORM else 1
        items += [{"law": name, "number": i, **fit} for i in range(count)]
    return items


def _training_items(
    items: Sequence[dict[str, Any]], distributions: Distributions, seeds: int, training: Training
) -> list[dict[str, Any]]:
    """What `trained` takes for each distribution and seed."""
    out = []
    for seed in range(seeds):
        for item, one in zip(items, distributions, strict=True):
            out.append(
                {
                    "law": item["law"],
                    "number": item["number"],
                    "seed": seed,
                    "family": one["family"],
                    "phi": one["phi"],
                    "effects": one["effects"],
                    "training": asdict(training),
                }
            )
    return out


def by_distribution(runs: Sequence[Run], key: str) -> dict[str, Array]:
    """What the runs of each distribution have under a key.

    Parameters
    ----------
    runs : sequence of dict
        What `light_torso.trained` gives.
    key : str
        Name of a number.

    Returns
    -------
    dict of (bounds, seeds) arrays
        One row for distributions without bounds.
    """
    out = {}
    for name in dict.fromkeys(run["law"] for run in runs):
        own = sorted((run["number"], run["seed"], run[key]) for run in runs if run["law"] == name)
        bounds = {number for number, _, _ in own}
        out[name] = np.array([value for _, _, value in own]).reshape(len(bounds), -1)
    return out


class ReturnDifference(NamedTuple):
    """The difference of two distributions' returns over seeds.

    Attributes
    ----------
    mean : float
        Its mean.
    half : float
        Half its 95 % interval; NaN for a single seed.
    p : float
        Two-sided p-value of a paired t test; NaN for a single seed.
    """

    mean: float
    half: float
    p: float


def difference(one: Array, other: Array) -> ReturnDifference:
    """Compare the returns under two distributions.

    Parameters
    ----------
    one, other : (bounds, seeds) arrays
        Returns, which are averaged over bounds and paired by seeds.

    Returns
    -------
    ReturnDifference
        The mean of `one` less `other` over n seeds, half its 95 % interval and the p-value of
        Student's t with n - 1 degrees of freedom; NaN of a single seed.
    """
    apart = one.mean(axis=0) - other.mean(axis=0)
    degrees = len(apart) - 1
    mean, half = interval(apart)
    if not apart.any():
        return ReturnDifference(0.0, half, 1.0 if degrees > 0 else np.nan)
    if degrees == 0:
        return ReturnDifference(mean, half, np.nan)
    error = half / stats.t.ppf(0.975, degrees)
    p = float(2 * stats.t.sf(abs(mean) / error, degrees)) if error else 0.0
    return ReturnDifference(mean, half, p)


def interval(values: Array) -> tuple[float, float]:
    """Compute the mean of values and half its 95 % interval, by Student's t.

    Parameters
    ----------
    values : (n,) array
        Independent values, of any unit.

    Returns
    -------
    mean, half : float
        In the same unit; half is NaN of a single value.
    """
    n = len(values)
    half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return float(values.mean()), float(half)


def _over(values: Array) -> Array:
    """What an interval is over: the bounds' means if there are several, else the seeds."""
    return values.mean(axis=1) if len(values) > 1 else values[0]


def _returns(runs: Sequence[Run]) -> Table:
    """Returns of each distribution's policies, and of the best and worst bounds."""
    upright = by_distribution(runs, "upright")
    training = by_distribution(runs, "in_training")
    lines = []
    for name, values in by_distribution(runs, "return").items():
        rows = {name: slice(None)}
        if len(values) > 1:
            order = np.argsort(values.mean(axis=1))
            rows["  its best bounds"] = slice(order[-1], order[-1] + 1)
            rows["  its worst bounds"] = slice(order[0], order[0] + 1)
        for label, part in rows.items():
            own = values[part]
            mean, half = interval(_over(own))
            lines.append(
                (
                    label,
                    str(own.size),
                    f"{mean:.0f}",
                    _ends(mean, half),
                    f"{own.min():.0f}",
                    f"{own.max():.0f}",
                    f"{upright[name][part].mean():.0%}",
                    f"{training[name][part].mean():.0f}",
                )
            )
    header = (
        "trained under",
        "policies",
        "return",
        "95 % interval",
        "least",
        "most",
        "not ended early",
        "in training",
    )
    return Table("Returns on the target", header, tuple(lines))


def _verdicts(returns: dict[str, Array], settings: ComparisonSettings) -> Table:
    """Whether each claim is confirmed."""
    lines = []
    for source, claims in (("thesis", CLAIMS), ("ours", OURS)):
        for better, worse in claims:
            if better not in returns or worse not in returns:
                continue
            found = difference(returns[better], returns[worse])
            if not found.p < settings.level:
                said = "not decided"
            else:
                said = "confirmed" if found.mean > 0 else "contradicted"
            ends = _ends(found.mean, found.half)
            p = number(found.p, 2)
            lines.append((source, f"{better} > {worse}", f"{found.mean:+.0f}", ends, p, said))
    header = ("claim", "", "difference", "95 % interval", "p", f"at {settings.level:.0%}")
    return Table("Is the thesis confirmed?", header, tuple(lines))


def _pairs(returns: dict[str, Array]) -> Table:
    """Differences of all pairs, with adjusted p-values."""
    names = list(returns)
    pairs = list(combinations(names, 2))
    found = [difference(returns[one], returns[other]) for one, other in pairs]
    adjusted = holm([one.p for one in found])
    cells = {}
    for pair, one, p in zip(pairs, found, adjusted, strict=True):
        cells[pair] = f"{one.mean:+.0f} ({number(p, 2)})"
    lines = []
    for i, name in enumerate(names):
        lines.append((f"{i + 1} {name}", *(cells.get((name, other), "") for other in names[1:])))
    header = ("", *(f"less {i + 2}" for i in range(len(names) - 1)))
    title = "All pairs: the row's return less the column's, and p by Holm's method"
    return Table(title, header, tuple(lines))


def _distributions(distributions: Distributions) -> Table:
    """Means and standard deviations of the masses, and what they cost."""
    lines = []
    for one in distributions:
        masses = one["mean"]
        if len(masses) < len(MEAN):  # the torso is fixed, and perhaps corrected by an effect
            added = 0.0
            for _, label, magnitudes in one["effects"]:
                if "body_mass:torso" in label:
                    added += magnitudes[0]
            masses = [MEAN[0] - MISSING + added, *masses]
        label = f"{one['law']} {one['number'] + 1}" if one["law"] == UNIFORM else one["law"]
        lines.append(
            (
                label,
                *(f"{mass:.3f}" for mass in masses),
                *(number(value, 2) for value in one["sd"][-3:]),
                f"{one['steps']:,}" if one["steps"] else "-",
            )
        )
    header = (
        "law",
        *(f"mean m{i}" for i in range(1, 5)),
        *(f"sd m{i}" for i in range(2, 5)),
        "simulator steps",
    )
    return Table("The laws [kg]; the torso, m1, is fixed", header, tuple(lines))


def _diagnosed(distributions: Distributions) -> list[str]:
    """What the diagnosis said, if there was one."""
    sentences = []
    for one in distributions:
        if one["law"] == EXTENDED:
            causes = "; ".join(one["causes"]) or "no cause"
            sentences.append(
                f"The diagnosis of the model with the light torso: {one['verdict']}; {causes}."
            )
    return sentences


def _same(distributions: Distributions, settings: ComparisonSettings) -> list[str]:
    """Which fits are the same distribution, so that their policies differ by chance."""
    fits = [one for one in distributions if one["law"] in FITTED]
    same = []
    for one in fits:
        own = [one["mean"], one["sd"]]
        last = [fits[-1]["mean"], fits[-1]["sd"]]
        if np.allclose(own, last, rtol=0, atol=settings.tolerance):
            same.append(one["law"])
    if len(same) < 2:
        return []
    names = ", ".join(same)
    within = f"{settings.tolerance:g} kg"
    return [f"The same law within {within}: {names}. What these differ by is chance."]


def _best(returns: dict[str, Array]) -> list[str]:
    """Whether the extended model's policies return as much as all others' but the truth's."""
    others = {}
    for name, values in returns.items():
        if name not in (TRUTH, EXTENDED):
            others[name] = float(values.mean())
    if EXTENDED not in returns or not others:
        return []
    best = max(others, key=lambda name: others[name])
    found = difference(returns[EXTENDED], returns[best])
    more = "more than" if found.mean > 0 else "not as much as"
    return [
        f"The extended model's policies return {more} those of the best other law but the "
        f"truth, {best}: {found.mean:+.0f}"
        f" ({_ends(found.mean, found.half)}), p = {number(found.p, 2)}."
    ]


def _ends(mean: float, half: float) -> str:
    """The ends of an interval, if it has some."""
    return f"{mean - half:.0f} to {mean + half:.0f}" if np.isfinite(half) else "-"


def _draw(figure: Any, returns: dict[str, Array]) -> None:
    """Each policy's return (for uniform randomization, each bound's), and means with intervals."""
    axes = figure.subplots()
    highest = max(float(_over(values).max()) for values in returns.values())
    for place, values in enumerate(returns.values()):
        each = _over(values)
        mean, half = interval(each)
        bar = half if np.isfinite(half) else 0.0
        axes.plot(np.full(len(each), place), each, "o", markersize=4, alpha=0.6)
        axes.errorbar(place + 0.2, mean, bar, fmt="_", color="black", capsize=3)
    labels = [name.replace(", ", ",\n") for name in returns]
    axes.set_xticks(range(len(returns)), labels, rotation=30, ha="right")
    axes.set(ylabel="return on the target", ylim=(0, 1.05 * highest))
