"""Random effects: the population that recordings are drawn from, each recording's own parameters,
and whether they differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.grouped_likelihood import GroupedLogLikelihood, Groups
from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.maximize import SearchResult
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.fit_parts import GroupEffects, VarianceComponentTests, VarianceTest
from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import number, text_table
from dropo.core.services.validation import Array, known
from dropo.estimators.dropo import DROPO
from dropo.evaluation.variance_components import variance_component_tests

LEVEL = 0.05  # p-values below it count as a difference
# groups below which a spread's relative standard error, 1 / sqrt(2 (G - 1)), is above a quarter
FEW = 10
# of the information of the group that tells most about a parameter: below it a group tells nothing
UNTOLD = 1e-6


@dataclass(frozen=True, kw_only=True)
class RandomEffects(Estimator):
    """Each group (the data's, else each trajectory) has one draw of the parameters from a
    population, which is fitted.

    The likelihood "random-effects" is maximised as DROPO's are. The Fit is the population: sd is
    the spread to train under, mean_se the ignorance of its mean, which more groups would shrink.
    `groups` of the fit holds each group's own parameters given all data, with the ignorance of the
    mean (Henderson 1975, Biometrics 31), not that of the spread; whether the groups differ; and the
    standard deviation of a new group, sqrt(sd^2 + mean_se^2).

    Maximum likelihood takes the mean as known: with G groups its variances are (G - 1) / G of an
    unbiased estimate. family: "truncated_gaussian", whose spreads need 2 groups, however many
    parameters there are, as each is fitted on its own; or "full", whose covariance needs more
    groups than parameters, else it is singular. epsilon, start, start_noise: as DROPO's.
    """

    family: Literal["truncated_gaussian", "full"] = "truncated_gaussian"
    epsilon: float | tuple[float, ...] | Literal["learn", "tune"] | None = None
    start: Literal["least-squares", "middle", "random"] = "middle"
    start_noise: bool | None = None
    name = "random-effects"

    def __post_init__(self) -> None:
        known("family of random effects", self.family, ("truncated_gaussian", "full"))
        self._recipe()

    def _recipe(self) -> "_Population":
        settings: Any = {
            "epsilon": self.epsilon,
            "start": self.start,
            "start_noise": self.start_noise,
        }
        return _Population(likelihood="random-effects", family=self.family, **settings)

    def _fit(self, problem: Problem, run: Run) -> Fit:
        count = len(np.unique(problem.segments.group))
        d = len(problem.space)
        _enough(count, d, self.family)
        return self._recipe()._fit(problem, run)


def _enough(count: int, d: int, family: str) -> None:
    if count == 1:
        raise Incompatible(
            "All data are one group, and one group cannot tell a spread. Use method "
            "'dropo', or name the groups of rows that share"
            " one draw of the parameters ('group' in the data)."
        )
    if family == "full" and count <= d:
        raise Incompatible(
            f"{count} groups cannot tell a covariance of {d} parameters: with fewer than "
            f"{d + 1} it is singular."
            " Use family 'truncated_gaussian', whose spreads are independent, or bring more groups."
        )


@dataclass(frozen=True)
class _Population(DROPO):
    """DROPO's fit with the groups beside it."""

    name = "random-effects"

    def _summarise(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        objective: LogLikelihood,
        found: SearchResult,
        **further: Any,
    ) -> Fit:
        """The population's fit, with each group's own parameters and whether the groups differ."""
        assert isinstance(objective, GroupedLogLikelihood)
        fit = super()._summarise(problem, run, family, objective, found, **further)
        groups = objective.groups(found.point)
        information = objective.value_score_information(found.point)[2]
        d = len(fit.mean)
        spread = fit.correlation * np.outer(fit.sd, fit.sd)
        kept, covariance = _posterior(groups, spread, information[:d, :d])
        names = problem.space.names
        tests = variance_component_tests(objective, names, found.point, run.rng)
        effects = _effects(problem, fit, groups, kept, covariance, tests)
        message = f"{fit.message} {_sentence(tests)}\n{_table(fit, effects)}"
        warnings = (*fit.warnings, *_doubts(groups, fit))
        return replace(fit, groups=effects, warnings=warnings, message=message)


def _posterior(groups: Groups, spread: Array, information: Array) -> tuple[Array, Array]:
    """How much of the mean each group's parameters keep, W = (I + S G)^-1 (G, d, d), and their
    covariance (G, d, d).

    (S^-1 + G)^-1 if the mean were known, and W V W' for V, the covariance of its estimate; NaN
    where no group tells a mean.
    """
    kept = np.asarray(np.linalg.inv(np.eye(len(spread)) + spread @ groups.precision), dtype=float)
    of_mean = np.full_like(spread, np.nan)
    told = np.diagonal(information) > 0
    of_mean[np.ix_(told, told)] = np.linalg.pinv(information[np.ix_(told, told)], hermitian=True)
    covariance: Array = kept @ (spread + of_mean @ kept.swapaxes(1, 2))
    return kept, covariance


def _effects(
    problem: Problem,
    fit: Fit,
    groups: Groups,
    kept: Array,
    covariance: Array,
    tests: VarianceComponentTests,
) -> GroupEffects:
    """The groups' part of the fit."""
    sd = np.median(np.sqrt(np.einsum("gdd->gd", covariance)), axis=0)
    named = problem.segments.trajectories.group is not None
    names = problem.space.names
    return GroupEffects(
        kind="groups" if named else "trajectories",
        fewest_rows=int(groups.rows.min()),
        most_rows=int(groups.rows.max()),
        shrinkage=_by_name(names, np.einsum("gdd->gd", kept).mean(axis=0)),
        median_sd=_by_name(names, sd),
        predictive_sd=_by_name(names, np.hypot(fit.sd, fit.mean_se)),
        tests=tests,
        number=groups.label.astype(float),
        mean=groups.mean,
        covariance=covariance,
    )


def _by_name(names: Sequence[str], values: Array) -> dict[str, float]:
    """The values (d,) by parameter."""
    return dict(zip(names, values.tolist(), strict=True))


def _doubts(groups: Groups, fit: Fit) -> list[str]:
    """What so few groups, or groups that say so little, cannot tell."""
    count = len(groups)
    d = len(fit.mean)
    out = []
    if count < FEW:
        error = 100 / np.sqrt(2 * (count - 1))
        out.append(
            f"every spread rests on {count} groups: its relative standard error is at "
            f"least {error:.0f} %, whatever their rows"
        )
    if count <= d:
        out.append(
            f"{count} groups cannot show whether the {d} parameters vary together: their "
            "spreads are fitted as independent"
        )
    own = np.einsum("gdd->gd", groups.precision)
    tells = own > UNTOLD * own.max(axis=0)
    for i, name in enumerate(fit.space.names):
        silent = groups.label[~tells[:, i]]
        if tells[:, i].sum() < 2:
            out.append(
                f"{int(tells[:, i].sum())} of {count} groups tell anything about {name}: "
                "its spread rests on nothing"
            )
        elif len(silent):
            shown = ", ".join(map(str, silent[:5])) + (", ..." if len(silent) > 5 else "")
            out.append(
                f"{len(silent)} of {count} groups tell nothing about {name}, and get the "
                f"population's ({shown})"
            )
    return out


def _sentence(tests: VarianceComponentTests) -> str:
    """What the tests say."""
    overall = _p(tests.overall)
    if tests.overall.p_value >= LEVEL:
        return f"No difference between recordings is found ({overall})."
    parameters = tests.parameters.items()
    differ = [f"{name} ({_p(test)})" for name, test in parameters if test.p_value < LEVEL]
    same = [f"{name} ({_p(test)})" for name, test in parameters if test.p_value >= LEVEL]
    if not differ:
        return f"Recordings differ ({overall}), in which parameter the data do not tell."
    return f"Recordings differ in {', '.join(differ)}" + (
        f"; no difference is found in {', '.join(same)}." if same else "."
    )


def _p(test: VarianceTest) -> str:
    """The p-value in words."""
    return f"p = {test.p_value:.1g}" if test.p_value > 0 else "p < 1e-300"


def _table(fit: Fit, groups: GroupEffects) -> str:
    """The spread to train under beside what is not known."""
    header = [
        "",
        "spread to train under",
        "ignorance of the mean",
        "ignorance of a group",
        "a new group",
        "shrinkage",
    ]
    rows = []
    for i, name in enumerate(fit.space.names):
        values = [
            fit.sd[i],
            fit.mean_se[i],
            groups.median_sd[name],
            groups.predictive_sd[name],
            groups.shrinkage[name],
        ]
        rows.append([name, *(number(float(value), 4) for value in values)])
    sizes = f"{groups.fewest_rows}"
    if groups.fewest_rows < groups.most_rows:
        sizes += f" to {groups.most_rows}"
    return f"{len(groups)} {groups.kind} of {sizes} rows, standard deviations:\n{text_table(header, rows)}"
