"""Play between motor and joint."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.effects.support.play_operator import play
from dropo.mjmodel.forces import AFFINE_BIAS, motors
from dropo.mjmodel.joints import Joint, actuators


def gear_lash(context: EffectContext) -> Iterator[EffectInstance]:
    """Play in a joint's gear, with a rotor that has no inertia (the models of Nordin and Gutman
    2002, section 2, at their limits).

    Motor: where the play b is open, the rotor moves against its drag, c dx/dt = u, and nothing
    passes; where it is taken up on the side to which u pushes, all of u does. The force that passes
    is dP/dt, P the play operator of width I = b c on the integral of u: after each reversal an
    impulse I of the command is lost. The joint's own motion meanwhile is neglected, and a
    trajectory begins with the play taken up, so that the known commands alone decide.
    Position servo: the rotor stands where the command is, and the joint feels no spring within b /
    2 of it: F = k sign(e) max(|e| - b / 2, 0), e = u - gear q. Other actuators, and joints with
    several, are left out.
    """
    model = context.model
    reach = {actuator.id: actuator.largest_command for actuator in actuators(context.model)}
    for joint, ids in motors(model):
        i = ids[0]
        if len(ids) > 1 or model.actuator_actadr[i] >= 0:
            continue
        if not (
            model.actuator_biastype[i] == AFFINE_BIAS and np.any(model.actuator_biasprm[i, :3])
        ):
            unit = reach[i] * context.control_step
            size = Quantity(
                "impulse",
                "command s",
                0.0,
                10 * unit,
                (0.02 * unit, 0.2 * unit, unit),
                smooth=False,
            )
            yield EffectInstance("gear_lash", joint.name, (size,), actuation=partial(_lost, i))
        elif model.actuator_biasprm[i, 1] == -model.actuator_gainprm[i, 0]:
            size = Quantity("play", joint.length, 0.0, 0.5, (1e-3, 1e-2, 5e-2), smooth=False)
            yield EffectInstance(
                "gear_lash", joint.name, (size,), command_feedback=partial(_loose, joint, i)
            )


def _lost(place: int, commands: Array, step: float, magnitudes: Array) -> Array:
    out = commands.copy()
    column = commands[:, place]
    impulse = step * np.cumsum(column)
    first = column[np.flatnonzero(column)[:1]].sum()
    begin = -np.sign(first) * magnitudes[0] / 2
    out[:, place] = np.diff(play(impulse, float(magnitudes[0]), float(begin)), prepend=begin) / step
    return out


def _loose(joint: Joint, place: int, state: StepState, magnitudes: Array) -> Array:
    gear = float(state.model.actuator_gear[place, 0])
    out = state.ctrl.copy()
    at = gear * state.qpos[:, joint.qpos]
    error = out[:, place] - at
    out[:, place] = at + np.sign(error) * np.maximum(
        np.abs(error) - abs(gear) * magnitudes[0] / 2, 0
    )
    return out
