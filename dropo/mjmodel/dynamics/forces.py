"""The forces of a model's actuators at its joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import StepState
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import Actuator, Joint, actuators
from dropo.mjmodel.tendons import tendon_coefficients

FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
AFFINE = int(mujoco.mjtGain.mjGAIN_AFFINE)
CONTACT_ROWS = tuple(
    int(kind)
    for kind in (
        mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS,
        mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL,
        mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC,
    )
)
"""The kinds of constraints that are contacts."""
NO_BIAS = int(mujoco.mjtBias.mjBIAS_NONE)
AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_AFFINE)


def motors(model: mujoco.MjModel) -> list[tuple[Joint, list[int]]]:
    """List the slides and hinges driven by actuators whose force is known from the state.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (Joint, list of int)
        Each joint with the ids of its actuators for which `motor_force` holds.
    """
    known_laws = _have_known_law(model)
    found: dict[int, tuple[Joint, list[int]]] = {}
    for actuator in actuators(model):
        joint = actuator.joint
        if joint is None or joint.kind not in ("slide", "hinge"):
            continue
        if known_laws[actuator.id]:
            found.setdefault(joint.id, (joint, []))[1].append(actuator.id)
    return list(found.values())


def _have_known_law(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """(nu,) whether an actuator's force is known from its length, speed and command."""
    gain = np.isin(model.actuator_gaintype, (FIXED, AFFINE))
    return gain & np.isin(model.actuator_biastype, (NO_BIAS, AFFINE_BIAS))


def force_limit(model: mujoco.MjModel, ids: Sequence[int]) -> float:
    """Find the largest force of a joint's motors.

    Parameters
    ----------
    model : MjModel
        The model.
    ids : sequence of int
        Numbers of the motors, as `motors` gives them.

    Returns
    -------
    float
        Of all together at the joint [N or N m]; infinite where one of them has no limit.
    """
    if not all(model.actuator_forcelimited[i] for i in ids):
        return np.inf
    reach = 0.0
    for i in ids:
        ratio = abs(float(model.actuator_gear[i, 0]))
        reach += ratio * float(np.abs(model.actuator_forcerange[i]).min())
    return reach


def motor_force(state: StepState, joint: Joint, ids: Sequence[int]) -> Array:
    """Compute the generalised force of a joint's actuators as MuJoCo does: gear (gain u + bias).

    Parameters
    ----------
    state : StepState
        n simulations at one physics step.
    joint : Joint
        A slide or hinge.
    ids : sequence of int
        The actuators, of the kinds that `motors` finds.

    Returns
    -------
    (n,) array
        [N or N m]
    """
    model = state.model
    position = state.qpos[:, joint.qpos]
    velocity = state.qvel[:, joint.qvel]
    total = np.zeros(len(position))
    for i in ids:
        gain, bias = _gain_and_bias(model, i, position, velocity)
        force = gain * _input_of(state, i) + bias
        if model.actuator_forcelimited[i]:
            force = _within(force, model.actuator_forcerange[i])
        total += float(model.actuator_gear[i, 0]) * force
    return total


def _gain_and_bias(
    model: mujoco.MjModel, i: int, position: Array, velocity: Array
) -> tuple[Array | float, Array | float]:
    """Gain and bias (n,) of the law of actuator i before its gear, at n states of its joint."""
    gear = float(model.actuator_gear[i, 0])
    gain = float(model.actuator_gainprm[i, 0])
    bias = 0.0
    if model.actuator_gaintype[i] == AFFINE:
        gain = _affine(model.actuator_gainprm[i], gear * position, gear * velocity)
    if model.actuator_biastype[i] == AFFINE_BIAS:
        bias = _affine(model.actuator_biasprm[i], gear * position, gear * velocity)
    return gain, bias


def _affine(numbers: Array, position: Array, velocity: Array) -> Any:
    """The affine law (n,) of an actuator at n states."""
    constant, stiffness, damping = numbers[:3].tolist()
    return constant + stiffness * position + damping * velocity


def _input_of(state: StepState, i: int) -> Array:
    """(n,) what actuator i multiplies by its gain: its last activation, or its clamped command."""
    model = state.model
    activation = int(model.actuator_actadr[i])
    if activation >= 0:
        return state.act[:, activation + int(model.actuator_actnum[i]) - 1]
    if model.actuator_ctrllimited[i]:
        return _within(state.ctrl[:, i], model.actuator_ctrlrange[i])
    return state.ctrl[:, i]


def _within(values: Array, limits: Array) -> Array:
    """Values within limits; quicker than `np.clip` where they are few."""
    low, high = limits.tolist()
    return np.minimum(np.maximum(values, low), high)


def joint_loads(model: mujoco.MjModel, state: StepState, contacts: bool) -> Array:
    """Compute the forces that joints carry: of gravity and inertia, or of contacts.

    Parameters
    ----------
    model : MjModel
        The model as it is simulated.
    state : StepState
        n simulations at one physics step.
    contacts : bool
        Whether forces of contacts are meant; else the bias forces of gravity and velocity.

    Returns
    -------
    (n, nv) array
        Generalised forces [N or N m].
    """
    data = mujoco.MjData(model)
    found = np.zeros_like(state.qvel)
    for i in range(len(found)):
        data.qpos[:] = state.qpos[i]
        data.qvel[:] = state.qvel[i]
        data.ctrl[:] = state.ctrl[i]
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(model, data)
        if not contacts:
            found[i] = data.qfrc_bias
        elif data.nefc:
            rows = np.isin(data.efc_type, CONTACT_ROWS)
            forces = np.where(rows, data.efc_force, 0.0)
            mujoco.mj_mulJacTVec(model, data, found[i], forces)
    return found


def torque_scale(model: mujoco.MjModel, joint: Joint) -> float:
    """Estimate the size of the forces at a slide or hinge.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    joint : Joint
        A slide or hinge.

    Returns
    -------
    float
        The largest force of its actuators, at least the force that moves it by 10 m/s^2 or rad/s^2
        [N or N m].
    """
    sizes = [10.0 * float(model.dof_M0[joint.qvel])]
    for actuator in actuators(model):
        if actuator.joint is not None and actuator.joint.id == joint.id:
            sizes.append(force_per_command(model, actuator.id) * actuator.largest_command)
    return max(sizes)


def force_per_command(model: mujoco.MjModel, actuator: int) -> float:
    """Return the size of an actuator's force for a command of 1.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    actuator : int
        Its number.

    Returns
    -------
    float
        In N or N m.
    """
    gear = float(model.actuator_gear[actuator, 0])
    return abs(float(model.actuator_gainprm[actuator, 0]) * gear)


def add_contact_forces(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Compute the forces between bodies, which MuJoCo's steps leave out.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    data : MjData
        In some state; changed in place.
    """
    mujoco.mj_rnePostConstraint(model, data)


def inverse_forces(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """Compute the generalised forces that a motion needs (mj_inverse).

    Parameters
    ----------
    model : MjModel
        The compiled model.
    positions : (n, nq) array
        Positions [m, rad].
    velocities, accelerations : (n, nv) arrays
        Velocities [m/s, rad/s] and accelerations [m/s^2, rad/s^2].

    Returns
    -------
    (n, nv) array
        [N or N m]
    """
    data = mujoco.MjData(model)
    forces = np.empty((len(positions), model.nv))
    for i in range(len(positions)):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        data.qacc[:] = accelerations[i]
        mujoco.mj_inverse(model, data)
        forces[i] = data.qfrc_inverse
    return forces


def position_servos(model: mujoco.MjModel) -> list[tuple[Joint, int]]:
    """List the slides and hinges that a position servo drives.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (Joint, int)
        Each joint with the id of its actuator, which pulls it towards its command.
    """
    found = []
    for joint, ids in motors(model):
        for i in ids:
            pull = float(model.actuator_gainprm[i, 0])
            back = float(model.actuator_biasprm[i, 1])
            gear = float(model.actuator_gear[i, 0])
            if pull > 0 and gear > 0 and abs(back * gear + pull) < 1e-6 * pull:
                found.append((joint, i))
    return found


@dataclass(frozen=True, eq=False)
class LinearDrives:
    """The forces of actuators as they depend on the commands: bias + sum over actuators gain u.

    Attributes
    ----------
    bias : (n, nv) array
        Forces at commands of 0 [N, N m].
    gains : (n, nu) array
        Force of each actuator for a command of 1, behind its gear.
    moments : (nu, nv) array
        What such a force of 1 gives at each degree of freedom: 1 at the actuator's joint, or the
        coefficients of its tendon.
    """

    bias: Array
    gains: Array
    moments: Array

    @property
    def driven(self) -> NDArray[np.bool_]:
        """(nv,) whether an actuator acts at a degree of freedom."""
        return np.asarray((self.moments != 0).any(axis=0))

    @property
    def lone(self) -> dict[int, tuple[int, ...]]:
        """By degree of freedom its actuators, where each of these acts there alone."""
        acts = self.moments != 0
        shared = acts[acts.sum(axis=1) > 1].any(axis=0)
        return {
            dof: tuple(np.flatnonzero(acts[:, dof]).tolist())
            for dof in np.flatnonzero(acts.any(axis=0) & ~shared).tolist()
        }

    def forces(self, commands: Array) -> Array:
        """Compute the forces under commands.

        Parameters
        ----------
        commands : (n, nu) array
            One row for each state in which the drives were linearized.

        Returns
        -------
        (n, nv) array
            Generalised forces [N, N m].
        """
        return np.asarray(self.bias + (self.gains * commands) @ self.moments)


def linear_drives(model: mujoco.MjModel, positions: Array, velocities: Array) -> LinearDrives:
    """Compute the forces of motors and servos at joints and fixed tendons, without their limits.

    Parameters
    ----------
    model : MjModel
        The compiled model, with as many positions as degrees of freedom.
    positions, velocities : (n, nv) arrays
        Of hinges and slides.

    Returns
    -------
    LinearDrives

    Raises
    ------
    Incompatible
        If an actuator drives neither a hinge or slide nor a fixed tendon, or has another law of
        force.
    """
    known_laws = _have_known_law(model)
    n = len(positions)
    bias = np.zeros((n, model.nv))
    gains = np.zeros((n, model.nu))
    moments = np.zeros((model.nu, model.nv))
    for actuator in actuators(model):
        i = actuator.id
        line = _line_of(model, actuator)
        if line is None or not known_laws[i]:
            raise Incompatible(
                f"The actuator {actuator.name!r} is neither a motor nor a position or velocity "
                "servo of a hinge, a slide or a fixed tendon, so its force is not known from the "
                "state."
            )
        at_positions, moments[i] = line
        gear = float(model.actuator_gear[i, 0])
        gain, constant = _gain_and_bias(model, i, positions @ at_positions, velocities @ moments[i])
        gains[:, i] = gear * gain
        bias += np.multiply.outer(np.broadcast_to(gear * constant, n), moments[i])
    return LinearDrives(bias, gains, moments)


def _line_of(model: mujoco.MjModel, actuator: Actuator) -> tuple[Array, Array] | None:
    """The derivatives of an actuator's length, before its gear, by all positions (nq,) and (nv,).

    None where it drives neither a hinge or slide nor a fixed tendon.
    """
    joint = actuator.joint
    coefficients: dict[int, float] = {}
    if joint is not None and joint.kind in ("slide", "hinge"):
        coefficients = {joint.id: 1.0}
    elif model.actuator_trntype[actuator.id] == mujoco.mjtTrn.mjTRN_TENDON:
        coefficients = tendon_coefficients(model, int(model.actuator_trnid[actuator.id, 0]))
    if not coefficients:
        return None
    at_positions = np.zeros(model.nq)
    at_velocities = np.zeros(model.nv)
    for i, coefficient in coefficients.items():
        at_positions[model.jnt_qposadr[i]] = coefficient
        at_velocities[model.jnt_dofadr[i]] = coefficient
    return at_positions, at_velocities
