"""Scores and information of parameters with all start states eliminated, piece by piece."""

from dataclasses import dataclass

import numpy as np

from dropo.core.numerics.tails import student_log_density
from dropo.core.services.validation import Array
from dropo.likelihoods.support.runs.linearization import LinearizedInstants
from dropo.likelihoods.support.runs.noise_levels import NoiseDistribution, follows, whiten


@dataclass(frozen=True, eq=False)
class Condensed:
    """P pieces around one point, their starts eliminated (a Schur complement for each).

    Attributes
    ----------
    scores : (T, d) array
        Score in the parameters of every instant.
    information : (P, d, d) array
        Fisher information on the parameters.
    values : (T,) array
        Log density of every instant [nats]; that of a piece less what its start costs.
    start_step : (P, s) array
        Step of each piece's start, the parameters as they are.
    start_by_value : (P, s, d) array
        d start / d parameter along which the likelihood stays at its best start.
    """

    scores: Array
    information: Array
    values: Array
    start_step: Array
    start_by_value: Array


def condense(
    columns: LinearizedInstants, noise: NoiseDistribution, prior: Array, starts: Array
) -> Condensed:
    """Eliminate the starts of all pieces.

    Parameters
    ----------
    columns : LinearizedInstants
    noise : NoiseDistribution
    prior : (s,) array
        Information of the prior on each start, whose mean is an offset of 0.
    starts : (P, s) array
        Where the starts are.

    Returns
    -------
    Condensed
    """
    s = columns.states
    z = whiten(columns, noise)
    residual = z[:, :, -1]
    weights = noise.weights(residual**2)
    kappa = noise.information[:, None]
    change = np.append(True, columns.piece[1:] != columns.piece[:-1])
    bounds = np.append(np.flatnonzero(change), len(change))
    count = len(bounds) - 1
    d = z.shape[2] - s - 1

    scores = np.empty((len(z), d))
    information = np.empty((count, d, d))
    step = np.empty((count, s))
    by_value = np.empty((count, s, d))
    values = log_densities(columns, noise)
    for p in range(count):
        rows = slice(bounds[p], bounds[p + 1])
        a = z[rows, :, :s]
        b = z[rows, :, s : s + d]
        weighted = weights[rows] * residual[rows]
        a_a = np.einsum("tma,tmb->ab", kappa * a, a, optimize=True)
        known = a_a + np.diag(prior)
        a_b = np.einsum("tma,tmd->ad", kappa * a, b, optimize=True)
        inverse = np.linalg.inv(known)
        follow = inverse @ a_b
        information[p] = np.einsum("tmc,tmd->cd", kappa * b, b, optimize=True) - a_b.T @ follow
        pull = np.einsum("tma,tm->a", a, weighted) - prior * starts[p]
        step[p] = inverse @ pull
        by_value[p] = -follow
        scores[rows] = np.einsum("tmd,tm->td", b - a @ follow, weighted)
        scores[rows] += prior * starts[p] @ follow / (rows.stop - rows.start)
        cost = 0.5 * (np.linalg.slogdet(known)[1] - np.log(prior).sum())
        cost += 0.5 * np.sum(prior * starts[p] ** 2)
        values[rows] -= cost / (rows.stop - rows.start)
    return Condensed(scores, information, values, step, by_value)


def log_densities(columns: LinearizedInstants, noise: NoiseDistribution) -> Array:
    """Evaluate the log density of every instant, from the starts and parameters as they are.

    Parameters
    ----------
    columns : LinearizedInstants
    noise : NoiseDistribution

    Returns
    -------
    (T,) array
        Of what is new at each instant [nats].
    """
    residual = whiten(columns, noise)[:, :, -1]
    finite = np.isfinite(noise.degrees)
    nu = np.where(finite, noise.degrees, 5.0)
    gaussian = -0.5 * residual**2 - 0.5 * np.log(2 * np.pi)
    own = np.where(finite, student_log_density(residual, nu), gaussian)
    shrink = 0.5 * np.log1p(-(noise.memory**2))
    own = own - np.log(noise.sd) - np.where(follows(columns), shrink, 0.0)
    return np.asarray(np.where(columns.valid, own, 0.0).sum(axis=1))
