"""Summary of each accepted effect: its size with error, what it gained, what it cannot be told
from.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import norm

from dropo.core.contracts.effect import EffectInstance
from dropo.core.numerics.dependence import Units
from dropo.core.numerics.robust_covariance import sandwich
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.experiment import experiment
from dropo.diagnosis.parts import Alternative, Cause, Estimate, Suspect
from dropo.diagnosis.search.invariance import invariance, standing_out
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.refit import DEFAULTS as REFIT
from dropo.diagnosis.search.review import Review, ambiguity
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection, State, gain_by_block, gain_of

# effects in an ambiguity set for which an experiment is looked for; [s] that it may take
TOLD_APART = 2
PATIENCE = 600.0
LEAST_P = float(np.finfo(float).tiny)


def causes(
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    count: int,
    errors: Sequence[tuple[float, float]],
) -> tuple[Cause, ...]:
    """Summary of each accepted effect of the last state, in the order in which they were found.

    Parameters
    ----------
    library
        The simulator with every effect.
    last
        Where the search ended.
    reviews
        By effect, what became of it when it was evaluated again.
    count
        How many effects were looked for.
    errors
        For each accepted effect the error on held-out data after the windows' horizon without it
        and with it, in units of the motion.

    Returns
    -------
    tuple of Cause
        One of each accepted effect.
    """
    deviations = standard_errors(library, last) if last.accepted else np.zeros(0)
    pairs = zip(last.accepted, errors, strict=True)
    return tuple(
        _cause(library, last, instance, reviews[instance.label], count, deviations, *off)
        for instance, off in pairs
    )


def _cause(
    library: Library,
    last: State,
    instance: EffectInstance,
    found: Review,
    count: int,
    errors: Array,
    rmse_before: float,
    rmse_after: float,
) -> Cause:
    """The summary of one effect."""
    gain = gain_of(found.without.test, last.test)[0]
    steps = last.test.windows.steps
    blocks = gain_by_block(found.without.test, last.test)
    held = invariance(library, last.test, instance)
    return Cause(
        effect=instance.effect,
        target=instance.target,
        variant=instance.variant,
        estimate=estimate(library, last, instance, errors),
        p_value=p_of(gain, count),
        held_out_gain=gain / steps,
        held_out_gain_se=float(blocks.std(ddof=1) * np.sqrt(len(blocks)) / steps),
        rmse_before=rmse_before,
        rmse_after=rmse_after,
        confused_with=_alternatives(library, last, instance, found),
        acts_like=_shape(last, instance) if held.constant else held.variable,
    )


def _shape(last: State, instance: EffectInstance) -> str | None:
    """The angle that harmonics act on which are no multiples of the lowest: together they draw a
    shape that no effect stands for.
    """
    orders = [
        other.order
        for other in last.accepted
        if (other.effect, other.target) == (instance.effect, instance.target)
    ]
    return (
        f"qpos.{instance.target}"
        if instance.order and any(order % min(orders) for order in orders)
        else None
    )


def p_of(gain: float, count: int, z: float | None = None) -> float:
    """The p-value of the split likelihood-ratio test for all effects tried, and where that says
    less, of z by blocks.
    """
    p = min(1.0, count * float(np.exp(-max(gain, 0.0))))
    return max(p, LEAST_P, 0.0 if z is None else float(norm.sf(z)))


def _alternatives(
    library: Library, last: State, instance: EffectInstance, found: Review
) -> tuple[Alternative, ...]:
    """The other effects that the data cannot tell from it, why, and what to record to tell them."""
    alternatives = []
    for i, (own, other, why) in enumerate(ambiguity(last, instance, found)):
        tried = None
        if i < TOLD_APART:
            tried = experiment(library, last, instance, other.instance, other.sizes)
        regime = _difference(library, found.origin.before, own, other) if found.origin else None
        to_tell: str | None = None
        if tried is not None and tried.seconds < PATIENCE:
            to_tell = f"record {number(tried.seconds, 2)} s of {tried}"
        elif regime:
            to_tell = f"record more {regime}"
        effect = other.instance
        alternatives.append(Alternative(effect.effect, effect.target, effect.variant, why, to_tell))
    always = "the same in any recorded data"
    return (*alternatives, *(Alternative(name, None, "", always) for name in instance.alike))


def _difference(library: Library, before: State, one: Candidate, two: Candidate) -> str | None:
    """The regime in which two effects' responses differ most, in words."""
    a = one.signature
    b = two.signature
    rest = (a - (a @ b) * b).reshape(len(before.train.windows), -1)
    return standing_out(before.train.windows, library, (rest**2).sum(axis=1))


def estimate(
    library: Library, last: State, instance: EffectInstance, errors: Array
) -> dict[str, Estimate]:
    """By quantity: what is added, its standard error, the model's own number."""
    out = {}
    for place, quantity in zip(library.places[instance.label], instance.quantities, strict=True):
        error = float(errors[int(np.flatnonzero(last.free == place)[0])])
        value = float(last.theta[place])
        out[quantity.name] = Estimate(value, error, quantity.unit, quantity.base)
    return out


def standard_errors(library: Library, last: State, close: float = REFIT.close) -> Array:
    """(f,) of the free numbers, by the sandwich clustered by block; close: the fraction of the
    usual widths of differences that is taken where predictions bend within those.
    """
    errors = _sandwich(library, last, 1.0)
    # Errors far below the usual width of differences: predictions bend within it.
    bends = np.any(errors < close * library.steps[last.free])
    return _sandwich(library, last, close) if bends else errors


def _sandwich(library: Library, last: State, share: float) -> Array:
    """The same with slopes over so large a share of the usual width."""
    linearized = last.train
    free = last.free
    slopes = linearized.flat(library.jacobian(linearized.theta, free, linearized.windows, share)).reshape(
        len(free), len(linearized.windows), -1
    )
    rest = linearized.flat(linearized.residuals).reshape(len(linearized.windows), -1)
    scores = np.einsum("fwn,wn->wf", slopes, rest)
    information = np.einsum("fwn,gwn->fg", slopes, slopes)
    block = np.unique(linearized.windows.block, return_inverse=True)[1]
    units = Units(block, False, np.argsort(block, kind="stable"), "blocks")
    return np.sqrt(np.diagonal(sandwich(scores, information, units)[0]))


def suspects(selection: Selection, last: State, count: int) -> tuple[Suspect, ...]:
    """Effects of the last round that seemed to help and were not confirmed."""
    taken = {instance.label for instance in last.accepted}
    trials = selection.rounds[-1].trials if selection.rounds else []
    return tuple(
        Suspect(
            effect=trial.candidate.instance.effect,
            target=trial.candidate.instance.target,
            p_value=p_of(trial.held_out, count, trial.z),
            held_out_gain=trial.held_out / last.test.windows.steps,
        )
        for trial in trials
        if trial.held_out > 0 and trial.candidate.instance.label not in taken
    )
