"""Summary of each accepted effect: its magnitude with error, what it gained, and what it cannot be
distinguished from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
from dropo.diagnosis.search.selection import SETTINGS as SELECTION
from dropo.diagnosis.search.selection import (
    Selection,
    SelectionSettings,
    State,
    gain_by_block,
    gain_of,
)
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class CauseSettings:
    """How much is said of what a cause cannot be distinguished from.

    Attributes
    ----------
    experiments : int
        Alternatives of a cause for which an experiment is looked for.
    patience : float
        The longest experiment that is proposed [s].
    certain : float
        Where a search began with regression, an effect is a cause if its first magnitude is so many
        standard errors away from 0.
    common : float
        There, the fraction of a number that standard errors hold for what all numbers share, as a
        scale that a payload and the drives' gain leave open.
    """

    experiments: int = 2
    patience: float = 600.0
    certain: float = 3.0
    common: float = 0.02


SETTINGS = CauseSettings()


def causes(
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    count: int,
    errors: Sequence[tuple[float, float]],
    selection: SelectionSettings = SELECTION,
    settings: CauseSettings = SETTINGS,
    *,
    far_off: bool = False,
) -> tuple[Cause, ...]:
    """Summarize each accepted effect, in the order in which they were found.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.
    reviews : mapping of str to Review
        By effect, what became of it when it was evaluated again.
    count : int
        How many effects were looked for.
    errors : sequence of tuple of float
        For each accepted effect the error on held-out data after the windows' horizon without it
        and with it, in units of the motion.
    selection : SelectionSettings
        When two effects cannot be distinguished.
    settings : CauseSettings
        How much is said of alternatives.
    far_off : bool
        Whether the search began with regression. Standard errors then hold what the physics step
        makes of the numbers, and effects that they do not tell from nothing are left out.

    Returns
    -------
    tuple of Cause
        One of each accepted effect.
    """
    deviations = standard_errors(library, last) if last.accepted else np.zeros(0)
    if far_off and last.accepted:
        deviations = np.hypot(deviations, errors_of_step(library, last))
    found = []
    for instance, (before, after) in zip(last.accepted, errors, strict=True):
        estimates = estimate(library, last, instance, deviations)
        if far_off:
            estimates = {name: _wider(one, settings.common) for name, one in estimates.items()}
        first = next(iter(estimates.values()))
        if far_off and abs(first.value) < settings.certain * first.se:
            continue
        own = reviews[instance.label]
        gain = gain_of(own.without.test, last.test)[0]
        blocks = gain_by_block(own.without.test, last.test)
        steps = last.test.windows.steps
        regimes = invariance(library, last.test, instance)
        others = ambiguity(last, instance, own, selection)
        cause = Cause(
            effect=instance.effect,
            target=instance.target,
            variant=instance.variant,
            estimate=estimates,
            p_value=p_of(gain, count),
            held_out_gain=gain / steps,
            held_out_gain_se=float(blocks.std(ddof=1) * np.sqrt(len(blocks)) / steps),
            rmse_before=before,
            rmse_after=after,
            confused_with=_alternatives(library, last, instance, own, others, settings),
            acts_like=_shape(last, instance) if regimes.constant else regimes.variable,
        )
        found.append(cause)
    return tuple(found)


def _wider(found: Estimate, fraction: float) -> Estimate:
    """An estimate whose error holds a fraction of the whole number too."""
    whole = found.value + (found.model or 0.0)
    return replace(found, se=float(np.hypot(found.se, fraction * whole)))


def _shape(last: State, instance: EffectInstance) -> str | None:
    """The angle of a joint whose harmonics are no multiples of the lowest one.

    Together they draw a shape that no effect stands for.
    """
    if not instance.order:
        return None
    orders = [
        other.order
        for other in last.accepted
        if (other.effect, other.target) == (instance.effect, instance.target)
    ]
    lowest = min(orders)
    if any(order % lowest for order in orders):
        return f"qpos.{instance.target}"
    return None


def p_of(gain: float, count: int, z: float | None = None) -> float:
    """Return the p-value of the split likelihood-ratio test for all effects tried.

    Parameters
    ----------
    gain : float
        On windows held out [nats].
    count : int
        How many effects were tried.
    z : float, optional
        The gain in standard errors by block: the p-value is no smaller than its own.

    Returns
    -------
    float
        Between the smallest positive number and 1.
    """
    p_value = min(1.0, count * float(np.exp(-max(gain, 0.0))))
    of_z = 0.0 if z is None else float(norm.sf(z))
    return max(p_value, float(np.finfo(float).tiny), of_z)


def _alternatives(
    library: Library,
    last: State,
    instance: EffectInstance,
    found: Review,
    others: Sequence[tuple[Candidate, Candidate, str]],
    settings: CauseSettings,
) -> tuple[Alternative, ...]:
    """The effects that the data cannot distinguish from one, why, and what to record to do so."""
    alternatives = []
    for i, (own, other, why) in enumerate(others):
        proposed = None
        if i < settings.experiments:
            proposed = experiment(library, last, instance, other.instance, other.sizes)
        regime = None
        if found.origin is not None:
            regime = _difference(library, found.origin.before, own, other)
        to_tell: str | None = None
        if proposed is not None and proposed.seconds < settings.patience:
            to_tell = f"record {number(proposed.seconds, 2)} s of {proposed}"
        elif regime:
            to_tell = f"record more {regime}"
        effect = other.instance
        alternative = Alternative(effect.effect, effect.target, effect.variant, why, to_tell)
        alternatives.append(alternative)
    for name in instance.alike:
        alternatives.append(Alternative(name, None, "", "the same in any recorded data"))
    return tuple(alternatives)


def _difference(library: Library, before: State, one: Candidate, two: Candidate) -> str | None:
    """The regime in which two effects' responses differ most, in words."""
    first = one.signature
    second = two.signature
    windows = before.train.windows
    rest = (first - (first @ second) * second).reshape(len(windows), -1)
    return standing_out(windows, library, (rest**2).sum(axis=1))


def estimate(
    library: Library, last: State, instance: EffectInstance, errors: Array
) -> dict[str, Estimate]:
    """Return an effect's magnitudes with their errors.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.
    instance : EffectInstance
        One of its effects.
    errors : (f,) array
        Standard errors of the free numbers, as of `standard_errors`.

    Returns
    -------
    dict of str to Estimate
        By quantity: what is added, its standard error, the model's own number.
    """
    found = {}
    for place, quantity in zip(library.places[instance.label], instance.quantities, strict=True):
        index = int(np.flatnonzero(last.free == place)[0])
        value = float(last.theta[place])
        found[quantity.name] = Estimate(value, float(errors[index]), quantity.unit, quantity.base)
    return found


def standard_errors(library: Library, last: State, close: float = REFIT.close) -> Array:
    """Return standard errors of the fitted numbers, by the sandwich clustered by block.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        A model.
    close : float
        Fraction of the usual widths of differences that is taken where predictions are curved
        within those.

    Returns
    -------
    (f,) array
        In the numbers' units.
    """
    errors = _sandwich(library, last, 1.0)
    # Errors far below the usual width of differences: predictions are curved within it.
    curved = np.any(errors < close * library.steps[last.free])
    return _sandwich(library, last, close) if curved else errors


def errors_of_step(library: Library, last: State) -> Array:
    """Return how far the fitted numbers are off because physics steps are not short.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        A model.

    Returns
    -------
    (f,) array
        In the numbers' units. Predictions change when steps are halved; these are the changes of
        the numbers that make up for that, taken twice, since errors fall with the step.
    """
    train = last.train
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        return np.zeros(len(last.free))
    finer = simulator.with_finer_steps(2).predict(train.theta[None], train.windows.segments)
    change = np.nan_to_num(finer.reshape(train.residuals.shape) - train.predicted)
    rows = train.flat(library.jacobian(train.theta, last.free, train.windows))
    # Columns of one size, so that the least squares' cutoff means the same for all numbers.
    size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    moved = np.linalg.lstsq((rows / size[:, None]).T, train.flat(change), rcond=1e-6)[0]
    return np.asarray(2 * np.abs(moved / size))


def _sandwich(library: Library, last: State, fraction: float) -> Array:
    """Standard errors (f,) with differences over a fraction of the usual width."""
    train = last.train
    windows = train.windows
    free = last.free
    jacobian = library.jacobian(train.theta, free, windows, fraction)
    rows = train.flat(jacobian).reshape(len(free), len(windows), -1)
    residuals = train.flat(train.residuals).reshape(len(windows), -1)
    scores = np.einsum("fwn,wn->wf", rows, residuals)
    information = np.einsum("fwn,gwn->fg", rows, rows)
    block = np.unique(windows.block, return_inverse=True)[1]
    units = Units(block, False, np.argsort(block, kind="stable"), "blocks")
    covariance = sandwich(scores, information, units)[0]
    return np.sqrt(np.diagonal(covariance))


def suspects(selection: Selection, last: State, count: int) -> tuple[Suspect, ...]:
    """Return the effects of the last batch that seemed to help and were not confirmed.

    Parameters
    ----------
    selection : Selection
        The search.
    last : State
        Where it ended.
    count : int
        How many effects were looked for.

    Returns
    -------
    tuple of Suspect
    """
    accepted = {instance.label for instance in last.accepted}
    trials = selection.rounds[-1].trials if selection.rounds else []
    found = []
    for trial in trials:
        instance = trial.candidate.instance
        if not trial.held_out > 0 or instance.label in accepted:
            continue
        suspect = Suspect(
            effect=instance.effect,
            target=instance.target,
            p_value=p_of(trial.held_out, count, trial.z),
            held_out_gain=trial.held_out / last.test.windows.steps,
        )
        found.append(suspect)
    return tuple(found)
