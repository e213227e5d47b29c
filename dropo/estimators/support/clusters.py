"""Two clusters of groups: the mixture that their recordings make most likely."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.likelihood import Groups
from dropo.core.numerics.dependence import independent
from dropo.core.numerics.robust_covariance import sandwich
from dropo.core.services.validation import Array
from dropo.families.mixture import Mixture


@dataclass(frozen=True)
class ClusterSettings:
    """How two clusters are found.

    Attributes
    ----------
    iterations : int
        Steps of the expectation-maximisation from each start, at most.
    tolerance : float
        They end with a gain below this [nats].
    difference : float
        Width of differences of the likelihood, in standard deviations of the parameters.
    """

    iterations: int = 5000
    tolerance: float = 1e-9
    difference: float = 1e-3


SETTINGS = ClusterSettings()


@dataclass(frozen=True, eq=False)
class Clusters:
    """Two clusters of G groups, and what each group's parameters are under them.

    Attributes
    ----------
    phi : (m,) array
        The member of `Mixture`.
    covariance : (m, m) array
        Of its estimate, by the sandwich over groups; NaN where there is none.
    degrees : (m,) array
        Degrees of freedom behind it.
    gain : float
        By how much more likely the groups are than under one Gaussian [nats].
    added : int
        Unknowns that the mixture has more than that Gaussian.
    membership : (G,) array
        The probability that a group belongs to the second cluster.
    mean : (G, d) array
        Each group's parameters given all data.
    spread : (G, d, d) array
        Their covariance, as if the mixture were known.
    kept : (G, d, d) array
        How much of its cluster's mean each group's parameters keep.
    """

    phi: Array
    covariance: Array
    degrees: Array
    gain: float
    added: int
    membership: Array
    mean: Array
    spread: Array
    kept: Array

    @property
    def sufficient(self) -> bool:
        """Whether two clusters are better than one by Schwarz's criterion."""
        return self.gain > 0.5 * self.added * np.log(len(self.membership))


def find_clusters(
    groups: Groups,
    family: Mixture,
    mean: Array,
    sd: Array,
    settings: ClusterSettings = SETTINGS,
) -> Clusters:
    """Find the two clusters that make the recordings of all groups most likely.

    Each group's likelihood is Gaussian in its parameters, as linear around its mode.

    Parameters
    ----------
    groups : Groups
        Their modes and information under one Gaussian.
    family : Mixture
        Of the d parameters.
    mean, sd : (d,) array
        That Gaussian's, with independent parameters; those whose sd is 0 do not vary.
    settings : ClusterSettings

    Returns
    -------
    Clusters

    References
    ----------
    Bovy, Hogg and Roweis, Annals of Applied Statistics 5 (2011), 1657: clusters of noisy values.
    """
    d = len(mean)
    size = np.where(sd > 0, sd, 1.0)
    own = _Relative(groups.score * size, groups.precision * np.outer(size, size))
    away = (groups.mean - mean) / size
    varies = sd > 0
    found = max((_maximum(own, start, settings) for start in _starts(away, varies)), key=_value)
    centres, variance, weight = found.centres, found.variance, found.weight
    whole = (1 - weight) * centres[0] + weight * centres[1]
    gap = (centres[1] - centres[0]) * size
    phi = np.concatenate([mean + whole * size, np.sqrt(variance) * size, [weight], gap])
    at = found.at
    member = at.membership
    both = np.stack([1 - member, member], axis=1)
    expected = np.einsum("gk,gkd->gd", both, at.modes)
    apart = at.modes - expected[:, None]
    spread = at.spread + np.einsum("gk,gkd,gke->gde", both, apart, apart)
    covariance, degrees = _errors(own, phi, mean, size, varies, settings)
    one = own.at(0.5, np.zeros((2, d)), (sd / size) ** 2)
    return Clusters(
        phi,
        covariance,
        degrees,
        at.value - one.value,
        1 + int(varies.sum()),
        member,
        mean + expected * size,
        spread * np.outer(size, size),
        at.kept * (size[:, None] / size),
    )


@dataclass(frozen=True, eq=False)
class _Integrated:
    """The groups under two clusters, their parameters integrated out."""

    values: Array  # (G,) log-likelihoods [nats]
    membership: Array  # (G,)
    modes: Array  # (G, 2, d)
    spread: Array  # (G, d, d)
    kept: Array  # (G, d, d)

    @property
    def value(self) -> float:
        """Of all groups [nats]."""
        return float(self.values.sum())


@dataclass(frozen=True, eq=False)
class _Found:
    """Where the expectation-maximisation ended."""

    weight: float
    centres: Array  # (2, d)
    variance: Array  # (d,)
    at: _Integrated


def _value(found: _Found) -> float:
    return found.at.value


@dataclass(frozen=True, eq=False)
class _Relative:
    """The groups' likelihoods, in parameters less the mean of one Gaussian, in its sds.

    Attributes
    ----------
    score : (G, d) array
        Slopes at that mean.
    precision : (G, d, d) array
        Information.
    """

    score: Array
    precision: Array

    def at(self, weight: float, centres: Array, variance: Array) -> _Integrated:
        """Under clusters with centres (2, d), variances (d,), and a weight of the second."""
        factor = np.eye(len(variance)) + self.precision * variance
        kept = np.asarray(np.linalg.inv(factor), dtype=float).swapaxes(1, 2)  # (I + T G)^-1
        spread = kept * variance
        pulled = np.einsum("gde,ke->gkd", self.precision, centres)
        rest = self.score[:, None] - pulled
        moved = np.einsum("gde,gke->gkd", spread, rest)
        exponent = np.sum(rest * moved + centres * (2 * self.score[:, None] - pulled), axis=2)
        log_size = np.linalg.slogdet(factor)[1]
        log_weights = np.log([1 - weight, weight])
        logs = 0.5 * exponent - 0.5 * log_size[:, None] + log_weights
        values = np.logaddexp(logs[:, 0], logs[:, 1])
        membership: Array = np.exp(logs[:, 1] - values)
        return _Integrated(values, membership, centres + moved, spread, kept)


def _starts(away: Array, varies: NDArray[np.bool_]) -> list[tuple[float, Array, Array]]:
    """Weights, centres (2, d) and variances (d,), from the best cut along each parameter that
    varies, and along the direction in which the groups (G, d) differ most.
    """
    d = away.shape[1]
    directions = [np.eye(d)[i] for i in np.flatnonzero(varies)]
    if len(directions) > 1:
        directions.append(np.linalg.svd(away - away.mean(axis=0))[2][0])
    starts = []
    for direction in directions:
        order = np.argsort(away @ direction)
        along = np.sort(away @ direction)
        below = np.arange(1, len(along))
        sums = np.cumsum(along)[:-1]
        between = (sums * len(along) / below - along.sum()) ** 2 * below / (len(along) - below)
        cut = int(below[between.argmax()])
        parts = (away[order[:cut]], away[order[cut:]])
        centres = np.stack([part.mean(axis=0) for part in parts])
        within = sum(np.sum((part - part.mean(axis=0)) ** 2, axis=0) for part in parts)
        variance = np.where(varies, np.maximum(within / len(along), 1e-4), 0.0)
        starts.append((1 - cut / len(along), centres * varies, variance))
    return starts


def _maximum(
    own: _Relative, start: tuple[float, Array, Array], settings: ClusterSettings
) -> _Found:
    """Where the expectation-maximisation leads from a start."""
    weight, centres, variance = start
    at = own.at(weight, centres, variance)
    for _ in range(settings.iterations):
        both = np.stack([1 - at.membership, at.membership], axis=1)  # (G, 2)
        shares = both.mean(axis=0)
        least = Mixture.smallest_weight
        weight = float(np.clip(shares[1], least, 1 - least))
        centres = np.einsum("gk,gkd->kd", both, at.modes) / (shares[:, None] * len(both))
        apart = np.einsum("gk,gkd->d", both, (at.modes - centres) ** 2) / len(both)
        own_variance = np.einsum("gdd->gd", at.spread).mean(axis=0)
        variance = np.where(variance > 0, apart + own_variance, 0.0)
        before = at.value
        at = own.at(weight, centres, variance)
        if at.value - before < settings.tolerance:
            break
    return _Found(weight, centres, variance, at)


def _errors(
    own: _Relative,
    phi: Array,
    mean: Array,
    size: Array,
    varies: NDArray[np.bool_],
    settings: ClusterSettings,
) -> tuple[Array, Array]:
    """The covariance (m, m) of phi (m,), and its degrees of freedom (m,), by differences."""
    d = len(mean)

    def values(numbers: Array) -> Array:
        """Log-likelihoods (G,) of numbers (m,) in units of the sds."""
        whole, scale, weight, gap = np.split(numbers, [d, 2 * d, 2 * d + 1])
        (second,) = weight
        centres = whole + np.array([-second, 1 - second])[:, None] * gap
        return own.at(float(second), centres, scale**2).values

    unit = np.concatenate([size, size, [1.0], size])
    here = phi / unit
    here[:d] = (phi[:d] - mean) / size
    # Parameters that do not vary have a mean alone.
    free = np.concatenate([np.ones(d, dtype=bool), varies, [True], varies])
    steps = settings.difference * np.eye(len(phi))[free]

    def scores(numbers: Array) -> Array:
        """Slopes (G, f) in the free numbers."""
        changes = [values(numbers + step) - values(numbers - step) for step in steps]
        return np.stack(changes, axis=1) / (2 * settings.difference)

    slopes = [(scores(here + step) - scores(here - step)).sum(axis=0) for step in steps]
    hessian = np.stack(slopes) / (2 * settings.difference)
    information = -0.5 * (hessian + hessian.T)
    covariance = np.full((len(phi), len(phi)), np.nan)
    degrees = np.full(len(phi), np.nan)
    if np.linalg.eigvalsh(information)[0] > 0:
        rows = scores(here)
        of_free, degrees[free] = sandwich(rows, information, independent(len(rows)))
        covariance[np.ix_(free, free)] = of_free
    return covariance * np.outer(unit, unit), degrees
