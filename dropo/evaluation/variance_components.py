"""Whether groups differ at all: likelihood-ratio tests of spreads of 0, which lie on the boundary
of what they may be.
"""

from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2

from dropo.core.contracts.fisher_scoring import maximize_locally
from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

DRAWS = 4000  # of the boundary's law: its weights are right to 0.008
UNTOLD = 1e-6  # of the largest root of an information: below it there is none
NO_SPREAD = 1e-3  # of the mean's standard error: there the information of variances is that at 0


def spread_tests(
    objective: LocalLogLikelihood, names: tuple[str, ...], phi: Array, rng: np.random.Generator
) -> dict[str, Any]:
    """Twice the gain in log-likelihood of spreads over none, and its p-value: overall, and for each
    of the named parameters.

    phi: (m,) a maximum of the objective, whose unknowns are means, scales, "partial." correlations,
    and noise. Likelihoods are restricted ones, at the maxima of the full ones.
    overall: all spreads of the law without correlations against none, by the chi-bar-square law of
    variances that cannot be negative (Self and Liang 1987, J. Am. Stat. Assoc. 82). parameters: one
    spread with its q correlations against none, by an even mixture of chi-square with q and q + 1
    degrees (Stram and Lee 1994, Biometrics 50); where other spreads are 0 too, it asks for more
    than it must. Both hold for many groups; with few, their p-values are too large rather than too
    small.
    """
    scales = {f"scale.{name}": 0.0 for name in names}
    partials = {u: 0.0 for u in objective.unknowns.names if u.startswith("partial.")}
    independent = _Held(objective, partials)
    none = _Held(objective, scales | partials)
    nowhere = none.maximum(phi)
    weights = boundary_weights(_information_at_none(objective, none.whole(nowhere)), rng)
    overall = _entry(
        restricted(independent, independent.maximum(phi)) - restricted(none, nowhere), weights
    )
    whole = _Held(objective, {})
    parameters = {}
    best = restricted(whole, whole.maximum(phi))
    for name in names:
        own = {
            u: 0.0
            for other in names
            for u in (f"partial.{name}.{other}", f"partial.{other}.{name}")
            if u in partials
        }
        without = _Held(objective, {f"scale.{name}": 0.0} | own)
        parameters[name] = _entry(
            best - restricted(without, without.maximum(phi)), np.eye(len(own) + 2)[-2:].mean(axis=0)
        )
    return {**overall, "parameters": parameters}


def restricted(objective: LocalLogLikelihood, phi: Array) -> float:
    """The log-likelihood with the means integrated out, up to a constant: the spreads are not
    judged by a mean that was fitted to the same groups (Harville 1977, J. Am. Stat. Assoc. 72).
    """
    value, _, information = objective.value_score_information(phi)
    mean = _places(objective, "mean.")
    information = information[np.ix_(mean, mean)]
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information / np.outer(size, size) + 1e-12 * np.eye(len(size))
    return value - float(np.log(size).sum() + 0.5 * np.linalg.slogdet(scaled)[1])


def boundary_weights(information: Array, rng: np.random.Generator) -> Array:
    """(d + 1,) how often 0 ... d of d variances, of that information (d, d), are above 0 where all
    of them truly are 0.

    By projecting Gaussian draws onto the cone of variances that are not negative, in the
    information's metric; Binomial(d, 1/2) where it is diagonal.
    """
    size = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    told = size > UNTOLD * size.max()
    if not told.any():
        return np.eye(len(size) + 1)[0]
    root = np.linalg.cholesky(
        information[np.ix_(told, told)] / np.outer(size[told], size[told])
        + 1e-9 * np.eye(int(told.sum()))
    )
    positive = [
        np.count_nonzero(nnls(root.T, draw)[0]) for draw in rng.standard_normal((DRAWS, len(root)))
    ]
    return np.bincount(positive, minlength=len(size) + 1) / DRAWS


def _entry(gain: float, weights: Array) -> dict[str, float]:
    """Twice the gain, at least 0, and the probability of as large a one: sum_k weights_k P(chi2_k
    >= statistic).
    """
    statistic = max(0.0, 2 * gain)
    tails = np.append(statistic <= 0, chi2.sf(statistic, np.arange(1, len(weights))))
    return {"statistic": statistic, "p_value": min(1.0, float(weights @ tails))}


def _places(objective: LocalLogLikelihood, kinds: str | tuple[str, ...]) -> Ints:
    return np.array(
        [i for i, name in enumerate(objective.unknowns.names) if name.startswith(kinds)],
        dtype=np.int64,
    )


def _information_at_none(objective: LocalLogLikelihood, phi: Array) -> Array:
    """The information (d, d) of the variances where all of them are 0, up to a factor for each,
    with noise and means found too.
    """
    mean, scale, other = (
        _places(objective, kinds) for kinds in ("mean.", "scale.", ("mean.", "epsilon"))
    )
    phi = phi.copy()
    phi[scale] = NO_SPREAD / np.sqrt(
        np.maximum(np.diagonal(objective.value_score_information(phi)[2])[mean], 1e-300)
    )
    information = objective.value_score_information(phi)[2]
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    information = information / np.outer(size, size)
    cross = information[np.ix_(scale, other)]
    return (
        information[np.ix_(scale, scale)]
        - cross @ np.linalg.pinv(information[np.ix_(other, other)], hermitian=True) @ cross.T
    )


class _Held(LocalLogLikelihood):
    """A local likelihood with some of its unknowns held at values of their own."""

    def __init__(self, objective: LocalLogLikelihood, held: dict[str, float]):
        self.objective = objective
        names = objective.unknowns.names
        self.free = np.array([name not in held for name in names])
        self.held = np.array([held.get(name, 0.0) for name in names])
        self.unknowns = ParameterSpace(tuple(p for p in objective.unknowns if p.name not in held))

    def maximum(self, phi: Array) -> Array:
        """Where it is, found from the objective's own phi (m,)."""
        return maximize_locally(self, phi[self.free]).phi

    def whole(self, phi: Array) -> Array:
        """The objective's phi of the free unknowns'."""
        out = self.held.copy()
        out[self.free] = phi
        return out

    def _rows(self, phi: Array) -> Array:
        return self.objective.rows(self.whole(phi))

    def epsilon(self, phi: Array) -> Array:
        return self.objective.epsilon(self.whole(phi))

    def mean(self, phi: Array) -> Array:
        return self.objective.mean(self.whole(phi))

    def predict(self, values: Array) -> Array:
        return self.objective.predict(values)

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        value, scores, information = self.objective.value_score_information(self.whole(phi))
        return value, scores[:, self.free], information[np.ix_(self.free, self.free)]
