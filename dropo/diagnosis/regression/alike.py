"""Which other numbers have the same forces as one that was found, all others fitted again."""

from dataclasses import replace

import numpy as np

from dropo.core.services.validation import Array
from dropo.diagnosis.regression.fit import Fitter, Solution, weighted_squares
from dropo.diagnosis.regression.terms import INERTIAL
from dropo.diagnosis.search.plausibility import Plausibility

WORSE = 0.02
"""Fraction by which the spread of what is left may grow by an exchange for a likelier number."""

TOLD = 1e-6
"""Fraction of a column below which what is left of it is rounding."""

OF_A_PAYLOAD = 4
"""Numbers of a payload, its mass and its place, each of which has the price of Schwarz's criterion.
"""


def term_similarities(fitter: Fitter, solution: Solution, index: int) -> Array:
    """Compute the cosines of the forces of terms and of one of the numbers.

    Parameters
    ----------
    fitter : Fitter
        The equation and its K terms.
    solution : Solution
        The numbers, which are all projected out but for the one.
    index : int
        A term's index, or `GAIN`.

    Returns
    -------
    (K + 1,) array
        Of each term, and of the gain of all drives, which comes last; 0 of what is in the solution.
    """
    count = len(fitter.terms)
    # The gain's column comes last, so that GAIN is its index too.
    terms = fitter.columns_at(solution.delay, range(count))
    columns = np.concatenate([terms, fitter.equation.needed[:, :, None]], axis=2)
    columns = (columns * solution.weights[:, :, None]).reshape(-1, count + 1)
    others = [i for i in solution.chosen if i != index]
    basis = np.linalg.qr(columns[:, others])[0] if others else np.zeros((len(columns), 0))
    left = columns - basis @ (basis.T @ columns)
    size = np.linalg.norm(left, axis=0)
    size = np.where(size > 1e-6 * np.linalg.norm(columns, axis=0), size, np.inf)
    cosines = np.abs(left.T @ left[:, index]) / (size * size[index])
    cosines[list(solution.chosen)] = 0.0
    return np.asarray(cosines)


def payload_similarities(fitter: Fitter, solution: Solution, without: Solution) -> dict[int, float]:
    """Compare one of the numbers with a payload on each body in its place.

    Parameters
    ----------
    fitter : Fitter
        The equation.
    solution : Solution
        The numbers.
    without : Solution
        The same without the one, and without any payload.

    Returns
    -------
    dict of int to float
        By the body's place among the moving ones, the square root of what its payload explains as a
        fraction of what the number does: the cosine of their forces where both are linear. Bodies
        on which no payload explains anything are left out, and the payload's own.
    """
    without = fitter.refined(fitter.solve(without))
    present = weighted_squares(fitter.residuals(solution), solution.weights)
    explained = weighted_squares(fitter.residuals(without), solution.weights) - present
    found = {}
    for body in range(len(fitter.equation.by_inertia)):
        if solution.payload is not None and solution.payload.body == body:
            continue
        loaded = fitter.refined(fitter.solve(fitter.loaded(without, (body,))))
        if loaded.payload is None or not 0 < loaded.payload.mass < fitter.heaviest:
            continue
        lost = weighted_squares(fitter.residuals(loaded), solution.weights) - present
        if explained > 0 and lost < explained:
            found[body] = float(np.sqrt(min(1.0, 1.0 - lost / explained)))
    return found


def parts_of_payload(fitter: Fitter, solution: Solution) -> Array:
    """Compare terms with what a payload's mass and place can make up for together.

    A rotor at the only hinge, say, is a payload farther out.

    Parameters
    ----------
    fitter : Fitter
        The equation and its K terms.
    solution : Solution
        The numbers, a payload among them.

    Returns
    -------
    (K,) array
        The cosine of each term's force and the nearest that changes of the payload make, all other
        numbers fitted again; 0 of what is in the solution.
    """
    jacobian, _ = fitter.linearized(solution)
    weights = solution.weights[:, :, None]
    rows = (jacobian * weights).reshape(-1, jacobian.shape[2])
    payload = rows[:, -1 - OF_A_PAYLOAD : -1]
    others = np.delete(rows, range(rows.shape[1] - 1 - OF_A_PAYLOAD, rows.shape[1] - 1), axis=1)
    terms = fitter.columns_at(solution.delay, range(len(fitter.terms))) * weights
    columns = terms.reshape(len(rows), -1)
    left = _without_span(columns, others)
    rest = _without_span(left, _without_span(payload, others))
    size = np.linalg.norm(left, axis=0)
    told = size > TOLD * np.linalg.norm(columns, axis=0)
    share = np.divide(np.linalg.norm(rest, axis=0), size, out=np.ones(len(size)), where=told)
    cosines = np.sqrt(np.maximum(1.0 - share**2, 0.0))
    cosines[solution.terms] = 0.0
    return np.asarray(cosines)


def most_plausible(
    fitter: Fitter, solution: Solution, similarity: float, plausibility: Plausibility
) -> Solution:
    """Exchange numbers for those of the same forces that machines rather have.

    Parameters
    ----------
    fitter : Fitter
        The equation and its terms.
    solution : Solution
        The numbers.
    similarity : float
        Cosine of two forces above which data cannot tell them apart.
    plausibility : Plausibility
        How usual each effect is.

    Returns
    -------
    Solution
        The same where no term, and no payload, could be exchanged for a more usual number.
    """
    rows = float(fitter.equation.used.sum())
    # By the numbers as they were chosen: a mass that comes in a centre's place here is no payload.
    for i in [i for i in solution.terms if not _is_beside_mass(fitter, solution, i)]:
        odds = np.array([plausibility.of(term.effect) for term in fitter.terms])
        cosines = term_similarities(fitter, solution, i)[:-1]
        likelier = (cosines > similarity) & (odds > odds[i])
        order = np.lexsort((-cosines, -odds))
        for k in order[likelier[order]].tolist():
            chosen = tuple(k if one == i else one for one in solution.chosen)
            other = fitter.refined(fitter.solve(replace(solution, chosen=chosen)))
            free = other.sizes[k] > fitter.terms[k].lowest
            if free and fitter.badness(other) < fitter.badness(solution) + WORSE * rows:
                solution = other
                break
    if solution.payload is None:
        return solution
    return _without_payload(fitter, solution, plausibility)


def _without_payload(fitter: Fitter, solution: Solution, plausibility: Plausibility) -> Solution:
    """One more usual number in the place of a payload, if one leaves no more than that."""
    rows = float(fitter.equation.used.sum())
    best = solution
    saved = 0.5 * float(np.log(rows)) * (OF_A_PAYLOAD - 1)
    least = fitter.badness(solution) + WORSE * rows + saved
    for k, term in enumerate(fitter.terms):
        if k in solution.chosen or plausibility.of(term.effect) <= plausibility.of("payload"):
            continue
        begun = replace(solution, payload=None, chosen=(*solution.chosen, k))
        other = fitter.refined(fitter.solve(begun))
        if other.sizes[k] > term.lowest and fitter.badness(other) < least:
            best = other
            least = fitter.badness(other)
    return best


def _is_beside_mass(fitter: Fitter, solution: Solution, i: int) -> bool:
    """Whether a term is the centre or inertia of a body whose mass is among the numbers, too."""
    terms = fitter.terms
    heavy = {terms[k].target for k in solution.terms if terms[k].family == "mass"}
    return terms[i].family in INERTIAL and terms[i].target in heavy


def _without_span(columns: Array, of: Array) -> Array:
    """The columns (R, m) less what others (R, k) span; those next to 0 count for nothing."""
    size = np.linalg.norm(of, axis=0)
    kept = of[:, size > 0] / size[size > 0]
    basis, values, _ = np.linalg.svd(kept, full_matrices=False)
    basis = basis[:, values > TOLD]
    return np.asarray(columns - basis @ (basis.T @ columns))
