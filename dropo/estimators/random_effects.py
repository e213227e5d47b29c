"""Random effects: the population that recordings are drawn from, and whether they differ."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import GroupedLogLikelihood, Groups, LogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.fit_parts import GroupEffects, VarianceComponentTests, VarianceTest
from dropo.core.records.fits.fit_report import span
from dropo.core.records.start_mean import Start
from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import number, text_table
from dropo.core.services.validation import Array, known
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.clusters import Clusters, find_clusters
from dropo.estimators.support.rough_starts import SEARCH, SearchSettings
from dropo.evaluation.variance_components import variance_component_tests
from dropo.families.mixture import Mixture


@dataclass(frozen=True)
class GroupSettings:
    """What counts as a difference, and as too few data for one.

    Attributes
    ----------
    level : float
        P-values below it count as a difference.
    few : int
        With fewer groups the spreads are warned of: their relative standard error,
        1 / sqrt(2 (G - 1)), is above a quarter.
    uninformative : float
        A group says nothing about a parameter if its information is below this fraction of the
        most informative group's.
    """

    level: float = 0.05
    few: int = 10
    uninformative: float = 1e-6


@dataclass(frozen=True, kw_only=True)
class RandomEffects(Estimator):
    """Fit the population from which each group of recordings has one draw of the parameters.

    Groups are the data's, else each trajectory is one. The likelihood "random-effects" is maximised
    as DROPO's are. The Fit is the population: `sd` is the spread to train under, `mean_se` the
    standard error of its mean, which more groups would shrink. `groups` of the fit holds each
    group's own parameters given all data [1]_, with the uncertainty of the mean, not that of the
    spread; whether the groups differ; and the standard deviation of a new group,
    sqrt(sd^2 + mean_se^2).

    Attributes
    ----------
    family : {"truncated_gaussian", "full", "mixture"}
        "truncated_gaussian": its spreads need 2 groups, however many parameters there are, as each
        is fitted on its own. "full": its covariance needs more groups than parameters, else it is
        singular. "mixture": two clusters, such as two batches of machines, sought once the groups
        are found; the noise is that found with one Gaussian.
    epsilon : float, tuple of float, "learn", "tune" or None
        The noise variance, one or for each signal [signal unit^2], as that of `DROPO`.
    start : {"middle", "least-squares", "random"}, mapping, sequence of float or Fit
        Where the search of the population's mean begins, as that of `DROPO`.
    start_noise : bool or None
        Whether the measured start states carry the noise too; None: as the problem says.
    settings : GroupSettings
        What counts as a difference between groups, and as too few data for one.
    search : SearchSettings
        How the likelihood is searched, as that of `DROPO`.

    Raises
    ------
    UnknownName
        If `family`, or a named `start` or `epsilon`, is none of those that it may be.
    Incompatible
        By `fit`, if the data are one group, or too few groups for a full covariance.

    Notes
    -----
    Maximum likelihood takes the mean as known: with G groups its variances are (G - 1) / G of an
    unbiased estimate.

    References
    ----------
    .. [1] Henderson, "Best linear unbiased estimation and prediction under a selection model",
       Biometrics 31 (1975).
    """

    family: Literal["truncated_gaussian", "full", "mixture"] = "truncated_gaussian"
    epsilon: float | tuple[float, ...] | Literal["learn", "tune"] | None = None
    start: Start = "middle"
    start_noise: bool | None = None
    settings: GroupSettings = field(default_factory=GroupSettings)
    search: SearchSettings = SEARCH
    name = "random-effects"
    uses_priors = True

    def __post_init__(self) -> None:
        known("family of random effects", self.family, ("truncated_gaussian", "full", "mixture"))
        self._make_estimator()

    def _make_estimator(self) -> "_Population":
        """DROPO with these settings."""
        further: Any = {
            "epsilon": self.epsilon,
            "start": self.start,
            "start_noise": self.start_noise,
            "search": self.search,
        }
        clustered = self.family == "mixture"
        return _Population(
            likelihood="random-effects",
            family="truncated_gaussian" if clustered else self.family,
            clustered=clustered,
            settings=self.settings,
            **further,
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """The population's fit, where there are groups enough."""
        count = len(np.unique(problem.segments.group))
        _require_groups(count, len(problem.space), self.family)
        return self._make_estimator()._fit(problem, run)


def _require_groups(count: int, d: int, family: str) -> None:
    """Raise Incompatible if so few groups cannot determine the spread of d parameters."""
    if count == 1:
        raise Incompatible(
            "All data are one group, and one group cannot tell a spread. Use method 'dropo', or"
            " name the groups of rows that share one draw of the parameters ('group' in the data)."
        )
    if family == "mixture" and count < 2 * d + 2:
        raise Incompatible(
            f"{count} groups cannot tell two clusters of {d} parameters: these take {2 * d + 2}."
            " Use family 'truncated_gaussian', or bring more groups."
        )
    if family == "full" and count <= d:
        raise Incompatible(
            f"{count} groups cannot tell a covariance of {d} parameters: with fewer than {d + 1} it"
            " is singular. Use family 'truncated_gaussian', whose spreads are independent, or bring"
            " more groups."
        )


@dataclass(frozen=True, kw_only=True)
class _Population(DROPO):
    """DROPO's fit with the groups beside it.

    Attributes
    ----------
    clustered : bool
        Whether the groups are parted into two clusters.
    settings : GroupSettings
    """

    clustered: bool = False
    settings: GroupSettings = field(default_factory=GroupSettings)
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

        # Each group's own parameters.
        groups = objective.groups(found.point)
        prior = MeanPrior(problem.priors, problem.space)
        d = len(fit.mean)
        information = objective.value_score_information(found.point)[2][:d, :d]
        information += np.diag(prior.information(fit.mean))
        spread = fit.correlation * np.outer(fit.sd, fit.sd)
        kept, covariance = _posterior(groups, spread, information)
        names = problem.space.names
        tests = variance_component_tests(objective, names, found.point, run.rng)
        said = [fit.message, _describe_tests(tests, self.settings)]
        warnings = [*fit.warnings, *_warnings(groups, fit, self.settings)]
        if self.clustered and not (fit.sd > 0).any():
            warnings.append("nothing varies between the groups: there are no clusters")
        elif self.clustered:
            mixture = Mixture(problem.space)
            clusters = find_clusters(groups, mixture, fit.mean, fit.sd)
            fit = _with_clusters(fit, mixture, clusters)
            groups = replace(groups, mean=clusters.mean)
            kept = clusters.kept
            of_mean = np.nan_to_num(clusters.covariance[:d, :d])
            covariance = clusters.spread + kept @ of_mean @ kept.swapaxes(1, 2)
            said.append(_describe_clusters(fit, mixture, clusters))
            warnings += _warnings_of_clusters(clusters)
        effects = _effects(problem, fit, groups, kept, covariance, tests)
        message = f"{' '.join(said)}\n{_table(fit, effects)}"
        return replace(fit, groups=effects, warnings=tuple(warnings), message=message)

    def _family_warnings(self, *arguments: Any) -> list[str]:
        """What groups say against the family; of two clusters nothing is tested."""
        return [] if self.clustered else super()._family_warnings(*arguments)


def _posterior(groups: Groups, spread: Array, information: Array) -> tuple[Array, Array]:
    """How much of the mean each group's parameters keep (G, d, d), and their covariance (G, d, d).

    The first is W = (I + S G)^-1. The second is (S^-1 + G)^-1, as if the mean were known, plus
    W V W' for V, the covariance of its estimate; NaN where no group determines a mean.
    """
    kept = np.asarray(np.linalg.inv(np.eye(len(spread)) + spread @ groups.precision), dtype=float)
    of_mean = np.full_like(spread, np.nan)
    determined = np.diagonal(information) > 0
    block = np.ix_(determined, determined)
    of_mean[block] = np.linalg.pinv(information[block], hermitian=True)
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


def _with_clusters(fit: Fit, family: Mixture, clusters: Clusters) -> Fit:
    """The fit of two clusters in the place of one Gaussian."""
    phi = clusters.phi
    d = len(fit.mean)
    errors = np.sqrt(np.diagonal(clusters.covariance))
    # Of the variances, to first order in scales, weight and gaps.
    size = 1e-6 * np.maximum(np.abs(phi), 1e-9)
    half = np.diag(size)
    change = [family.sd(phi + step) ** 2 - family.sd(phi - step) ** 2 for step in half]
    slopes = np.stack(change) / (2 * size)[:, None]  # (m, d)
    known = np.nan_to_num(clusters.covariance)
    variance_se = np.sqrt(np.einsum("md,mn,nd->d", slopes, known, slopes))
    if fit.variance_se is not None:  # of those that are 0
        variance_se = np.where(np.isfinite(errors[d : 2 * d]), variance_se, fit.variance_se)
    return replace(
        fit,
        family="mixture",
        phi=phi,
        mean=family.mean(phi),
        scale=family.scale(phi),
        sd=family.sd(phi),
        correlation=family.correlation(phi),
        mean_se=np.where(np.isnan(fit.mean_se), np.nan, errors[:d]),
        scale_se=errors[d : 2 * d],
        variance_se=variance_se,
        degrees_of_freedom=clusters.degrees[:d],
        log_likelihood=fit.log_likelihood + clusters.gain,
    )


def _describe_clusters(fit: Fit, family: Mixture, clusters: Clusters) -> str:
    """Say in a sentence where the clusters are, and how many groups belong to each."""
    second = int((clusters.membership > 0.5).sum())
    counts = (len(clusters.membership) - second, second)
    parts = []
    for count, centre in zip(counts, family.centres(clusters.phi), strict=True):
        values = [
            f"{parameter.name} {number(float(value), 3)} {parameter.unit}".rstrip()
            for parameter, value in zip(fit.space, centre, strict=True)
        ]
        parts.append(f"{count} about {', '.join(values)}")
    gain = f"{clusters.gain:.3g} nats likelier than one"
    return f"Two clusters of groups, {gain}: {'; '.join(parts)}."


def _warnings_of_clusters(clusters: Clusters) -> list[str]:
    """That two clusters are no better than one, or that their likelihood has no clear maximum."""
    sentences = []
    if not clusters.sufficient:
        needed = 0.5 * clusters.added * np.log(len(clusters.membership))
        sentences.append(
            f"two clusters gain {clusters.gain:.3g} nats, and {needed:.3g} are needed for their"
            f" {clusters.added} further numbers: take family 'truncated_gaussian'"
        )
    if np.isnan(clusters.covariance).all():
        sentences.append("the likelihood of two clusters has no clear maximum: no standard errors")
    return sentences


def _by_name(names: Sequence[str], values: Array) -> dict[str, float]:
    """The values (d,) by parameter."""
    return dict(zip(names, values.tolist(), strict=True))


def _warnings(groups: Groups, fit: Fit, settings: GroupSettings) -> list[str]:
    """What so few groups, or groups with so little information, cannot determine."""
    count = len(groups)
    d = len(fit.mean)
    sentences = []
    if count < settings.few:
        error = 100 / np.sqrt(2 * (count - 1))
        sentences.append(
            f"every spread rests on {count} groups: its relative standard error is at least"
            f" {error:.0f} %, whatever their rows"
        )
    if count <= d:
        sentences.append(
            f"{count} groups cannot show whether the {d} parameters vary together: their spreads"
            " are fitted as independent"
        )

    # Groups that say nothing about a parameter.
    own = np.einsum("gdd->gd", groups.precision)
    informative = own > settings.uninformative * own.max(axis=0)
    for i, name in enumerate(fit.space.names):
        telling = int(informative[:, i].sum())
        silent = groups.label[~informative[:, i]]
        if telling < 2:
            sentences.append(
                f"{telling} of {count} groups tell anything about {name}: its spread rests on"
                " nothing"
            )
        elif len(silent):
            shown = ", ".join(map(str, silent[:5])) + (", ..." if len(silent) > 5 else "")
            sentences.append(
                f"{len(silent)} of {count} groups tell nothing about {name}, and get the"
                f" population's ({shown})"
            )
    return sentences


def _describe_tests(tests: VarianceComponentTests, settings: GroupSettings) -> str:
    """Say in a sentence which parameters differ between the groups."""
    overall = _describe_p(tests.overall)
    if tests.overall.p_value >= settings.level:
        return f"No difference between recordings is found ({overall})."
    differ: list[str] = []
    same: list[str] = []
    for name, test in tests.parameters.items():
        group = differ if test.p_value < settings.level else same
        group.append(f"{name} ({_describe_p(test)})")
    if not differ:
        return f"Recordings differ ({overall}), in which parameter the data do not tell."
    end = f"; no difference is found in {', '.join(same)}." if same else "."
    return f"Recordings differ in {', '.join(differ)}{end}"


def _describe_p(test: VarianceTest) -> str:
    """The p-value in words."""
    return f"p = {test.p_value:.1g}" if test.p_value > 0 else "p < 1e-300"


def _table(fit: Fit, groups: GroupEffects) -> str:
    """The spread to train under beside the uncertainties."""
    header = [
        "",
        "spread to train under",
        "95 % interval",
        "ignorance of the mean",
        "ignorance of a group",
        "a new group",
        "shrinkage",
    ]
    intervals = fit.sd_interval()
    rows = []
    for i, name in enumerate(fit.space.names):
        values = [
            fit.mean_se[i],
            groups.median_sd[name],
            groups.predictive_sd[name],
            groups.shrinkage[name],
        ]
        cells = [number(float(value), 4) for value in values]
        rows.append([name, number(float(fit.sd[i]), 4), span(*intervals[i]), *cells])
    sizes = f"{groups.fewest_rows}"
    if groups.fewest_rows < groups.most_rows:
        sizes += f" to {groups.most_rows}"
    title = f"{len(groups)} {groups.kind} of {sizes} rows, standard deviations:"
    return f"{title}\n{text_table(header, rows)}"
