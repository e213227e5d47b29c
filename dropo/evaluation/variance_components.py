"""Whether groups differ at all: likelihood-ratio tests of variances of 0, which lie on the boundary
of what they may be.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.numerics.tails import chi2_tail
from dropo.core.records.fits.fit_parts import VarianceComponentTests, VarianceTest
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.evaluation.held_unknowns import HeldUnknowns


@dataclass(frozen=True)
class VarianceTestSettings:
    """How likelihood-ratio tests on the boundary are made.

    Attributes
    ----------
    draws : int
        Draws of the distribution on the boundary; with 4000 its weights are right to 0.008.
    no_information : float
        Share of the largest root of an information, below which a variance has none.
    small : float
        Standard deviation, as a share of the mean's standard error, at which the information of
        variances is that at 0.
    """

    draws: int = 4000
    no_information: float = 1e-6
    small: float = 1e-3


SETTINGS = VarianceTestSettings()


def variance_component_tests(
    objective: LocalLogLikelihood,
    names: tuple[str, ...],
    phi: Array,
    rng: np.random.Generator,
    settings: VarianceTestSettings = SETTINGS,
) -> VarianceComponentTests:
    """Test whether parameters differ between groups, by restricted likelihood ratios.

    Overall, all standard deviations without correlations are tested against none, by the
    chi-bar-square distribution of variances that cannot be negative [1]_. For each parameter, its
    standard deviation with its q correlations is tested against none, by an even mixture of
    chi-square with q and q + 1 degrees of freedom [2]_; where others are 0 too, that is
    conservative. Both hold for many groups; with few, p-values are too large rather than too small.

    Parameters
    ----------
    objective : LocalLogLikelihood
        Its unknowns are means, scales, "partial." correlations, and noise.
    names : tuple of str
        The parameters.
    phi : (m,) array
        A maximum of the objective.
    rng : numpy.random.Generator
        Draws the weights of the chi-bar-square distribution.
    settings : VarianceTestSettings
        Draws and tolerances.

    Returns
    -------
    VarianceComponentTests
        Overall, and of each parameter.

    References
    ----------
    .. [1] Self and Liang, J. Am. Stat. Assoc. 82, 1987.
    .. [2] Stram and Lee, Biometrics 50, 1994.
    """
    scales = {f"scale.{name}": 0.0 for name in names}
    partials = {u: 0.0 for u in objective.unknowns.names if u.startswith("partial.")}
    independent = HeldUnknowns(objective, partials)
    none = HeldUnknowns(objective, scales | partials)
    nowhere = none.maximum(phi)
    information = _information_at_none(objective, none.whole(nowhere), settings.small)
    weights = boundary_weights(information, rng, settings)
    independent_value = restricted(independent, independent.maximum(phi))
    overall = _test(independent_value - restricted(none, nowhere), weights)
    whole = HeldUnknowns(objective, {})
    best = restricted(whole, whole.maximum(phi))
    parameters = {}
    for name in names:
        own = _correlations_of(name, names, partials)
        without = HeldUnknowns(objective, {f"scale.{name}": 0.0} | own)
        mixture = np.eye(len(own) + 2)[-2:].mean(axis=0)
        gain = best - restricted(without, without.maximum(phi))
        parameters[name] = _test(gain, mixture)
    return VarianceComponentTests(overall, parameters)


def _correlations_of(
    name: str, names: tuple[str, ...], partials: dict[str, float]
) -> dict[str, float]:
    """The unknowns that are correlations of one parameter with another, each 0."""
    found = {}
    for other in names:
        for unknown in (f"partial.{name}.{other}", f"partial.{other}.{name}"):
            if unknown in partials:
                found[unknown] = 0.0
    return found


def restricted(objective: LocalLogLikelihood, phi: Array) -> float:
    """Return the log-likelihood with the means integrated out, up to a constant.

    So variances are not tested beside a mean that was fitted to the same groups [1]_.

    Parameters
    ----------
    objective : LocalLogLikelihood
        A local likelihood.
    phi : (m,) array
        Where.

    Returns
    -------
    float
        [nats].

    References
    ----------
    .. [1] Harville, J. Am. Stat. Assoc. 72, 1977.
    """
    value, _, information = objective.value_score_information(phi)
    mean = _places(objective, "mean.")
    information = information[np.ix_(mean, mean)]
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information / np.outer(size, size) + 1e-12 * np.eye(len(size))
    return value - float(np.log(size).sum() + 0.5 * np.linalg.slogdet(scaled)[1])


def boundary_weights(
    information: Array, rng: np.random.Generator, settings: VarianceTestSettings = SETTINGS
) -> Array:
    """Return how often 0 ... d of d variances are estimated above 0 where all of them truly are 0.

    Gaussian draws are projected onto the cone of variances that are not negative, in the
    information's metric; where that is diagonal, the result is Binomial(d, 1/2).

    Parameters
    ----------
    information : (d, d) array
        Of the variances.
    rng : numpy.random.Generator
        Draws.
    settings : VarianceTestSettings
        How many, and below what a variance has no information.

    Returns
    -------
    numpy.ndarray
        (d + 1,) probabilities.
    """
    size = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    known = size > settings.no_information * size.max()
    if not known.any():
        return np.eye(len(size) + 1)[0]
    scaled = information[np.ix_(known, known)] / np.outer(size[known], size[known])
    root = np.linalg.cholesky(scaled + 1e-9 * np.eye(int(known.sum())))
    draws = rng.standard_normal((settings.draws, len(root)))
    from scipy.optimize import nnls  # slow to import

    positive = [np.count_nonzero(nnls(root.T, draw)[0]) for draw in draws]
    return np.bincount(positive, minlength=len(size) + 1) / settings.draws


def _test(gain: float, weights: Array) -> VarianceTest:
    """Twice the gain, at least 0, and its p-value sum_k weights_k P(chi2_k >= statistic)."""
    statistic = max(0.0, 2 * gain)
    tails = np.append(statistic <= 0, chi2_tail(statistic, np.arange(1, len(weights))))
    return VarianceTest(statistic, min(1.0, float(weights @ tails)))


def _places(objective: LocalLogLikelihood, kinds: str | tuple[str, ...]) -> Ints:
    """Where the unknowns of some kinds stand."""
    names = objective.unknowns.names
    return np.array([i for i, name in enumerate(names) if name.startswith(kinds)], dtype=np.int64)


def _information_at_none(objective: LocalLogLikelihood, phi: Array, small: float) -> Array:
    """The information (d, d) of the variances where all of them are 0, up to a factor for each,
    with noise and means estimated too.
    """
    mean = _places(objective, "mean.")
    scale = _places(objective, "scale.")
    other = _places(objective, ("mean.", "epsilon"))
    phi = phi.copy()
    of_means = np.diagonal(objective.value_score_information(phi)[2])[mean]
    phi[scale] = small / np.sqrt(np.maximum(of_means, 1e-300))
    information = objective.value_score_information(phi)[2]
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    information = information / np.outer(size, size)
    cross = information[np.ix_(scale, other)]
    inverse = np.linalg.pinv(information[np.ix_(other, other)], hermitian=True)
    return information[np.ix_(scale, scale)] - cross @ inverse @ cross.T
