"""Which effects do the same to the data as an accepted one, or one of its numbers, beside the rest.

What the rest of the set can take up does not tell two effects apart. So the cosine of two responses
is that of what is left of them when those to all other fitted numbers are projected out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.screening import (
    SMALLEST_LENGTH,
    Candidate,
    all_probes,
    project_out,
)
from dropo.diagnosis.search.trials import State


@dataclass(frozen=True)
class AliasSettings:
    """Which responses are compared.

    Attributes
    ----------
    nearly : float
        Cosine with an accepted effect, when that was accepted, from which another is compared again
        beside the rest of the set.
    most : int
        Effects that are compared with an accepted one, at most.
    batch : int
        Effects whose responses are held at once.
    """

    nearly: float = 0.9
    most: int = 6
    batch: int = 32


SETTINGS = AliasSettings()


def beside_the_rest(
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    settings: AliasSettings = SETTINGS,
) -> dict[str, Review]:
    """Compare accepted effects with others anew, where there are several.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.
    reviews : mapping of str to Review
        By the label of each accepted effect.
    settings : AliasSettings
        Which responses are compared.

    Returns
    -------
    dict of str to Review
        With `similar`, by simulations of the windows to fit: two for each number of the set, one
        for each effect, and one for each that is compared.
    """
    found = dict(reviews)
    if len(last.accepted) < 2:
        return found
    jacobian: Array | None = None
    for instance in last.accepted:
        own = reviews[instance.label]
        others = _others(last, instance, own, settings)
        if not others:
            continue
        if jacobian is None:
            jacobian = last.train.flat(
                library.kept_jacobian(last.theta, last.free, last.train.windows)
            )
        similar = _similar(library, last, instance, others, jacobian)
        found[instance.label] = replace(own, similar=similar)
    return found


def beside_numbers(
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    compared: Sequence[EffectInstance],
    others: Sequence[EffectInstance],
    alike: float,
    settings: AliasSettings = SETTINGS,
) -> dict[str, Review]:
    """Compare each number of accepted effects with other effects.

    A spring with a load is one without, beside an offset of its drive.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.
    reviews : mapping of str to Review
        By the label of each accepted effect.
    compared : sequence of EffectInstance
        The accepted effects whose numbers are compared.
    others : sequence of EffectInstance
        The effects that they are compared with, which are not accepted.
    alike : float
        Cosine from which two are alike.
    settings : AliasSettings
        How many are simulated at once.

    Returns
    -------
    dict of str to Review
        With `others`, by a simulation of the windows to fit for each other effect.
    """
    found = dict(reviews)
    indices_of = library.indices_of
    if not compared:
        return found
    train = last.train
    jacobian = train.flat(library.kept_jacobian(last.theta, last.free, train.windows))
    single = {one.label for one in compared if len(one.quantities) == 1}
    own = {}
    for instance in compared:
        for quantity, index in zip(instance.quantities, indices_of[instance.label], strict=True):
            basis = _basis(jacobian[last.free != index])
            row = _directions(jacobian[last.free == index], basis)[0]
            own[instance.label, quantity.name] = row, basis
    for start in range(0, len(others), settings.batch):
        batch = others[start : start + settings.batch]
        thetas = np.repeat(last.theta[None], len(batch), axis=0)
        for theta, other in zip(thetas, batch, strict=True):
            theta[indices_of[other.label]] = all_probes(other)[0][0]
        changes = train.flat(
            np.nan_to_num(library.predict(thetas, train.windows) - train.predicted)
        )
        for (label, name), (row, basis) in own.items():
            cosines = np.abs(_directions(changes, basis) @ row)
            its = "" if label in single else f"in the place of its {name}: "
            more = tuple(
                (other, f"{its}similarity {cosine:.3f} beside the rest")
                for other, cosine in zip(batch, cosines.tolist(), strict=True)
                if cosine > alike
            )
            found[label] = replace(found[label], others=found[label].others + more)
    return found


def _others(
    last: State, instance: EffectInstance, own: Review, settings: AliasSettings
) -> list[Candidate]:
    """What is compared with an effect: what was tried in its place, and what is nearly the same."""
    found = {trial.candidate.instance.label: trial.fitted_candidate for trial in own.alternatives}
    screened = [] if own.origin is None else own.origin.screened
    itself = next((one for one in screened if one.instance.label == instance.label), None)
    for candidate in screened:
        if itself is None:
            break
        if abs(float(candidate.signature @ itself.signature)) > settings.nearly:
            found.setdefault(candidate.instance.label, candidate)
    accepted = {one.label for one in last.accepted}
    left = [candidate for label, candidate in found.items() if label not in accepted]
    return left[: settings.most]


def _similar(
    library: Library,
    last: State,
    instance: EffectInstance,
    others: Sequence[Candidate],
    jacobian: Array,
) -> dict[str, float]:
    """By its label, the cosine of each other effect's response with that of one that is accepted.

    jacobian: (f, N) whitened, by all fitted numbers.
    """
    indices_of = library.indices_of
    train = last.train
    without = last.theta.copy()
    without[indices_of[instance.label]] = 0.0
    thetas = [without]
    for other in others:
        theta = without.copy()
        theta[indices_of[other.instance.label]] = other.magnitudes
        thetas.append(theta)
    predicted = library.predict(np.array(thetas), train.windows)
    changes = np.concatenate([(train.predicted - predicted[0])[None], predicted[1:] - predicted[0]])
    basis = _basis(jacobian[~np.isin(last.free, indices_of[instance.label])])
    rows = _directions(train.flat(np.nan_to_num(changes)), basis)
    cosines = np.abs(rows[1:] @ rows[0])
    labels = [other.instance.label for other in others]
    return dict(zip(labels, cosines.tolist(), strict=True))


def _basis(rest: Array) -> Array | None:
    """An orthonormal basis (N, k) of responses (k, N); None of none."""
    return np.linalg.qr(rest.T)[0] if len(rest) else None


def _directions(rows: Array, basis: Array | None) -> Array:
    """What is left of responses (K, N) beside a basis, each of length 1."""
    left = project_out(rows, basis)
    return left / np.maximum(np.linalg.norm(left, axis=1), SMALLEST_LENGTH)[:, None]
