"""Summary of each accepted effect: its magnitude with error, what it gained, and what it cannot be
distinguished from.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from dropo.core.contracts.effect import EffectInstance
from dropo.core.numerics.robust_covariance import few_units_sandwich
from dropo.core.numerics.tails import student_tail
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.limits.experiment import Experiment, experiments
from dropo.diagnosis.findings.limits.scale_of_forces import UntoldScale
from dropo.diagnosis.laws.discovery import FoundLaw
from dropo.diagnosis.laws.forces import step_errors
from dropo.diagnosis.parts import (
    Alternative,
    Cause,
    Estimate,
    Leader,
    Stability,
    Suspect,
    effect_in_words,
)
from dropo.diagnosis.search.confirmation import SETTINGS as SELECTION
from dropo.diagnosis.search.confirmation import SelectionSettings, gain_by_block, gain_of
from dropo.diagnosis.search.invariance import invariance, standing_out
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.refit import DEFAULTS as REFIT
from dropo.diagnosis.search.review import Review, ambiguity
from dropo.diagnosis.search.screening import Candidate
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import State
from dropo.mjmodel.options import physics_step
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
    """

    experiments: int = 2
    patience: float = 600.0


SETTINGS = CauseSettings()
NO_LAWS: Mapping[str, FoundLaw] = {}
"""Where none was looked for."""

OF_STEPS = 0.25
"""Fraction of what a model's own physics steps change that is part of the errors in exact ones."""
OF_OWN_STEPS = 2 / 3
"""Fraction of what infinitely short ones would change that is part of the errors in the model's
own: a machine has no steps, and the data do not tell them from its."""


def causes(
    library: Library,
    last: State,
    reviews: Mapping[str, Review],
    count: int,
    errors: Sequence[tuple[float, float]],
    selection: SelectionSettings = SELECTION,
    settings: CauseSettings = SETTINGS,
    *,
    known: Array | None = None,
    named: Collection[str] | None = None,
    again: Callable[[EffectInstance, Review, Collection[Alternative]], Stability | None]
    | None = None,
    laws: Mapping[str, FoundLaw] = NO_LAWS,
    scales: Sequence[UntoldScale] = (),
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
    known : (m,) array, optional
        Standard errors of all numbers, where they were found elsewhere.
    named : collection of str, optional
        The labels of the effects that are causes; all if None.
    again : callable, optional
        Tries a cause on other windows, as `stability` does.
    laws : mapping of str to FoundLaw
        What is said of laws that were found, by label.
    scales : sequence of UntoldScale
        What numbers are told only together, which is part of their errors.

    Returns
    -------
    tuple of Cause
        One of each accepted effect.
    """
    deviations = known
    degrees = np.full(len(last.theta), np.inf)
    if deviations is None:
        deviations = np.zeros(len(last.theta))
        if last.accepted:
            deviations[last.free], degrees[last.free] = standard_errors(library, last)
        for scale in scales:
            deviations[last.free] = np.hypot(deviations[last.free], scale.changes)
    found = []
    for instance, (before, after) in zip(last.accepted, errors, strict=True):
        if named is not None and instance.label not in named:
            continue
        own = reviews[instance.label]
        gain, _ = gain_of(own.without.test, last.test)
        blocks = gain_by_block(own.without.test, last.test)
        steps = last.test.windows.steps
        regimes = invariance(library, last.test, instance)
        others = ambiguity(last, instance, own, selection)
        alternatives = _alternatives(library, last, instance, own, others, settings)
        law = laws.get(instance.label)
        if law is not None:
            alternatives += tuple(
                Alternative("law", one.target, "", one.why, formula=one.formula)
                for one in law.others
            )
        shape = _shape(last, instance) or (None if law is None else law.curve or None)
        sizes = estimate(library, last, instance, deviations, degrees)
        cause = Cause(
            effect=instance.effect,
            target=instance.target,
            variant=instance.variant,
            estimate=sizes,
            p_value=p_of_sizes(list(sizes.values()), count),
            held_out_gain=gain / steps,
            held_out_gain_se=float(blocks.std(ddof=1) * np.sqrt(len(blocks)) / steps),
            rmse_before=before,
            rmse_after=after,
            confused_with=alternatives,
            acts_like=shape if regimes.constant else regimes.variable,
            stability=None if again is None else again(instance, own, alternatives),
            formula=instance.formula,
            called="" if law is None else law.called,
        )
        found.append(cause)
    return tuple(found)


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


def p_of_sizes(sizes: Sequence[Estimate], count: int) -> float:
    """Return the p-value of an effect by its sizes, from the errors that their intervals have.

    By Student's t with the standard errors and degrees of freedom of the estimates: the smallest of
    the two-sided ones that a size is 0, times the number of sizes and of the effects tried
    (Bonferroni). So it is above 0.05 wherever the 95 % intervals of all sizes contain 0.

    Parameters
    ----------
    sizes : sequence of Estimate
        Of one effect; those without a standard error say nothing.
    count : int
        How many effects were tried.

    Returns
    -------
    float
        Between the smallest positive number and 1; 1 where no size has a standard error.
    """
    smallest = 1.0
    for size in sizes:
        if size.se > 0:
            t = abs(size.value) / size.se
            smallest = min(smallest, 2 * float(student_tail(t, size.degrees)))
    return min(1.0, max(count * len(sizes) * smallest, float(np.finfo(float).tiny)))


def p_of(gain: float, count: int, z: float, blocks: int) -> float:
    """Return the p-value of the gain on windows held out of an effect that was not confirmed.

    Student's t of the mean gain of a block, times the number of effects tried (Bonferroni), but no
    less than that number times exp(-gain): what was gained hardly is not there for certain.

    Parameters
    ----------
    gain : float
        On windows held out [nats].
    count : int
        How many effects were tried.
    z : float
        The gain in standard errors by block.
    blocks : int
        How many blocks there are.

    Returns
    -------
    float
        Between the smallest positive number and 1.
    """
    of_gain = count * float(np.exp(-max(gain, 0.0)))
    of_blocks = count * float(student_tail(z, max(blocks - 1, 1)))
    return min(1.0, max(of_gain, of_blocks, float(np.finfo(float).tiny)))


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
    tried = [(other.instance, other.magnitudes) for _, other, _ in others[: settings.experiments]]
    found_motions = experiments(library, last, instance, tried)
    for i, (own, other, why) in enumerate(others):
        proposed = found_motions[i] if i < len(tried) else None
        regime = None
        if found.origin is not None:
            regime = _difference(library, found.origin.before, own, other)
        to_tell: str | None = None
        patience = settings.patience
        if proposed is not None and min(proposed.seconds, proposed.more_seconds) < patience:
            to_tell = _proposal(proposed, instance, other.instance)
        elif regime:
            to_tell = f"record more {regime}"
        effect = other.instance
        alternative = Alternative(effect.effect, effect.target, effect.variant, why, to_tell)
        alternatives.append(alternative)
    listed = {(other.effect, other.target) for other in alternatives}
    for one, why in found.others:
        place = (one.effect, one.target)
        if place not in listed and place != (instance.effect, instance.target):
            alternatives.append(Alternative(*place, one.variant, why))
    for name in instance.alike:
        alternatives.append(Alternative(name, None, "", "the same in any recorded data"))
    return tuple(alternatives)


def _proposal(proposed: Experiment, one: EffectInstance, other: EffectInstance) -> str:
    """What to record, and by how much that tells two effects apart."""
    places = [effect_in_words(each.effect, each.target, each.variant) for each in (one, other)]
    if not proposed.is_better:
        seconds = number(proposed.more_seconds, 2)
        nats = number(proposed.settings.distinct, 2)
        return (
            f"record {seconds} s more of motion like the recorded (no smooth motion within the "
            f"limits tells more); that tells {places[0]} from {places[1]} by about {nats} nats"
        )
    nats = number(proposed.times * proposed.nats, 2)
    return f"record this: {proposed}; that tells {places[0]} from {places[1]} by about {nats} nats"


def _difference(library: Library, before: State, one: Candidate, two: Candidate) -> str | None:
    """The regime in which two effects' responses differ most, in words."""
    first = one.signature
    second = two.signature
    windows = before.train.windows
    rest = (first - (first @ second) * second).reshape(len(windows), -1)
    return standing_out(windows, library, (rest**2).sum(axis=1))


def estimate(
    library: Library,
    last: State,
    instance: EffectInstance,
    errors: Array,
    degrees: Array | None = None,
) -> dict[str, Estimate]:
    """Return an effect's magnitudes with their errors.

    A simulation acts up to half a physics step early, which no data tell from a time by which
    commands are late: the error of such a time has the root mean square of that.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.
    instance : EffectInstance
        One of its effects.
    errors : (m,) array
        Standard errors of all numbers.
    degrees : (m,) array, optional
        Degrees of freedom of these.

    Returns
    -------
    dict of str to Estimate
        By quantity: what is added, its standard error, the model's own number.
    """
    found = {}
    simulator = library.simulator
    step = physics_step(simulator.model) if isinstance(simulator, RobotSimulator) else 0.0
    early = step / np.sqrt(12)
    of_commands = instance.command is not None or instance.actuation is not None
    indices = library.indices_of[instance.label]
    for index, quantity in zip(indices, instance.quantities, strict=True):
        value = float(last.theta[index])
        error = float(errors[index])
        if quantity.unit == "s" and of_commands:
            error = float(np.hypot(error, early))
        freedom = np.inf if degrees is None else float(degrees[index])
        found[quantity.name] = Estimate(value, error, quantity.unit, quantity.base, freedom)
    return found


def standard_errors(
    library: Library, last: State, close: float = REFIT.close
) -> tuple[Array, Array]:
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
    errors : (f,) array
        In the numbers' units. What the data do not tell is anywhere within its bounds. Where the
        model's own physics steps were found to be too coarse, what the data leave of a quarter of
        what they would change is part of the errors: another simulation is not exact either. Where
        the data do not tell them from infinitely short ones, two thirds of what these would change
        are, times the square root of the probability of such: the intervals hold the numbers of a
        machine and of a simulation.
    degrees : (f,) array
        Degrees of freedom of each.
    """
    covariance, degrees = _covariance(library, last, close)
    return np.sqrt(np.diagonal(covariance)), degrees


def covariance_of(library: Library, last: State, close: float = REFIT.close) -> Array:
    """Return the covariance of the fitted numbers.

    Parameters
    ----------
    library, last, close
        As of `standard_errors`.

    Returns
    -------
    (f, f) array
        With the errors of `standard_errors`.
    """
    covariance, _ = _covariance(library, last, close)
    return covariance


def _covariance(library: Library, last: State, close: float) -> tuple[Array, Array]:
    """The covariance (f, f) and its degrees (f,), no error larger than the number's interval."""
    covariance, degrees = _sandwich(library, last, 1.0)
    # Errors far below the usual width of differences: predictions are curved within it.
    if np.any(np.sqrt(np.diagonal(covariance)) < close * library.steps[last.free]):
        covariance, degrees = _sandwich(library, last, close)
    space = library.simulator.space
    width = (space.high - space.low)[last.free]
    told = np.isfinite(np.diagonal(covariance))
    covariance = np.where(np.outer(told, told), covariance, np.diag(width**2))
    errors = np.sqrt(np.diagonal(covariance))
    kept = np.divide(width, errors, out=np.ones(len(width)), where=errors > width)
    return covariance * np.outer(kept, kept), np.where(told, degrees, np.inf)


def _sandwich(library: Library, last: State, fraction: float) -> tuple[Array, Array]:
    """The covariance (f, f) and its degrees (f,), with differences over a fraction of the width."""
    train = last.train
    windows = train.windows
    free = last.free
    jacobian = library.jacobian(train.theta, free, windows, fraction)
    rows = train.flat(jacobian).reshape(len(free), len(windows), -1)
    residuals = train.flat(train.residuals).reshape(len(windows), -1)
    names, block = np.unique(windows.block, return_inverse=True)
    scores = np.zeros((len(names), len(free)))
    np.add.at(scores, block, np.einsum("fwn,wn->wf", rows, residuals))
    information = np.zeros((len(names), len(free), len(free)))
    np.add.at(information, block, np.einsum("fwn,gwn->wfg", rows, rows))
    covariance, degrees = few_units_sandwich(scores, information)
    drift = _drift_of_steps(library, train, rows.reshape(len(free), -1))
    return covariance + np.outer(drift, drift), degrees


def _drift_of_steps(library: Library, train: LinearizedWindows, rows: Array) -> Array:
    """The errors (f,) of numbers by the length of physics steps.

    rows: (f, N) the whitened responses to the numbers.
    """
    if train.defect is not None:
        return _drift_of_exact_steps(train, train.flat(train.defect), rows)
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator) or simulator.control_step is None:
        return np.zeros(len(rows))
    change = step_errors(simulator, train)
    change[train.lost] = 0.0
    changed = train.flat(change)
    drift = np.linalg.lstsq(rows.T, changed)[0]
    # What the numbers do not make up for speaks for the model's own steps, or against them.
    left = changed - drift @ rows
    residuals = train.flat(train.residuals)
    loss = 0.5 * float((residuals - left) @ (residuals - left) - residuals @ residuals)
    return np.asarray(OF_OWN_STEPS * np.sqrt(expit(-loss)) * drift)


def _drift_of_exact_steps(train: LinearizedWindows, change: Array, rows: Array) -> Array:
    """The errors (f,) of numbers by how far from exact the steps of the machine may be.

    change (N,): what exact steps change, whitened. A priori OF_STEPS of it are missing; what the
    numbers do not make up for tells how much, by a score clustered by block.
    """
    drift = np.linalg.lstsq(rows.T, change)[0]
    count = len(train.windows)
    left = (change - drift @ rows).reshape(count, -1)
    residuals = train.flat(train.residuals).reshape(count, -1)
    _, block = np.unique(train.windows.block, return_inverse=True)
    scores = np.bincount(block, np.einsum("wn,wn->w", left, residuals))
    information = float(np.sum(left**2))
    # Of the score: no less than that of independent errors.
    variance = max(information, float(scores @ scores))
    told = information**2 / variance if variance > 0 else 0.0
    apriori = OF_STEPS**-2
    missing = float(scores.sum()) * information / variance / (apriori + told) if told else 0.0
    return np.asarray(np.sqrt(missing**2 + 1 / (apriori + told)) * drift)


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
    trials = selection.batches[-1].trials if selection.batches else []
    blocks = len(np.unique(last.test.windows.block))
    found = []
    for trial in trials:
        instance = trial.candidate.instance
        if not trial.held_out_gain > 0 or instance.label in accepted:
            continue
        suspect = Suspect(
            effect=instance.effect,
            target=instance.target,
            p_value=p_of(trial.held_out_gain, count, trial.z, blocks),
            held_out_gain=trial.held_out_gain / last.test.windows.steps,
        )
        found.append(suspect)
    return tuple(found)


def leaders(selection: Selection, last: State, effects: int, most: int = 3) -> tuple[Leader, ...]:
    """Return the effects that would gain enough, and of which the data held out are not sure.

    Parameters
    ----------
    selection : Selection
        The search.
    last : State
        Where it ended.
    effects : int
        How many were looked for.
    most : int
        How many are returned at most.

    Returns
    -------
    tuple of Leader
        Of the batches that the last model began; the one with the largest gain first.
    """
    settings = selection.settings
    needed = settings.needed_gain(effects)
    accepted = {instance.label for instance in last.accepted}
    found = []
    for batch in selection.batches:
        if {instance.label for instance in batch.before.accepted} != accepted:
            continue
        for trial in batch.trials:
            instance = trial.candidate.instance
            is_considered = trial.fitted_gain > settings.minimum_fitted_gain
            if not (is_considered and trial.held_out_gain > needed):
                continue
            error = trial.held_out_gain / trial.z if trial.z > 0 else float("inf")
            found.append(
                Leader(
                    effect=instance.effect,
                    target=instance.target,
                    variant=instance.variant,
                    gain=trial.held_out_gain,
                    gain_se=error,
                    times=float((settings.window_z * error / trial.held_out_gain) ** 2),
                )
            )
    by_label = {(leader.effect, leader.target, leader.variant): leader for leader in found}
    return tuple(sorted(by_label.values(), key=lambda leader: -leader.gain)[:most])
