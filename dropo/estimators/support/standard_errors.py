"""Standard errors of a distribution's means and scales, clustered by independent units of data."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.mean_prior import MeanPrior, mean_places
from dropo.core.numerics.dependence import Units, independent, unit_sums, variance_by_residuals
from dropo.core.numerics.kept_rows import MEMORY, KeptRows, MemorySettings, keep_rows, row_blocks
from dropo.core.numerics.linear_gaussian import information_of_units, scores_and_information
from dropo.core.numerics.robust_covariance import SINGULAR, inverse_information, sandwich
from dropo.core.numerics.shared_draws import pairs_of, score_covariances
from dropo.core.records.fits.fit import variance_errors
from dropo.core.records.independent_units import units_of
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class JacobianStepSettings:
    """The steps of differences, as fractions of a parameter's search interval.

    Attributes
    ----------
    least : float
        Smallest half width of the simulator's differences: a contact that switches inside a step
        gives slopes without bound as differences shrink.
    largest : float
        Largest half width of the simulator's differences.
    local : float
        Half width of a local model's differences, which is smooth.
    edge : float
        An unknown that is nearer than this to its bound is on it.
    small : float
        A scale of so many standard errors of its mean changes no prediction that can be told.
    """

    least: float = 1e-3
    largest: float = 1e-2
    local: float = 1e-6
    edge: float = 1e-6
    small: float = 0.1


DIFFERENCES = JacobianStepSettings()


@dataclass(frozen=True)
class ShareSettings:
    """When it matters which unit of data has how much of the information.

    Attributes
    ----------
    most : int
        Of more units than this none has so much that the residuals follow it.
    """

    most: int = 1000


@dataclass(frozen=True)
class SharedDrawSettings:
    """When scores of a spread are taken for those of units that share a draw.

    Attributes
    ----------
    most : int
        With more parameters that vary it is left to the residuals alone: numbers grow as d^4.
    """

    most: int = 16


SHARED_DRAWS = SharedDrawSettings()
SHARES = ShareSettings()


@dataclass(frozen=True)
class OfPrior:
    """What priors are to an estimate.

    Attributes
    ----------
    fraction : (d,) array
        How much of the information on each mean (the inverse of its variance, all else unknown) is
        there by the priors alone: 0 to 1, NaN for a mean on its bound.
    pull : (d,) array
        How many standard deviations data and prior are apart, each with its own uncertainty; NaN
        where there is no prior with a curvature.
    """

    fraction: Array
    pull: Array


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors, and the sensitivities that they rest on.

    Attributes
    ----------
    mean, scale : (d,) array
        Of the means and of the scales, in the parameters' units. NaN where the data say nothing,
        for a mean on its bound, and for a scale of about 0.
    degrees : (d,) array
        The degrees of freedom of the means' errors.
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions by the parameters.
    variance : (d,) array or None
        Of the variances, also of those that are 0; None where only the scales' are known.
    correlation : (d, d) array or None
        Of the correlations, NaN where one is on its bound; None of a family without, or where the
        likelihood has no scores of its own.
    prior : OfPrior or None
        What the priors are to the means, where there are some.
    by_likelihood : (d,) array or None
        Of the means by the curvature of the likelihood alone, as if it were right: not by how
        scores scatter. None where an objective has scores of its own.
    """

    mean: Array
    scale: Array
    degrees: Array
    jacobian: KeptRows
    variance: Array | None = None
    correlation: Array | None = None
    prior: OfPrior | None = None
    by_likelihood: Array | None = None


def standard_errors(
    problem: Problem,
    mean: Array,
    sd: Array,
    correlation: Array,
    noise: Array,
    settings: JacobianStepSettings = DIFFERENCES,
    prior: MeanPrior | None = None,
) -> StandardErrors:
    """Find the standard errors by the linear-Gaussian model around the means.

    Parameters
    ----------
    problem : Problem
    mean, sd : (d,) array
        Of the distribution.
    correlation : (d, d) array
        Of the distribution.
    noise : (p,) array
        The noise variances that the estimate took for its weights; 0: what the mean leaves.
    settings : JacobianStepSettings
        The first differences are over the largest step, the second over one standard error as the
        first give it, within both steps.
    prior : MeanPrior, optional
        Of the means, where the estimate has one.

    Returns
    -------
    StandardErrors
    """
    width = problem.space.high - problem.space.low
    step = settings.largest * width
    found = _errors_with_step(problem, mean, sd, correlation, noise, step, settings, prior)
    known = np.where(np.isfinite(found.mean), found.mean, step)
    step = np.clip(known, settings.least * width, settings.largest * width)
    return _errors_with_step(problem, mean, sd, correlation, noise, step, settings, prior)


def _errors_with_step(
    problem: Problem,
    mean: Array,
    sd: Array,
    correlation: Array,
    noise: Array,
    step: Array,
    settings: JacobianStepSettings,
    prior: MeanPrior | None,
) -> StandardErrors:
    """The standard errors with sensitivities over steps (d,)."""
    segments = problem.segments
    d = len(mean)
    predicted, jacobian = problem.simulator.linearize(mean, segments, step=step)
    residuals = problem.simulator.targets(segments) - predicted

    # The sandwich of the unknowns (means, then variances) whose mean is not on a bound.
    known = np.where(noise > 0, noise, np.mean(residuals**2, axis=0))
    known = np.maximum(known, rounding(problem))
    spread = correlation * np.outer(sd, sd)
    scores, information = scores_and_information(residuals, jacobian, spread, known)
    bounds = prior.within if prior else problem.space
    kept = np.tile(_inside(bounds, mean, settings.edge), 2)
    units = units_of(segments)
    curvature = _curvature(prior, mean, np.arange(d), 2 * d)
    by_unit = _information_by_unit(jacobian, spread, known, information, np.arange(d), units)
    covariance, counted = sandwich(
        scores[:, kept],
        information[np.ix_(kept, kept)],
        units,
        None if curvature is None else curvature[kept],
        None if by_unit is None else by_unit[:, kept][:, :, kept],
    )
    variance = np.full(2 * d, np.nan)
    degrees = np.full(2 * d, np.nan)
    variance[kept] = np.diagonal(covariance)
    degrees[kept] = counted
    means = np.flatnonzero(np.isfinite(variance[:d]))
    if units.serial and not prior and not sd.any() and len(means):
        sums = variance_by_residuals(jacobian, residuals, 1 / known, units)[np.ix_(means, means)]
        inverse = inverse_information(information[np.ix_(means, means)])
        variance[means] = np.diagonal(inverse @ sums @ inverse)

    by_likelihood = np.full(2 * d, np.nan)
    inverse = np.linalg.pinv(information[np.ix_(kept, kept)], hermitian=True)
    by_likelihood[kept] = np.sqrt(np.diagonal(inverse))

    # From variances to scales; a spread that may be 0 has no symmetric error.
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(sd > 0, np.sqrt(variance[d:]) / (2 * sd), np.nan)
    scale[~(scale < sd)] = np.nan
    of_prior = _of_prior(prior, mean, np.arange(d), information, kept)
    of_mean = np.hypot(np.sqrt(variance[:d]), rounding_errors(problem, jacobian, known))
    return StandardErrors(
        of_mean,
        scale,
        degrees[:d],
        jacobian,
        prior=of_prior,
        by_likelihood=by_likelihood[:d],
    )


def local_standard_errors(
    problem: Problem,
    family: Family,
    objective: LocalLogLikelihood,
    phi: Array,
    settings: JacobianStepSettings = DIFFERENCES,
    prior: MeanPrior | None = None,
    memory: MemorySettings = MEMORY,
) -> StandardErrors:
    """Find the standard errors by a local likelihood's own scores.

    Parameters
    ----------
    problem : Problem
    family : Family
    objective : LocalLogLikelihood
        Built around its maximum.
    phi : (m,) array
        That maximum; unknowns of the family on a bound are held fixed.
    settings : JacobianStepSettings
    prior : MeanPrior, optional
        Of the means, where the maximum is that with a prior.
    memory : MemorySettings
        What of it the sensitivities may take.

    Returns
    -------
    StandardErrors
    """
    own = len(family.unknowns)
    _, scores, information = objective.value_score_information(phi)
    units = units_of(problem.segments)
    of_groups = len(units.label) != len(scores)
    if of_groups:  # their scores are independent as they are
        units = independent(len(scores))
    elif units.serial:
        scores = objective.scores_of_states(phi, scores, problem.segments)

    free = np.ones(len(phi), dtype=bool)
    free[:own] = _with_errors(family, phi[:own], settings.edge)
    errors = np.full(len(phi), np.nan)
    degrees = np.full(len(phi), np.nan)
    means = mean_places(objective, family.space)
    curvature = _curvature(prior, family.mean(phi[:own]), means, len(phi))
    of_free = None if curvature is None else curvature[free]
    information[np.ix_(means, means)] *= objective.curvature_factor(phi)
    own_information = information[np.ix_(free, free)]
    if not free.all():
        scores = scores[:, free]
    jacobian = local_jacobian(objective, family.mean(phi[:own]), problem, settings, memory)
    noise = np.maximum(objective.epsilon(phi), rounding(problem))
    by_unit = None
    if not of_groups:
        spread = _spread(family, phi[:own])
        by_unit = _information_by_unit(jacobian, spread, noise, information, means, units)
    if by_unit is not None:
        by_unit = by_unit[:, free][:, :, free]
    covariance, degrees[free] = sandwich(scores, own_information, units, of_free, by_unit)
    if objective.errors_from_model:
        known = own_information if of_free is None else own_information + np.diag(of_free)
        least = np.linalg.pinv(known, hermitian=True)
        of_model = np.diagonal(least) > np.diagonal(covariance)
        # Those of the model are no estimates of which few units could be wrong.
        degrees[free] = np.where(of_model, len(problem.trajectories), degrees[free])
        covariance = _at_least(covariance, least)
    if not (of_groups or units.serial):
        least = _with_shared_draws(problem, family, objective, phi, free, scores, jacobian, units)
        covariance = _at_least(covariance, least)
    errors[free] = np.sqrt(np.diagonal(covariance))
    errors[means] = np.hypot(errors[means], rounding_errors(problem, jacobian, noise))
    of_prior = _of_prior(prior, family.mean(phi[:own]), means, information, free)

    scale, variance = _of_spreads(family, objective, phi, errors, units, settings)
    whole = np.full((len(phi), len(phi)), np.nan)
    whole[np.ix_(free, free)] = covariance
    correlation = _correlation_errors(family, phi[:own], whole[:own, :own], settings)
    return StandardErrors(
        errors[means], scale, degrees[means], jacobian, variance, correlation, of_prior
    )


def _with_errors(family: Family, phi: Array, edge: float) -> NDArray[np.bool_]:
    """Which of the family's unknowns have errors: all that are not on a bound, and correlations.

    Held fixed on its bound a correlation would make errors of the sds too small.
    """
    correlations = [name.startswith("partial.") for name in family.unknowns.names]
    return _inside(family.unknowns, phi, edge) | np.array(correlations, dtype=bool)


def _of_spreads(
    family: Family,
    objective: LocalLogLikelihood,
    phi: Array,
    errors: Array,
    units: Units,
    settings: JacobianStepSettings,
) -> tuple[Array, Array]:
    """Standard errors (d,) of the scales, and of the variances, from those of phi (m,)."""
    names = objective.unknowns.names
    own = phi[: len(family.unknowns)]
    scale = np.full(len(family.space), np.nan)
    for i, name in enumerate(family.space.names):
        if f"scale.{name}" in names:
            scale[i] = errors[names.index(f"scale.{name}")]
    size = family.scale(own)
    variance = variance_errors(family.sd(own), size, scale)
    mean_se = errors[mean_places(objective, family.space)]
    none = _variances_of_none(family, objective, phi, mean_se, units, settings)
    scale[~(scale < size)] = np.nan
    return scale, np.where(np.isfinite(none), none, variance)


def _variances_of_none(
    family: Family,
    objective: LocalLogLikelihood,
    phi: Array,
    mean_se: Array,
    units: Units,
    settings: JacobianStepSettings,
) -> Array:
    """(d,) standard errors of the variances of parameters that do not vary; NaN of all others.

    A scale of 0 has no score, but its square has: that of a scale so small that it changes nothing.
    """
    names = objective.unknowns.names
    own = phi[: len(family.unknowns)]
    scale = family.scale(own)
    out = np.full(len(mean_se), np.nan)
    unit = family.unknowns.to_unit(own)
    none = [
        i
        for i, name in enumerate(family.space.names)
        if f"scale.{name}" in names
        and unit[names.index(f"scale.{name}")] <= settings.edge
        and np.isfinite(mean_se[i])
    ]
    if not none:
        return out
    places = [names.index(f"scale.{family.space.names[i]}") for i in none]
    small = np.maximum(settings.small * mean_se[none], scale[none])
    moved = phi.copy()
    moved[places] = small
    _, scores, information = objective.value_score_information(moved)
    by_variance = 1 / (2 * small)
    scores = scores[:, places] * by_variance
    information = information[np.ix_(places, places)] * np.outer(by_variance, by_variance)
    if not (np.diagonal(information) > 0).all():
        return out
    covariance = sandwich(scores, information, units)[0]
    covariance = _at_least(covariance, inverse_information(information))
    out[none] = np.sqrt(np.diagonal(covariance))
    return out


def _information_by_unit(
    jacobian: KeptRows,
    spread: Array,
    noise: Array,
    information: Array,
    means: Ints,
    units: Units,
    settings: ShareSettings = SHARES,
) -> Array | None:
    """(G, m, m) what each unit has of the information (m, m) of all; None where it does not matter.

    On the means it is that of the linear-Gaussian model, on all else the unit's share of the rows.
    """
    if units.serial or units.count > settings.most:
        return None
    share = np.bincount(units.label) / len(units.label)
    out = share[:, None, None] * np.diag(np.diagonal(information))
    of_means = information_of_units(jacobian, spread, noise, units.label)
    out[:, means[:, None], means] = of_means
    return out


def _with_shared_draws(
    problem: Problem,
    family: Family,
    objective: LocalLogLikelihood,
    phi: Array,
    free: NDArray[np.bool_],
    scores: Array,
    jacobian: KeptRows,
    units: Units,
    settings: SharedDrawSettings = SHARED_DRAWS,
    steps: JacobianStepSettings = DIFFERENCES,
) -> Array:
    """(f, f) covariance of scales and correlations of a Gaussian of which each unit has a draw.

    That of all other free unknowns is 0. The residuals of few units say it badly: they are squares
    of squares. How much of a draw a unit shares is what their means' scores show, 0 to 1.
    """
    places = np.flatnonzero(free)
    out = np.zeros((len(places), len(places)))
    own = phi[: len(family.unknowns)]
    names = family.unknowns.names
    scales = [f"scale.{name}" for name in family.space.names]
    varying = np.array(
        [i for i, scale in enumerate(scales) if scale in names and free[names.index(scale)]],
        dtype=np.int64,
    )
    if not 0 < len(varying) <= settings.most:
        return out

    # What the family's free unknowns of the spread do to its entries.
    entries = tuple(varying[pairs_of(len(varying))])
    unknowns = [i for i in places if i < len(own) and not names[i].startswith("mean.")]
    half = steps.local * np.eye(len(own))[unknowns] * (family.unknowns.high - family.unknowns.low)
    ends = [[_spread(family, own + sign * h)[entries] for sign in (1, -1)] for h in half]
    slopes = np.array(
        [(up - down) / (2 * h.sum()) for (up, down), h in zip(ends, half, strict=True)]
    )
    noise = np.maximum(objective.epsilon(phi), rounding(problem))
    found = score_covariances(jacobian, _spread(family, own), noise, units.label, varying)

    # How much units share, by the scores of their means.
    means = mean_places(objective, family.space)[varying]
    used = free[means]
    of_means = np.searchsorted(places, means[used])
    seen = np.sum(unit_sums(scores[:, of_means], units) ** 2, axis=0)
    expected = np.diagonal(found.mean)[used]
    excess = np.sum(np.diagonal(found.mean_shared)[used] / expected)
    shared = np.sum(seen / expected - 1) / excess if excess > 0 else 0.0
    shared = float(np.clip(shared, 0.0, 1.0))

    information = slopes @ found.pair @ slopes.T
    variance = slopes @ (found.pair + shared**2 * found.pair_shared) @ slopes.T
    inverse = np.linalg.pinv(information, hermitian=True)
    block = np.searchsorted(places, unknowns)
    out[np.ix_(block, block)] = inverse @ variance @ inverse
    return out


def _spread(family: Family, phi: Array) -> Array:
    """(d, d) the covariance of a member."""
    sd = family.sd(phi)
    return np.asarray(family.correlation(phi) * np.outer(sd, sd))


def _curvature(prior: MeanPrior | None, mean: Array, places: Ints, size: int) -> Array | None:
    """(size,) the prior's information on all unknowns; None without a prior."""
    if not prior:
        return None
    out = np.zeros(size)
    out[places] = prior.information(mean)
    return out


def _of_prior(
    prior: MeanPrior | None, mean: Array, places: Ints, information: Array, free: np.ndarray
) -> OfPrior | None:
    """What the priors are to means (d,) at these places among the unknowns (m,) of an information.

    With I the information of the data and P that of the prior, data and prior at the maximum pull
    with the same score g against each other, whose variance is P - P (I + P)^-1 P.
    """
    if not prior:
        return None
    curvature = _curvature(prior, mean, places, len(information))
    assert curvature is not None
    both = information + np.diag(curvature)
    used = free & (np.diagonal(both) > 0)
    covariance = np.full(len(both), np.nan)
    covariance[used] = np.diagonal(inverse_information(both[np.ix_(used, used)]))
    known = used & (np.diagonal(information) > 0)
    of_data = np.full(len(both), np.inf)
    of_data[known] = np.diagonal(inverse_information(information[np.ix_(known, known)]))
    fraction = np.clip(1 - covariance / of_data, 0.0, 1.0)[places]

    expected = (curvature - curvature**2 * covariance)[places]
    score = prior.score(mean)
    with np.errstate(invalid="ignore", divide="ignore"):
        pull = np.where(expected > 0, np.abs(score) / np.sqrt(expected), np.nan)
    return OfPrior(fraction, pull)


def _at_least(covariance: Array, least: Array) -> Array:
    """A covariance with no standard deviation below that of another one."""
    variance = np.diagonal(covariance)
    ratio = np.maximum(np.diagonal(least) / np.where(variance > 0, variance, 1.0), 1.0)
    return np.asarray(covariance * np.sqrt(np.outer(ratio, ratio)))


def _correlation_errors(
    family: Family, phi: Array, covariance: Array, settings: JacobianStepSettings
) -> Array | None:
    """(d, d) standard errors of the correlations, to first order in the partial ones."""
    names = family.unknowns.names
    partial = [i for i, name in enumerate(names) if name.startswith("partial.")]
    if not partial:
        return None
    half = settings.local * np.eye(len(phi))[partial]
    change = [family.correlation(phi + h) - family.correlation(phi - h) for h in half]
    slopes = np.stack(change) / (2 * settings.local)  # (n, d, d)
    own = covariance[np.ix_(partial, partial)]
    needed = slopes != 0
    terms = np.einsum("nde,nk,kde->nkde", slopes, own, slopes)
    both = needed[:, None] & needed[None]
    variance = np.sum(np.where(both, terms, 0.0), axis=(0, 1))
    np.fill_diagonal(variance, 0.0)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def local_jacobian(
    objective: LocalLogLikelihood,
    mean: Array,
    problem: Problem,
    settings: JacobianStepSettings = DIFFERENCES,
    memory: MemorySettings = MEMORY,
) -> KeptRows:
    """Differentiate a local model at the mean, block by block.

    Parameters
    ----------
    objective : LocalLogLikelihood
    mean : (d,) array
    problem : Problem
        Of its rows and parameters.
    settings : JacobianStepSettings
    memory : MemorySettings
        What of it the result may take, beyond which it is kept in a file.

    Returns
    -------
    (R, p, d) array
    """
    space = problem.space
    half = settings.local * np.diag(space.high - space.low)
    values = np.concatenate([mean + half, mean - half])
    width = (2 * np.diagonal(half))[:, None, None]
    rows = len(problem.segments.rows[0])
    p = len(problem.simulator.signals)
    (out,) = keep_rows([(rows, p, len(mean))], memory.sensitivities, memory)
    for block in row_blocks(rows, 8 * p * 2 * len(values)):
        predictions = objective.predict_rows(values, block)
        change = predictions[: len(mean)] - predictions[len(mean) :]
        out[block] = np.moveaxis(change / width, 0, -1)
    return out


def rounding(problem: Problem) -> Array:
    """Find the variance of rounding in each signal, below which a residual says nothing.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    (p,) array
        The square of 1e-12 of the signals' size.
    """
    size = np.mean(problem.segments.targets**2)
    return np.maximum(1e-24 * size, 1e-60) * np.ones(len(problem.simulator.signals))


def rounding_errors(problem: Problem, jacobian: KeptRows, noise: Array) -> Array:
    """Find the errors of means that the arithmetic of simulations leaves without any noise.

    How far each signal moves within a segment has a relative error of float64's precision, of which
    a part is the same in all rows: products of constants are rounded alike everywhere. No residual
    shows that part, since it moves the estimate.

    Parameters
    ----------
    problem : Problem
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions by the parameters.
    noise : (p,) array
        The variances whose inverses are the weights.

    Returns
    -------
    (d,) array
        In the parameters' units, signals taken for independent.
    """
    segments = problem.segments
    moved = np.asarray(problem.simulator.targets(segments))
    if segments.starts.shape[1] == moved.shape[1]:
        moved = moved - segments.starts[segments.rows[0]]
    rows, p, d = jacobian.shape
    information = np.zeros((d, d))
    scores = np.zeros((d, p))
    for block in row_blocks(rows, 16 * p * d):
        own = np.asarray(jacobian[block])
        weighted = own / noise[:, None]
        information += np.tensordot(own, weighted, axes=((0, 1), (0, 1)))
        scores += np.einsum("rpd,rp->dp", weighted, moved[block])
    diagonal = np.diagonal(information)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=SINGULAR, hermitian=True)
    by_signal = inverse @ (scores / size[:, None]) / size[:, None]
    return np.asarray(np.finfo(float).eps * np.linalg.norm(by_signal, axis=1))


def _inside(space: ParameterSpace, values: Array, edge: float) -> np.ndarray:
    """Which values are not on a bound."""
    unit = space.to_unit(values)
    return np.asarray((unit > edge) & (unit < 1 - edge))
