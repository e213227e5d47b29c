"""Formulas of up to three terms that the residual forces at a joint ask for."""

from collections.abc import Callable
from dataclasses import dataclass
from math import comb, log

import numpy as np

from dropo.core.services.validation import Array
from dropo.diagnosis.laws.shapes import LawTerm


@dataclass(frozen=True)
class PursuitSettings:
    """How formulas are put together.

    Attributes
    ----------
    novel : float
        Part of a term's whitened response, as a sum of squares, that fitted effects must leave.
    independent : float
        Part of a term's response that the other terms of its formula must leave.
    pairs : int
        The best pairs to which a third term is added.
    kept : int
        The best formulas that are kept of each number of terms.
    """

    novel: float = 0.02
    independent: float = 0.02
    pairs: int = 30
    kept: int = 12


SETTINGS = PursuitSettings()


@dataclass(frozen=True, eq=False)
class Proposal:
    """A formula that residual forces ask for.

    Attributes
    ----------
    joint : str
        Where it acts.
    shapes : tuple of LawTerm
        Its terms.
    sizes : (k,) array
        The constants before them.
    gain : float
        What it promises [nats].
    score : float
        The gain less the price of its numbers and of the number of formulas tried [nats].
    signature : (N,) array
        Its whitened response, of length 1.
    """

    joint: str
    shapes: tuple[LawTerm, ...]
    sizes: Array
    gain: float
    score: float
    signature: Array


def propose(
    joint: str,
    shapes: list[LawTerm],
    columns: Array,
    residuals: Array,
    variance: float,
    steps: int,
    pool: int,
    full: Array,
    settings: PursuitSettings = SETTINGS,
) -> list[Proposal]:
    """Find the formulas of one joint that explain most: singles, all pairs, some triples.

    Parameters
    ----------
    joint : str
        The joint.
    shapes : list of LawTerm
        K terms.
    columns : (K, N) array
        Their whitened responses, without what is explained anyway.
    residuals : (N,) array
        The whitened residuals, likewise.
    variance : float
        Of the residuals.
    steps : int
        Control steps in the windows.
    pool : int
        Terms at all joints together.
    full : (K,) array
        Lengths of the whitened responses with what is explained anyway.
    settings : PursuitSettings
        How formulas are put together.

    Returns
    -------
    list of Proposal
        The best score first.

    Notes
    -----
    The score is the extended BIC [1]_: gain - d / 2 log(steps) - log(number of formulas of so many
    terms), with d constants.

    References
    ----------
    .. [1] Chen and Chen, Extended Bayesian information criteria, Biometrika 95, 2008.
    """
    lengths = np.linalg.norm(columns, axis=1)
    usable = np.flatnonzero(lengths > np.sqrt(settings.novel) * np.maximum(full, 1e-300))
    if not len(usable):
        return []
    unit = columns[usable] / lengths[usable, None]
    gram = unit @ unit.T
    along = unit @ residuals
    known = np.array([shapes[i].known for i in usable])
    extra = np.array([len(shapes[i].own) for i in usable])

    def score_of(gain: Array, terms: int, numbers: Array) -> Array:
        """The extended BIC."""
        price = 0.5 * numbers * log(steps) + log(max(comb(pool, terms), 1))
        return np.asarray(gain / variance - price)

    sets = _sets(gram, along, known, score_of, extra, settings)
    found = []
    for score, members in sets:
        if score <= 0:
            continue
        rows = columns[usable[list(members)]]
        sizes = np.asarray(np.linalg.lstsq(rows.T, residuals, rcond=None)[0], dtype=float)
        response = sizes @ rows
        gain_here = float(response @ residuals) / (2 * variance)
        signature = np.asarray(response / max(float(np.linalg.norm(response)), 1e-300))
        terms = tuple(shapes[usable[i]] for i in members)
        found.append(Proposal(joint, terms, sizes, gain_here, score, signature))
    return sorted(found, key=lambda one: -one.score)


def _sets(
    gram: Array,
    along: Array,
    known: Array,
    score_of: Callable[[Array, int, Array], Array],
    extra: Array,
    settings: PursuitSettings,
) -> list[tuple[float, tuple[int, ...]]]:
    """The best sets of one, two and three of K terms with their scores.

    gram: (K, K) cosines of the responses; along: (K,) the residuals along each; known: (K,) whether
    a known effect stands for it; extra: (K,) how many constants of its own each has.
    """
    sets: list[tuple[float, tuple[int, ...]]] = []
    single = score_of(0.5 * along**2, 1, 1 + extra)
    sets += _best(single, [(i,) for i in range(len(known))], known, settings.kept)

    first, second = np.triu_indices(len(known), 1)
    cross = gram[first, second]
    apart = 1 - cross**2
    fine = apart > settings.independent
    first = first[fine]
    second = second[fine]
    cross = cross[fine]
    apart = apart[fine]
    gain = 0.5 * (along[first] ** 2 - 2 * along[first] * along[second] * cross + along[second] ** 2)
    pair = score_of(gain / apart, 2, 2 + extra[first] + extra[second])
    order = np.argsort(-pair)[: 20 * settings.pairs]
    tuples: list[tuple[int, ...]] = [(int(first[k]), int(second[k])) for k in order]
    sets += _best(pair[order], tuples, known, settings.kept)

    best_pairs = tuples[: settings.pairs]
    triples = {
        tuple(sorted((*two, i))) for two in best_pairs for i in range(len(known)) if i not in two
    }
    chosen = np.array(sorted(triples), dtype=np.int64).reshape(-1, 3)
    if len(chosen):
        grams = gram[chosen[:, :, None], chosen[:, None, :]]
        fine = np.linalg.det(grams) > settings.independent**2
        chosen = chosen[fine]
        sides = along[chosen]
        solved = np.linalg.solve(grams[fine], sides[..., None])[..., 0]
        three = score_of(0.5 * (solved * sides).sum(axis=1), 3, 3 + extra[chosen].sum(axis=1))
        sets += _best(three, [tuple(row) for row in chosen.tolist()], known, settings.kept)

    return sets


def _best(
    scores: Array, sets: list[tuple[int, ...]], known: Array, kept: int
) -> list[tuple[float, tuple[int, ...]]]:
    """The best sets of terms of which not all are known effects."""
    found: list[tuple[float, tuple[int, ...]]] = []
    for k in np.argsort(-scores):
        if len(found) >= kept:
            break
        if not all(known[i] for i in sets[k]):
            found.append((float(scores[k]), sets[k]))
    return found


def different(
    proposals: list[Proposal], similarity: float
) -> list[tuple[Proposal, list[Proposal]]]:
    """Group proposals that do the same to the data, the best of each group first.

    Parameters
    ----------
    proposals : list of Proposal
        The best first.
    similarity : float
        Cosine of two responses from which they are the same.

    Returns
    -------
    list of (Proposal, list of Proposal)
        Each group's first, and the others.
    """
    groups: list[tuple[Proposal, list[Proposal]]] = []
    for proposal in proposals:
        for first, others in groups:
            if float(first.signature @ proposal.signature) > similarity:
                others.append(proposal)
                break
        else:
            groups.append((proposal, []))
    return groups
