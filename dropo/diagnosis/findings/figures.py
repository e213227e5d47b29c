"""Gathers what the pictures of a diagnosis need from what its search and its tests have looked at
anyway.
"""

from collections.abc import Mapping

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
from dropo.diagnosis.findings.remaining import force_names
from dropo.diagnosis.findings.unexplained_forces import Unexplained, unexplained_force
from dropo.diagnosis.search.invariance import bins_of, differing, regimes, response_of
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.review import Review, ambiguity
from dropo.diagnosis.search.selection import FALSE_ALARM, Round, Selection, State, Trial, gain_of
from dropo.mjmodel.robot_simulator import RobotSimulator

TOP = 8  # effects in the similarity matrix
RESPONSE = "response to the effect"

SPEED = ("joint_damping", "joint_friction", "joint_stribeck", "joint_load_friction")
PLACE = ("joint_stiffness", "joint_cogging", "joint_limit", "gear_lash")
COMMAND = (
    "actuator_gain",
    "actuator_bias",
    "actuator_coupling",
    "actuator_saturation",
    "actuator_deadband",
    "actuator_torque_speed",
)
LATE = ("actuator_delay", "actuator_lag")


def figure_data(
    library: Library,
    selection: Selection,
    first: State,
    last: State,
    reviews: Mapping[str, Review],
    rest: Unexplained,
    count: int,
) -> FigureData:
    """rest: the forces that remain unexplained; count: how many effects were looked for."""
    before = (
        rest
        if first is last
        else unexplained_force(
            library, first.train, first.test, selection.floor, gain_of, rest.answers
        )
    )
    chosen = {instance.label: (instance, reviews[instance.label]) for instance in last.accepted}
    responses = [
        (instance, response_of(library, last.test, instance)) for instance in last.accepted
    ]
    return FigureData(
        float(np.log(count / FALSE_ALARM)),
        tuple(_bars(tried, last, chosen) for tried in selection.rounds),
        tuple(
            _against_axis(library, reviews[instance.label].without, last, instance, response)
            for instance, response in responses
        ),
        tuple(
            sizes
            for instance, response in responses
            for sizes in _sizes(library, last.test, instance, response)
        ),
        _forces(library, before, rest),
        _similarity(selection),
        tuple(_sums(last.test, instance, response) for instance, response in responses),
    )


def _bars(
    tried: Round, last: State, chosen: Mapping[str, tuple[EffectInstance, Review]]
) -> tuple[Bar, ...]:
    """The effects that a round refitted, and those that do the same as the accepted one; by what
    they gain.
    """
    label = next((name for name, (_, found) in chosen.items() if found.origin is tried), None)
    alike = (
        {}
        if label is None
        else {other.instance.label: other for _, other, _ in ambiguity(last, *chosen[label])}
    )
    bars = [_bar(trial, label, alike) for trial in tried.trials]
    named = {bar.label for bar in bars}
    bars += [Bar(name, None, None, False, False) for name in alike if name not in named]
    return tuple(
        sorted(bars, key=lambda bar: -np.inf if bar.gain is None else bar.gain, reverse=True)
    )


def _bar(trial: Trial, chosen: str | None, alike: Mapping[str, object]) -> Bar:
    label = trial.candidate.instance.label
    error = abs(trial.held_out / trial.z) if trial.z else None
    return Bar(label, trial.held_out, error, label == chosen, label not in alike)


def _against_axis(
    library: Library, without: State, last: State, instance: EffectInstance, response: Array
) -> AgainstAxis:
    before = without.test
    after = last.test
    p = len(after.whiten.sigma)
    simulator = library.simulator
    response = response[:, -p:]
    k = int(np.argmax(np.sum((response / after.whiten.sigma) ** 2, axis=0)))
    axis = own_axis(library, instance)
    found = regimes(after.windows, library)
    axis, x = (axis, found[axis]) if axis in found else (RESPONSE, response[:, k])
    units = {signal.name: signal.unit for signal in simulator.signals}
    good = ~(before.lost | after.lost)
    return AgainstAxis(
        instance.label,
        axis,
        units.get(axis, simulator.signals[k].unit if axis == RESPONSE else ""),
        simulator.signals[k].name,
        simulator.signals[k].unit,
        _numbers(x[good]),
        *(_numbers(linearized.residuals[good, -p:][:, k]) for linearized in (before, after)),
    )


def own_axis(library: Library, instance: EffectInstance) -> str | None:
    """The variable of `regimes` that an effect acts on: speed for damping, angle for a spring,
    command for a gain; None where there is no such one.
    """
    target = str(instance.target)
    if instance.effect in SPEED:
        return f"qvel.{target}"
    if instance.effect in PLACE:
        return f"qpos.{target}"
    if instance.effect in (*COMMAND, *LATE) and instance.target is not None:
        simulator = library.simulator
        names = simulator.action_names if isinstance(simulator, RobotSimulator) else []
        command = f"command {names.index(target)}" if target in names else ""
        return f"the change of {command}" if instance.effect in LATE else command
    if instance.effect in ("sensor_bias", "sensor_gain"):
        return target
    return {
        "parameter_drift": "time",
        "contact_friction": "contact",
        "contact_stiffness": "contact",
    }.get(instance.effect)


def _sizes(
    library: Library, linearized: LinearizedWindows, instance: EffectInstance, response: Array
) -> list[Sizes]:
    """By the effect's own axis, by the variable in which it differs most, and by time."""
    variables = regimes(linearized.windows, library)
    wanted = [own_axis(library, instance), differing(linearized, response, variables).variable, "time"]
    out = []
    for name in dict.fromkeys(one for one in wanted if one in variables):
        assert name is not None
        values = variables[name]
        found = differing(linearized, response, {name: variables[name]})
        at = [float(np.median(values[mask])) for mask in bins_of(values)]
        kept = [i for i, error in enumerate(found.errors) if error > 0]
        out.append(
            Sizes(
                instance.label,
                name,
                tuple(at[i] for i in kept),
                tuple(1 + found.sizes[i] for i in kept),
                tuple(found.errors[i] for i in kept),
                found.p_value,
            )
        )
    return out


def _forces(library: Library, first: Unexplained, rest: Unexplained) -> Forces:
    names, units = zip(*force_names(library), strict=True)
    return Forces(names, units, _numbers(first.sd), _numbers(rest.sd), first.present, rest.present)


def _similarity(selection: Selection) -> Similarity:
    first = selection.rounds[0].screened if selection.rounds else []
    top = [candidate for candidate in first if len(candidate.signature) == len(first[0].signature)][
        :TOP
    ]
    cosines = tuple(
        tuple(min(1.0, abs(float(one.signature @ two.signature))) for two in top) for one in top
    )
    return Similarity(tuple(candidate.instance.label for candidate in top), cosines)


def _sums(linearized: LinearizedWindows, instance: EffectInstance, response: Array) -> Sums:
    """Of the estimate's share in the residuals, window by window in the data's order."""
    slope = linearized.flat(response).reshape(len(linearized.windows), -1)
    rest = linearized.flat(linearized.residuals).reshape(len(linearized.windows), -1)
    order = np.argsort(linearized.windows.segments.steps[:, 0], kind="stable")
    score, weight = ((slope * one).sum(axis=1)[order] for one in (rest, slope))
    centred = score - score.sum() / max(float(weight.sum()), 1e-300) * weight
    bridge = np.cumsum(centred) / max(float(np.sqrt(np.sum(centred**2))), 1e-300)
    return Sums(
        instance.label, _numbers(np.arange(1, len(bridge) + 1) / len(bridge)), _numbers(bridge)
    )


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())
