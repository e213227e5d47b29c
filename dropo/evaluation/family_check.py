"""Whether a family of distributions has the shape that groups of recordings show.

Groups are tested against independent Gaussians: for skewness, for heavy tails, for two clusters,
and for correlations between parameters. All tests of a fit share one level.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.likelihood import Groups
from dropo.core.numerics.multiple_tests import holm
from dropo.core.numerics.tails import normal_tail
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class FamilyCheckSettings:
    """What is tested, and when it is said.

    Attributes
    ----------
    level : float
        The probability of any sentence on groups that the family does describe.
    fewest : int
        With fewer groups nothing is tested.
    informative : float
        A parameter is tested where groups shrink by less than 1 minus this fraction.
    draws : int
        Samples of a Gaussian, which say how far apart two clusters look by chance.
    smallest_cluster : float
        A cluster has at least this fraction of the groups, and three.
    valley : float
        Between two clusters there are fewer groups than this fraction of those in the same span
        around the middle of either.
    rounds : int
        Rounds of the expectation-maximisation by which a correlation is estimated.
    named : int
        Groups named in a sentence, at most.
    """

    level: float = 0.01
    fewest: int = 10
    informative: float = 0.3
    draws: int = 1000
    smallest_cluster: float = 0.1
    valley: float = 0.5
    rounds: int = 300
    named: int = 5


SETTINGS = FamilyCheckSettings()


@dataclass(frozen=True)
class _Finding:
    """A test's p-value, and what it says if it is small; findings of one topic say one thing."""

    topic: str
    p_value: float
    text: str


@dataclass(frozen=True, eq=False)
class _Sample:
    """The groups' parameters under a Gaussian, in the coordinates of the family.

    Attributes
    ----------
    space : ParameterSpace
        The d tested parameters.
    label : (G,) int array
        The groups' numbers.
    value : (G, d) array
        Their parameters in their own units.
    deviation : (G, d) array
        From the mean, in the family's coordinates.
    precision : (G, d, d) array
        What their own rows say of their parameters there.
    spread : (d, d) array
        The population's covariance there.
    """

    space: ParameterSpace
    label: Ints
    value: Array
    deviation: Array
    precision: Array
    spread: Array


def check_family(
    space: ParameterSpace,
    family: str,
    groups: Groups,
    mean: Array,
    covariance: Array,
    rng: np.random.Generator,
    *,
    logarithmic: bool = False,
    correlated: bool = False,
    settings: FamilyCheckSettings = SETTINGS,
) -> list[str]:
    """Test the shape of a family on the parameters of groups.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    family : str
        The family's name, for the sentences.
    groups : Groups
        Under a Gaussian of these moments.
    mean : (d,) array
    covariance : (d, d) array
        Of the population; diagonal where the family has no correlations.
    rng : numpy.random.Generator
        Draws samples of a Gaussian.
    logarithmic : bool
        Whether the family is Gaussian in logarithms.
    correlated : bool
        Whether it has correlations of its own.
    settings : FamilyCheckSettings

    Returns
    -------
    list of str
        A sentence for each thing that the family does not have, with what to do. The tests are
        corrected for their number (Holm 1979).
    """
    if len(groups) < settings.fewest:
        return []
    sample = _sample(space, groups, mean, covariance, logarithmic, settings)
    if not len(sample.space):
        return []
    z = sample.deviation / np.sqrt(_marginal_variance(sample))
    chance = _separations(np.sort(rng.standard_normal((settings.draws, len(z)))), settings)
    findings = []
    for i in range(len(sample.space)):
        findings += _of_one_parameter(sample, i, z[:, i], chance, family, settings)
    if not correlated:
        findings += _correlations(sample, family, settings)
    return _significant(findings, settings.level)


def _sample(
    space: ParameterSpace,
    groups: Groups,
    mean: Array,
    covariance: Array,
    logarithmic: bool,
    settings: FamilyCheckSettings,
) -> _Sample:
    """The groups as the tests take them, with the parameters that vary and that groups tell."""
    value = groups.mean
    precision = groups.precision
    deviation = value - mean
    if logarithmic:
        factor = value[:, :, None] * value[:, None]  # d value / d logarithm
        precision = precision * factor
        logarithm = np.log(value)
        deviation = logarithm - logarithm.mean(axis=0)
        covariance = np.diag(np.var(logarithm, axis=0))
    own = np.einsum("gdd->gd", precision) * np.diagonal(covariance)
    kept = np.mean(own / (1 + own), axis=0) > settings.informative
    chosen = ParameterSpace(tuple(p for p, keep in zip(space, kept, strict=True) if keep))
    return _Sample(
        chosen,
        groups.label,
        value[:, kept],
        deviation[:, kept],
        precision[:, kept][:, :, kept],
        covariance[kept][:, kept],
    )


def _total_precision(sample: _Sample) -> Array:
    """M = (S + G^-1)^-1 (G, d, d), the precision of what each group's rows give alone."""
    eye = np.eye(len(sample.spread))
    return np.asarray(np.linalg.solve(eye + sample.precision @ sample.spread, sample.precision))


def _marginal_variance(sample: _Sample) -> Array:
    """Variance (G, d) of the groups' deviations, which are shrunk: the diagonal of S M S."""
    shrunk = sample.spread @ _total_precision(sample) @ sample.spread
    return np.asarray(np.maximum(np.einsum("gdd->gd", shrunk), np.finfo(float).tiny))


# --- the shape of one parameter


def _of_one_parameter(
    sample: _Sample,
    place: int,
    z: Array,
    chance: Array,
    family: str,
    settings: FamilyCheckSettings,
) -> list[_Finding]:
    """Tests of two clusters, skewness and heavy tails; chance (K,): separations of Gaussians.

    The first that speaks is said. Separations are maxima over cuts: they are taken for Gumbel's.
    """
    from scipy import stats  # slow to import

    name = sample.space.names[place]
    unit = f" {sample.space[name].unit}".rstrip()
    count = len(z)
    findings = []

    order = np.argsort(z)
    separation = _separations(z[order][None], settings)[0]
    cut = _best_cut(z[order], settings)
    low, high = z[order[:cut]], z[order[cut:]]
    if _has_valley(low, high, settings):
        scale = chance.std() * np.sqrt(6) / np.pi
        mode = chance.mean() - np.euler_gamma * scale
        p_value = float(stats.gumbel_r.sf(separation, mode, scale))
        below, above = (np.median(sample.value[own, place]) for own in (order[:cut], order[cut:]))
        text = (
            f"the groups' {name} falls into two clusters, {cut} groups about {below:.3g} and"
            f" {count - cut} about {above:.3g}{unit}, and {family} has one peak: try --method"
            " random-effects --family mixture"
        )
        findings.append(_Finding(name, p_value, text))

    skewness = float(stats.skew(z))
    shape = "is skewed otherwise" if family == "log_normal" else "is symmetric"
    text = f"the groups' {name} is skewed ({skewness:+.1f}), and {family} {shape}"
    advice = _advice_on_skewness(sample, place, skewness, family)
    findings.append(_Finding(name, float(stats.skewtest(z).pvalue), f"{text}: {advice}"))

    tails = stats.kurtosistest(z, alternative="greater") if count >= 20 else None
    if tails is not None:
        far = np.argsort(-np.abs(z))[: settings.named]
        far = far[np.abs(z[far]) > 3]
        names = ", ".join(map(str, sample.label[far]))
        text = (
            f"the groups' {name} has heavier tails than {family} (groups {names} lie up to"
            f" {np.abs(z).max():.1f} sds off): look at these groups"
        )
        if len(far):
            findings.append(_Finding(name, float(tails.pvalue), text))
    return findings


def _advice_on_skewness(sample: _Sample, place: int, skewness: float, family: str) -> str:
    """What to do about skewness: logarithms where they take it away, or half of it."""
    value = sample.value[:, place]
    positive = list(sample.space)[place].low > 0 and bool((value > 0).all())
    if family == "log_normal" or skewness < 0 or not positive:
        return "no family here is skewed so, draw from the groups themselves"
    from scipy.stats import skew  # slow to import

    left = float(skew(np.log(value)))
    advice = "try --method dropo --family log_normal"
    return (
        advice if left < 0.5 * skewness else f"{advice}, though logarithms are skewed ({left:+.1f})"
    )


def _separations(sorted_values: Array, settings: FamilyCheckSettings) -> Array:
    """Difference of two clusters' means in pooled sds (K,), at the best cut of (K, n) values."""
    found: Array = _separation_by_cut(sorted_values, settings).max(axis=1)
    return found


def _best_cut(values: Array, settings: FamilyCheckSettings) -> int:
    """How many of the sorted values (n,) are in the lower cluster."""
    by_cut = _separation_by_cut(values[None], settings)[0]
    return _smallest_cluster(len(values), settings) + int(by_cut.argmax())


def _separation_by_cut(values: Array, settings: FamilyCheckSettings) -> Array:
    """The separation at every cut that leaves clusters large enough; (K, n) sorted values."""
    n = values.shape[1]
    least = _smallest_cluster(n, settings)
    below = np.arange(least, n - least + 1)
    sums = np.cumsum(values, axis=1)
    first = sums[:, below - 1] / below
    second = (sums[:, -1:] - sums[:, below - 1]) / (n - below)
    gap = second - first
    within = np.var(values, axis=1)[:, None] * n - gap**2 * below * (n - below) / n
    return np.asarray(gap / np.sqrt(np.maximum(within, np.finfo(float).tiny) / (n - 2)))


def _smallest_cluster(count: int, settings: FamilyCheckSettings) -> int:
    """The fewest groups in a cluster."""
    return max(3, int(np.ceil(settings.smallest_cluster * count)))


def _has_valley(low: Array, high: Array, settings: FamilyCheckSettings) -> bool:
    """Whether fewer values are half way between two clusters than about the middle of either."""
    values = np.concatenate([low, high])
    ends = np.array([np.median(low), np.median(high)])
    centres = np.array([ends[0], ends.mean(), ends[1]])
    half = (ends[1] - ends[0]) / 6
    first, between, second = (int(np.sum(np.abs(values - c) <= half)) for c in centres)
    return between < settings.valley * min(first, second)


# --- correlations


def _correlations(sample: _Sample, family: str, settings: FamilyCheckSettings) -> list[_Finding]:
    """Score tests of each pair's covariance, with the variances estimated too."""
    total = _total_precision(sample)
    d = len(sample.spread)
    variance = np.diagonal(sample.spread)
    q = sample.deviation / variance  # what the rows say: M (xi_hat - mean)
    # Scores and information of the entries of S: the variances, then a covariance.
    covariance_scores = np.einsum("gd,ge->de", q, q) - total.sum(axis=0)
    of_variances = 0.5 * np.einsum("gde,gde->de", total, total)
    inverse = np.linalg.pinv(of_variances, hermitian=True)
    variance_scores = 0.5 * np.diagonal(covariance_scores)
    findings: list[_Finding] = []
    estimate: Array | None = None
    for i in range(d):
        for j in range(i + 1, d):
            cross = np.einsum("gd,gd->d", total[:, :, i], total[:, :, j])
            own = np.sum(total[:, i, i] * total[:, j, j] + total[:, i, j] ** 2)
            information = float(own - cross @ inverse @ cross)
            score = float(covariance_scores[i, j] - cross @ inverse @ variance_scores)
            if information <= 0:
                continue
            z = score / np.sqrt(information)
            p_value = 2 * float(normal_tail(abs(z)))
            if p_value > settings.level:  # it can say nothing, and counts as a test alone
                findings.append(_Finding("", p_value, ""))
                continue
            if estimate is None:
                estimate = _covariance(sample, settings.rounds)
            root = np.sqrt(estimate[i, i] * estimate[j, j])
            r = float(np.clip(estimate[i, j] / root, -1, 1))
            known = information * variance[i] * variance[j]  # as of so many groups
            first, second = sample.space.names[i], sample.space.names[j]
            text = (
                f"{first} and {second} are correlated between groups"
                f" ({r:+.2f} +- {(1 - r**2) / np.sqrt(known):.2f}), and {family} has no"
                " correlations: try --family full"
            )
            findings.append(_Finding(f"{first} {second}", p_value, text))
    return findings


def _covariance(sample: _Sample, rounds: int) -> Array:
    """The population's covariance (d, d) with correlations, by expectation-maximisation."""
    spread = sample.spread
    eye = np.eye(len(spread))
    weighted = np.einsum("gde,ge->gd", sample.precision, sample.deviation)
    weighted = weighted + sample.deviation / np.diagonal(spread)  # G (xi_hat - mean)
    shift = np.zeros(len(spread))
    for _ in range(rounds):
        posterior = np.linalg.solve(eye + spread @ sample.precision, spread)
        away = np.einsum("gde,ge->gd", posterior, weighted - sample.precision @ shift)
        shift = shift + away.mean(axis=0)
        away = away - away.mean(axis=0)
        spread = np.einsum("gd,ge->de", away, away) / len(away) + posterior.mean(axis=0)
    return np.asarray(spread)


# --- many tests


def _significant(findings: list[_Finding], level: float) -> list[str]:
    """What is said at a level of all tests together (Holm 1979); the first of each topic."""
    said: dict[str, str] = {}
    p_values = holm([finding.p_value for finding in findings])
    for finding, p_value in zip(findings, p_values, strict=True):
        if p_value <= level and finding.topic:
            said.setdefault(finding.topic, finding.text)
    return list(said.values())
