"""What the figures of a diagnosis are drawn from: what its search has computed anyway."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.figure_data import (
    AgainstAxis,
    Bar,
    FigureData,
    Forces,
    Similarity,
    Sizes,
    Sums,
)
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.remains.remaining import force_names
from dropo.diagnosis.findings.remains.unexplained_forces import Unexplained, unexplained_force
from dropo.diagnosis.laws.curve import law_curve
from dropo.diagnosis.search.confirmation import SelectionSettings, gain_of
from dropo.diagnosis.search.invariance import (
    bins_of,
    command_change_variable,
    command_variable,
    differing,
    regimes,
    response_of,
    scores_by_window,
)
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.review import Review, ambiguity
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.trials import Batch, State, Trial
from dropo.mjmodel.robot_simulator import RobotSimulator

RESPONSE = "response to the effect"
"""The axis of effects that act on no variable of their own."""

ON_SPEED = ("joint_damping", "joint_friction", "joint_stribeck", "joint_load_friction")
ON_POSITION = ("joint_stiffness", "joint_cogging", "joint_limit", "gear_lash")
ON_COMMAND = (
    "actuator_gain",
    "actuator_bias",
    "actuator_coupling",
    "actuator_saturation",
    "actuator_deadband",
    "actuator_torque_speed",
)
ON_COMMAND_CHANGE = ("actuator_delay", "actuator_lag")
ON_SIGNAL = ("sensor_bias", "sensor_gain")
ON_OTHER = {
    "parameter_drift": "time",
    "contact_friction": "contact",
    "contact_stiffness": "contact",
}


@dataclass(frozen=True)
class FigureSettings:
    """How much figures show.

    Attributes
    ----------
    similar : int
        Effects in the matrix of similarities.
    """

    similar: int = 8


SETTINGS = FigureSettings()


def figure_data(
    library: Library,
    selection: Selection,
    first: State,
    last: State,
    reviews: Mapping[str, Review],
    rest: Unexplained,
    count: int,
    settings: FigureSettings = SETTINGS,
) -> FigureData:
    """Gather what the figures of a diagnosis show.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    selection : Selection
        The search.
    first, last : State
        The model as it is, and where the search ended.
    reviews : mapping of str to Review
        Of each accepted effect, by its label.
    rest : Unexplained
        The forces that remain unexplained.
    count : int
        How many effects were looked for.
    settings : FigureSettings
        How much is shown.

    Returns
    -------
    FigureData
    """
    # The unexplained forces of the model as it is; where it diverges, none are known.
    before = rest
    if first is not last and first.train.lost.mean() < 0.5:
        floor = selection.floor
        before = unexplained_force(library, first.train, first.test, floor, gain_of, rest.responses)

    # What each accepted effect does to the windows held out.
    axes = []
    sizes: list[Sizes] = []
    sums = []
    laws = []
    for instance in last.accepted:
        response = response_of(library, last.test, instance)
        without = reviews[instance.label].without
        axes.append(_against_axis(library, without, last, instance, response))
        sizes += _sizes(library, last.test, instance, response)
        sums.append(_sums(last.test, instance, response))
        if instance.formula and instance.force is not None:
            sizes_here = last.theta[library.indices_of[instance.label]]
            laws.append(law_curve(library, instance, sizes_here, without, selection.floor))

    chosen = {instance.label: (instance, reviews[instance.label]) for instance in last.accepted}
    rounds = [_bars(batch, last, chosen, selection.settings) for batch in selection.batches]
    return FigureData(
        needed=selection.settings.needed_gain(count),
        rounds=tuple(rounds),
        axes=tuple(axes),
        sizes=tuple(sizes),
        forces=_forces(library, before, rest),
        similarity=_similarity(selection, settings.similar),
        sums=tuple(sums),
        laws=tuple(laws),
    )


def _bars(
    batch: Batch,
    last: State,
    chosen: Mapping[str, tuple[EffectInstance, Review]],
    settings: SelectionSettings,
) -> tuple[Bar, ...]:
    """The effects that a batch refitted, and those like the one accepted from it, by their gain."""
    accepted: str | None = None
    ambiguous: list[str] = []
    for label, (instance, found) in chosen.items():
        if found.origin is batch:
            accepted = label
            others = ambiguity(last, instance, found, settings)
            ambiguous = [other.instance.label for _, other, _ in others]
            break
    bars = [_bar(trial, accepted, ambiguous) for trial in batch.trials]
    refitted = {bar.label for bar in bars}
    for name in ambiguous:
        if name not in refitted:
            bars.append(Bar(name, gain=None, error=None, accepted=False, told=False))
    bars.sort(key=lambda bar: -np.inf if bar.gain is None else bar.gain, reverse=True)
    return tuple(bars)


def _bar(trial: Trial, accepted: str | None, ambiguous: list[str]) -> Bar:
    """One refitted effect."""
    label = trial.candidate.instance.label
    error = abs(trial.held_out_gain / trial.z) if trial.z else None
    distinguishable = label not in ambiguous
    return Bar(label, trial.held_out_gain, error, label == accepted, distinguishable)


def _against_axis(
    library: Library, without: State, last: State, instance: EffectInstance, response: Array
) -> AgainstAxis:
    """Errors at the windows' ends over what an effect acts on, in the signal in which it shows."""
    before = without.test
    after = last.test
    sigma = after.whiten.sigma
    p = len(sigma)
    at_end = response[:, -p:]
    which = int(np.argmax(np.sum((at_end / sigma) ** 2, axis=0)))
    signals = library.simulator.signals
    signal = signals[which]

    # The axis: the effect's own where the windows have it, else its response.
    axis = own_axis(library, instance)
    variables = regimes(after.windows, library)
    if axis is not None and axis in variables:
        x = variables[axis]
        unit = {one.name: one.unit for one in signals}.get(axis, "")
    else:
        axis = RESPONSE
        x = at_end[:, which]
        unit = signal.unit

    good = ~(before.lost | after.lost)
    return AgainstAxis(
        label=instance.label,
        axis=axis,
        axis_unit=unit,
        signal=signal.name,
        unit=signal.unit,
        x=_numbers(x[good]),
        before=_numbers(before.residuals[good, -p:][:, which]),
        after=_numbers(after.residuals[good, -p:][:, which]),
    )


def own_axis(library: Library, instance: EffectInstance) -> str | None:
    """Return the variable that an effect acts on.

    Parameters
    ----------
    library : Library
        Its simulator names the actuators.
    instance : EffectInstance
        The effect.

    Returns
    -------
    str or None
        A name among `regimes`: speed for damping, angle for a spring, command for a gain. None
        where there is no such variable.
    """
    effect = instance.effect
    target = instance.target
    if effect in ON_SPEED:
        return f"qvel.{target}"
    if effect in ON_POSITION:
        return f"qpos.{target}"
    if effect in ON_SIGNAL:
        return str(target)
    if effect in ON_COMMAND or effect in ON_COMMAND_CHANGE:
        simulator = library.simulator
        actuators = simulator.action_names if isinstance(simulator, RobotSimulator) else []
        if target is None or target not in actuators:
            return None
        return command_variable(target) if effect in ON_COMMAND else command_change_variable(target)
    return ON_OTHER.get(effect)


def _sizes(
    library: Library, linearized: LinearizedWindows, instance: EffectInstance, response: Array
) -> list[Sizes]:
    """The magnitude by the effect's own axis, by the variable in which it differs most, by time."""
    variables = regimes(linearized.windows, library)
    worst = differing(linearized, response, variables).variable
    found = []
    for name in dict.fromkeys([own_axis(library, instance), worst, "time"]):
        if name is None or name not in variables:
            continue
        values = variables[name]
        test = differing(linearized, response, {name: values})
        medians = [float(np.median(values[mask])) for mask in bins_of(values)]
        bins = [
            (median, 1 + size, error)
            for median, size, error in zip(medians, test.sizes, test.errors, strict=True)
            if error > 0
        ]
        sizes = Sizes(
            label=instance.label,
            variable=name,
            at=tuple(median for median, _, _ in bins),
            size=tuple(size for _, size, _ in bins),
            error=tuple(error for _, _, error in bins),
            p_value=test.p_value,
        )
        found.append(sizes)
    return found


def _forces(library: Library, first: Unexplained, rest: Unexplained) -> Forces:
    """The unexplained forces before and after."""
    names, units = zip(*force_names(library), strict=True)
    return Forces(
        names=names,
        units=units,
        before=_numbers(first.sd),
        after=_numbers(rest.sd),
        there_before=first.present,
        there_after=rest.present,
    )


def _similarity(selection: Selection, count: int) -> Similarity:
    """The cosines between the effects that promised most at first."""
    screened = selection.batches[0].screened if selection.batches else []
    # Those that were screened on all windows have signatures of the same length.
    best = []
    for candidate in screened:
        if len(candidate.signature) == len(screened[0].signature):
            best.append(candidate)
    best = best[:count]
    cosines = []
    for one in best:
        row = [min(1.0, abs(float(one.signature @ two.signature))) for two in best]
        cosines.append(tuple(row))
    return Similarity(tuple(candidate.instance.label for candidate in best), tuple(cosines))


def _sums(linearized: LinearizedWindows, instance: EffectInstance, response: Array) -> Sums:
    """The scores of the magnitude, summed window by window in the data's order, as a bridge."""
    score, weight = scores_by_window(linearized, response)
    order = np.argsort(linearized.windows.segments.steps[:, 0], kind="stable")
    score = score[order]
    weight = weight[order]
    centred = score - score.sum() / max(float(weight.sum()), 1e-300) * weight
    bridge = np.cumsum(centred) / max(float(np.sqrt(np.sum(centred**2))), 1e-300)
    time = np.arange(1, len(bridge) + 1) / len(bridge)
    return Sums(instance.label, _numbers(time), _numbers(bridge))


def _numbers(values: Array) -> tuple[float, ...]:
    """Plain numbers."""
    return tuple(values.tolist())
