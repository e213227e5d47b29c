"""Play between motor and joint."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.effects.support.play_operator import play
from dropo.mjmodel.dynamics.forces import AFFINE_BIAS, motors
from dropo.mjmodel.joints import Joint, actuators


def gear_lash(context: EffectContext) -> Iterator[EffectInstance]:
    """Play in a joint's gear, behind a rotor without inertia.

    Actuators with states of their own, velocity servos and joints with several actuators are left
    out.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint with a motor, with I in units of its command times s, or with a position
        servo, with b in m or rad.

    Notes
    -----
    Motor: where the play b is open, the rotor moves against its drag, c dx/dt = u, and nothing
    passes; where it is closed on the side to which u pushes, all of u does. The force that passes
    is dP/dt, with P the play operator of width I = b c on the integral of u: after each reversal an
    impulse I of the command is lost. The joint's own motion meanwhile is neglected, and a
    trajectory begins with the play closed, so that the known commands alone decide.

    Position servo: the rotor stands where the command is, and the joint feels no spring within
    b / 2 of it: F = k sign(e) max(|e| - b / 2, 0), e = u - gear q.

    References
    ----------
    Nordin and Gutman 2002, Controlling mechanical systems with backlash, Automatica 38, section 2:
    the limits of the models there.
    """
    model = context.model
    largest = {actuator.id: actuator.largest_command for actuator in actuators(model)}
    for joint, ids in motors(model):
        i = ids[0]
        if len(ids) > 1 or model.actuator_actadr[i] >= 0:
            continue
        bias = model.actuator_biasprm[i, :3]
        feedback = model.actuator_biastype[i] == AFFINE_BIAS and np.any(bias)
        if not feedback:
            unit = largest[i] * context.control_step
            probes = (0.02 * unit, 0.2 * unit, unit)
            impulse = Quantity("impulse", "command s", 0.0, 10 * unit, probes, smooth=False)
            yield EffectInstance(
                "gear_lash", joint.name, (impulse,), actuation=partial(_lose_impulses, i)
            )
        elif bias[1] == -model.actuator_gainprm[i, 0]:
            width = Quantity("play", joint.length, 0.0, 0.5, (1e-3, 1e-2, 5e-2), smooth=False)
            yield EffectInstance(
                "gear_lash", joint.name, (width,), command_feedback=partial(_loosen, joint, i)
            )


def _lose_impulses(place: int, commands: Array, step: float, magnitudes: Array) -> Array:
    """The commands of a motor that pass the play, as mean forces over each physics step."""
    out = commands.copy()
    column = commands[:, place]
    impulse = step * np.cumsum(column)
    first = column[np.flatnonzero(column)[:1]].sum()
    begin = -np.sign(first) * magnitudes[0] / 2
    passed = play(impulse, float(magnitudes[0]), float(begin))
    out[:, place] = np.diff(passed, prepend=begin) / step
    return out


def _loosen(joint: Joint, place: int, state: StepState, magnitudes: Array) -> Array:
    """The commands of a position servo whose spring does not act within the play."""
    gear = float(state.model.actuator_gear[place, 0])
    half = abs(gear) * magnitudes[0] / 2
    out = state.ctrl.copy()
    position = gear * state.qpos[:, joint.qpos]
    error = out[:, place] - position
    out[:, place] = position + np.sign(error) * np.maximum(np.abs(error) - half, 0)
    return out
