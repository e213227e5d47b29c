"""Figure 6.3: what policies are worth on the target that were trained with a torso 1 kg too light."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

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

Under the thesis' own laws, and under our fits of its data.
"""
OURS = (
    (EXTENDED, "thesis, dropo"),
    (EXTENDED, PUBLISHED),
    (EXTENDED, TUNED),
    (EXTENDED, "droid"),
    (EXTENDED, UNIFORM),
    (EXTENDED, AS_IT_IS),
)
# of tests; [kg] of means and sds within which two laws are one
LEVEL = 0.05
SAME = 0.002
NOTES = (
    "A policy's return is its mean over episodes on the target. Intervals (95 %, Student's "
    "t) are over training seeds; those of uniform"
    " randomization over its bounds, each the mean of its seeds. The thesis trains one "
    "policy for each of its bounds.",
    "Tests are paired by the training seed, which decides the directions of the search; "
    "uniform randomization enters with the mean of its"
    " bounds, which are taken as they are.",
    "The thesis shows figure 6.3 as a picture without numbers: the truth above DROPO, "
    "DROPO above DROID and above the average of uniform"
    " randomization, of which some bounds do well. Its laws are those that it prints in table 6.4.",
    (
        "Policies here are linear and found by augmented random search without the bonus for "
        "being alive; the thesis trains networks by SAC."
    ),
    (
        "Other masses true: the model as it was before any fit, the torso too light and the "
        "other masses right."
    ),
)


@dataclass(frozen=True)
class Size:
    """How large the study is: transitions fitted, DROID's evaluations, uniform bounds, training
    seeds, laws, a policy's training.
    """

    transitions: int = 1000
    droid: int = 1000
    bounds: int = 10
    seeds: int = 5
    distributions: tuple[str, ...] = LAWS
    training: Training = field(default_factory=Training)


FULL = Size()


def figure_6_3(work: Work, seeds: int | None = None, *, size: Size = FULL) -> Study:
    """A torso 1 kg too light: policies under DROPO, DROID, uniform bounds, the extended model and
    the truth, on the target (figure 6.3).
    """
    count = seeds or size.seeds
    data = AUTHORS if at_hand() else "6.1"
    asked = [
        (name, i)
        for name in size.distributions
        for i in range(size.bounds if name == UNIFORM else 1)
    ]
    fit = {"data": data, "transitions": size.transitions, "droid": size.droid}
    distributions = work.map(found, [{"law": name, "number": i, **fit} for name, i in asked])
    made = [
        {
            "law": name,
            "number": i,
            "seed": seed,
            **{key: one[key] for key in ("family", "phi", "effects")},
            "training": asdict(size.training),
        }
        for seed in range(count)
        for (name, i), one in zip(asked, distributions, strict=True)
    ]
    runs = work.map(trained, made)
    returns = by_distribution(runs, "return")
    tables = (_returns(runs), _verdicts(returns), _pairs(returns), _distributions(distributions))
    training = size.training
    title = (
        f"Figure 6.3: policies trained with a torso {MISSING:.0f} kg too light, {count} "
        "training seeds"
    )
    chosen = (
        f"the {data}" if data == AUTHORS else "our data set 0, as the authors' data are not at hand"
    )
    remarks = (
        f"Fitted: {chosen}, {size.transitions} transitions;"
        f" policies: {training.updates} updates, {training.episodes} episodes of "
        f"{training.steps} steps on the target.",
        *_diagnosed(distributions),
        *_same(distributions),
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


def by_distribution(runs: Sequence[dict[str, Any]], key: str) -> dict[str, Array]:
    """Law -> what its runs have under that key, (bounds, seeds); one row where there are no bounds."""
    out = {}
    for name in dict.fromkeys(run["law"] for run in runs):
        own = sorted((run["number"], run["seed"], run[key]) for run in runs if run["law"] == name)
        out[name] = np.array([value for *_, value in own]).reshape(len({i for i, *_ in own}), -1)
    return out


class Difference(NamedTuple):
    """Of two laws' returns over seeds: its mean, half its 95 % interval, and the two-sided p of a
    paired t test; NaN of a single seed.
    """

    mean: float
    half: float
    p: float


def difference(one: Array, other: Array) -> Difference:
    """The first less the second, (bounds, seeds) each; bounds are averaged."""
    apart = one.mean(axis=0) - other.mean(axis=0)
    mean, half = interval(apart)
    if not apart.any():
        return Difference(0.0, half, 1.0 if len(apart) > 1 else np.nan)
    error = half / stats.t.ppf(0.975, len(apart) - 1) if len(apart) > 1 else np.nan
    return Difference(
        mean, half, float(2 * stats.t.sf(abs(mean) / error, len(apart) - 1)) if error else 0.0
    )


def interval(values: Array) -> tuple[float, float]:
    """The mean and half its 95 % interval by Student's t; NaN of a single value."""
    n = len(values)
    half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    return float(values.mean()), float(half)


def holm(p: Array) -> Array:
    """P values (m,) adjusted for so many tests (Holm, "A simple sequentially rejective multiple
    test procedure", 1979).
    """
    order = np.argsort(p)
    out = np.empty(len(p))
    out[order] = np.minimum(1, np.maximum.accumulate(np.sort(p) * np.arange(len(p), 0, -1)))
    return out


def _spread(values: Array) -> Array:
    """What an interval is over: the bounds' means where there are several, else the seeds."""
    return values.mean(axis=1) if len(values) > 1 else values[0]


def _returns(runs: Sequence[dict[str, Any]]) -> Table:
    upright = by_distribution(runs, "upright")
    training = by_distribution(runs, "in_training")
    lines = []
    for name, values in by_distribution(runs, "return").items():
        rows = {name: slice(None)}
        if len(values) > 1:
            order = np.argsort(values.mean(axis=1))
            rows |= {
                "  its best bounds": slice(order[-1], order[-1] + 1),
                "  its worst bounds": slice(order[0], order[0] + 1),
            }
        for label, part in rows.items():
            own = values[part]
            mean, half = interval(_spread(own))
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


def _verdicts(returns: dict[str, Array]) -> Table:
    lines = []
    for told, claims in (("thesis", CLAIMS), ("ours", OURS)):
        for better, worse in claims:
            if better in returns and worse in returns:
                found = difference(returns[better], returns[worse])
                said = (
                    "not decided"
                    if not found.p < LEVEL
                    else "confirmed"
                    if found.mean > 0
                    else "contradicted"
                )
                lines.append(
                    (
                        told,
                        f"{better} > {worse}",
                        f"{found.mean:+.0f}",
                        _ends(found.mean, found.half),
                        number(found.p, 2),
                        said,
                    )
                )
    header = ("claim", "", "difference", "95 % interval", "p", f"at {LEVEL:.0%}")
    return Table("Is the thesis confirmed?", header, tuple(lines))


def _pairs(returns: dict[str, Array]) -> Table:
    names = list(returns)
    pairs = list(combinations(names, 2))
    found = [difference(returns[one], returns[other]) for one, other in pairs]
    adjusted = holm(np.array([one.p for one in found]))
    cells = {
        pair: f"{one.mean:+.0f} ({number(p, 2)})"
        for pair, one, p in zip(pairs, found, adjusted, strict=True)
    }
    lines = [
        (f"{i + 1} {name}", *(cells.get((name, other), "") for other in names[1:]))
        for i, name in enumerate(names[:-1])
    ]
    header = ("", *(f"less {i + 2}" for i in range(len(names) - 1)))
    last = (f"{len(names)} {names[-1]}", *[""] * (len(names) - 1))
    return Table(
        "All pairs: the row's return less the column's, and p by Holm's method",
        header,
        (*lines, last),
    )


def _distributions(distributions: Sequence[dict[str, Any]]) -> Table:
    lines = []
    for one in distributions:
        mean = one["mean"]
        sd = one["sd"]
        added = sum(sizes[0] for _, label, sizes in one["effects"] if "body_mass:torso" in label)
        light = len(mean) < len(MEAN)
        masses = [MEAN[0] - MISSING + added, *mean] if light else mean
        label = f"{one['law']} {one['number'] + 1}" if one["law"] == UNIFORM else one["law"]
        cost = f"{one['steps']:,}" if one["steps"] else "-"
        lines.append(
            (
                label,
                *(f"{mass:.3f}" for mass in masses),
                *(number(value, 2) for value in sd[-3:]),
                cost,
            )
        )
    header = (
        "law",
        *(f"mean m{i}" for i in range(1, 5)),
        *(f"sd m{i}" for i in range(2, 5)),
        "simulator steps",
    )
    return Table("The laws [kg]; the torso, m1, is fixed", header, tuple(lines))


def _diagnosed(distributions: Sequence[dict[str, Any]]) -> list[str]:
    told = [one for one in distributions if one["law"] == EXTENDED]
    return [
        (
            f"The diagnosis of the model with the light torso: {one['verdict']}; "
            f"{'; '.join(one['causes']) or 'no cause'}."
        )
        for one in told
    ]


def _same(distributions: Sequence[dict[str, Any]]) -> list[str]:
    """Which fits are one law; what their policies differ by is chance."""
    fits = [one for one in distributions if one["law"] in FITTED]
    alike = [
        one["law"]
        for one in fits
        if np.allclose(
            [one["mean"], one["sd"]], [fits[-1]["mean"], fits[-1]["sd"]], rtol=0, atol=SAME
        )
    ]
    return (
        [f"The same law within {SAME:g} kg: {', '.join(alike)}. What these differ by is chance."]
        if len(alike) > 1
        else []
    )


def _best(returns: dict[str, Array]) -> list[str]:
    """Whether the extended model's policies return at least as much as any other's but the truth's."""
    others = {
        name: float(values.mean())
        for name, values in returns.items()
        if name not in (TRUTH, EXTENDED)
    }
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
    return f"{mean - half:.0f} to {mean + half:.0f}" if np.isfinite(half) else "-"


def _draw(figure: Any, returns: dict[str, Array]) -> None:
    """Each policy's return (of uniform randomization each of its bounds'), and means with their
    intervals.
    """
    axes = figure.subplots()
    highest = max(float(_spread(values).max()) for values in returns.values())
    for place, values in enumerate(returns.values()):
        each = _spread(values)
        mean, half = interval(each)
        axes.plot(np.full(len(each), place), each, "o", markersize=4, alpha=0.6)
        axes.errorbar(
            place + 0.2, mean, half if np.isfinite(half) else 0.0, fmt="_", color="black", capsize=3
        )
    axes.set_xticks(
        range(len(returns)),
        [name.replace(", ", ",\n") for name in returns],
        rotation=30,
        ha="right",
    )
    axes.set(ylabel="return on the target", ylim=(0, 1.05 * highest))
