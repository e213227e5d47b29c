"""Inverse dynamics of measured motion, and how it depends on each body's inertia.

The generalized forces of a tree of bodies are linear in the ten inertial numbers of each: mass,
mass times the centre of mass, and the moments of inertia about the body's origin.

References
----------
.. [1] Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and links,
   International Journal of Robotics Research 5, 1986.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array

INERTIAL = 10
"""Numbers of a body: m, m c (3), and Ixx, Iyy, Izz, Ixy, Ixz, Iyz about its origin."""


def point_mass(place: Array) -> Array:
    """Return the ten inertial numbers of 1 kg at a place.

    Parameters
    ----------
    place : (..., 3) array
        In the body's frame [m].

    Returns
    -------
    (..., 10) array
        As `INERTIAL` orders them.
    """
    x, y, z = np.moveaxis(np.asarray(place, dtype=float), -1, 0)
    moments = (y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z)
    return np.stack([np.ones_like(x), x, y, z, *moments], axis=-1)


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """What a motion needs.

    Attributes
    ----------
    forces : (n, nv) array
        Generalized forces without actuators and dry friction [N, N m].
    by_inertia : (B, n, nv, 10) array
        Their derivatives by the inertial numbers of B bodies.
    by_gravity : (n, nv, 3) array
        Their derivatives by gravity [m/s^2].
    free : (n,) array of bool
        Whether neither a contact nor a limit acts.
    """

    forces: Array
    by_inertia: Array
    by_gravity: Array
    free: NDArray[np.bool_]


def inverse_dynamics(
    model: mujoco.MjModel,
    positions: Array,
    velocities: Array,
    accelerations: Array,
    bodies: Sequence[int],
) -> InverseDynamics:
    """Compute the forces that a motion of hinges and slides needs, and their derivatives.

    Those of equality constraints are not among them.

    Parameters
    ----------
    model : MjModel
        The compiled model, with as many positions as degrees of freedom.
    positions : (n, nv) array
        [m, rad].
    velocities, accelerations : (n, nv) arrays
        [m/s, rad/s] and [m/s^2, rad/s^2].
    bodies : sequence of int
        Ids of the B bodies by whose inertia the forces are differentiated.

    Returns
    -------
    InverseDynamics
    """
    without_friction = _without_dry_friction(model)
    without_friction.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data = mujoco.MjData(without_friction)
    n, nv = velocities.shape
    forces = np.empty((n, nv))
    free = np.empty(n, dtype=bool)
    moving = _Motions(n, nv, range(1, model.nbody))
    for i in range(n):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        data.qacc[:] = accelerations[i]
        mujoco.mj_inverse(without_friction, data)
        mujoco.mj_rnePostConstraint(without_friction, data)
        forces[i] = data.qfrc_inverse
        free[i] = data.nefc == data.ne
        moving.record(i, without_friction, data)
    chosen = [moving.bodies.index(body) for body in bodies]
    return InverseDynamics(forces, moving.regressors(chosen), moving.by_gravity(model), free)


def rigid_forces(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> tuple[Array, Array]:
    """Compute what a motion of the bodies alone needs, without rotors, friction, contacts, limits.

    Parameters
    ----------
    model : MjModel
        The compiled model, with as many positions as degrees of freedom.
    positions : (n, nv) array
        [m, rad].
    velocities, accelerations : (n, nv) arrays
        [m/s, rad/s] and [m/s^2, rad/s^2].

    Returns
    -------
    moving : (n, nv) array
        Generalized forces that accelerate the bodies and stretch springs [N, N m].
    holding : (n, nv) array
        Those that hold them against gravity.
    """
    bare = _without_dry_friction(model)
    bare.dof_armature[:] = 0
    bare.dof_damping[:] = 0
    bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(bare)
    moving = np.empty_like(velocities)
    holding = np.empty_like(velocities)
    gravity = bare.opt.gravity
    pulls = gravity.copy()
    qpos = data.qpos
    qvel = data.qvel
    qacc = data.qacc
    force = data.qfrc_inverse
    nothing = mujoco.mjtStage.mjSTAGE_NONE
    position = mujoco.mjtStage.mjSTAGE_POS
    for i in range(len(positions)):
        qpos[:] = positions[i]
        qvel[:] = velocities[i]
        qacc[:] = accelerations[i]
        gravity[:] = 0
        mujoco.mj_inverseSkip(bare, data, nothing, 1)
        moving[i] = force
        gravity[:] = pulls
        mujoco.mj_inverseSkip(bare, data, position, 1)
        holding[i] = force
    holding -= moving
    return moving, holding


def _without_dry_friction(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model without dry friction at joints and tendons."""
    changed = mujoco.MjModel.__copy__(model)
    changed.dof_frictionloss[:] = 0
    changed.tendon_frictionloss[:] = 0
    return changed


class _Motions:
    """The motion of every body along a log, in the body's own axes."""

    def __init__(self, n: int, nv: int, bodies: Sequence[int]):
        self.bodies = list(bodies)
        count = len(self.bodies)
        self.linear_jacobian = np.empty((count, n, 3, nv))
        self.angular_jacobian = np.empty((count, n, 3, nv))
        self.rotation = np.empty((count, n, 3, 3))
        self.acceleration = np.empty((count, n, 6))
        self.velocity = np.empty((count, n, 6))

    def record(self, i: int, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Note row i."""
        kind = mujoco.mjtObj.mjOBJ_XBODY
        for k, body in enumerate(self.bodies):
            linear, angular = self.linear_jacobian[k, i], self.angular_jacobian[k, i]
            mujoco.mj_jacBody(model, data, linear, angular, body)
            self.rotation[k, i] = data.xmat[body].reshape(3, 3)
            mujoco.mj_objectAcceleration(model, data, kind, body, self.acceleration[k, i], 1)
            mujoco.mj_objectVelocity(model, data, kind, body, self.velocity[k, i], 1)

    def regressors(self, chosen: Sequence[int]) -> Array:
        """(B, n, nv, 10) the derivatives of the forces by the inertia of the chosen bodies."""
        found = [self._regressor(k) for k in chosen]
        nv = self.linear_jacobian.shape[3]
        shape = (0, self.linear_jacobian.shape[1], nv, INERTIAL)
        return np.stack(found) if found else np.zeros(shape)

    def _regressor(self, k: int) -> Array:
        """(n, nv, 10) the derivatives of the forces by one body's inertia."""
        angular = self.acceleration[k, :, :3]
        linear = self.acceleration[k, :, 3:]
        spin = _cross_matrices(self.velocity[k, :, :3])
        twist = _cross_matrices(angular) + spin @ spin
        n = len(angular)
        force = np.zeros((n, 3, INERTIAL))
        force[:, :, 0] = linear
        force[:, :, 1:4] = twist
        torque = np.zeros((n, 3, INERTIAL))
        torque[:, :, 1:4] = -_cross_matrices(linear)
        moments = _moment_matrices(self.velocity[k, :, :3])
        torque[:, :, 4:] = _moment_matrices(angular) + spin @ moments
        to_body = self.rotation[k].transpose(0, 2, 1)
        own_linear = to_body @ self.linear_jacobian[k]
        own_angular = to_body @ self.angular_jacobian[k]
        by_force = own_linear.transpose(0, 2, 1) @ force
        return np.asarray(by_force + own_angular.transpose(0, 2, 1) @ torque)

    def by_gravity(self, model: mujoco.MjModel) -> Array:
        """(n, nv, 3) the derivatives of the forces by gravity."""
        total = np.zeros((*self.linear_jacobian.shape[1:2], self.linear_jacobian.shape[3], 3))
        for k, body in enumerate(self.bodies):
            place = self.rotation[k] @ model.body_ipos[body]
            at_centre = self.linear_jacobian[k] - _cross_matrices(place) @ self.angular_jacobian[k]
            total -= float(model.body_mass[body]) * at_centre.transpose(0, 2, 1)
        return total


def _cross_matrices(vectors: Array) -> Array:
    """(n, 3, 3) the matrices that take the cross product with n vectors from the left."""
    out = np.zeros((len(vectors), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i, j] = -vectors[:, k]
        out[:, j, i] = vectors[:, k]
    return out


def _moment_matrices(vectors: Array) -> Array:
    """(n, 3, 6) the matrices that take (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) to I w for n vectors w."""
    x, y, z = vectors.T
    out = np.zeros((len(vectors), 3, 6))
    out[:, 0, 0] = x
    out[:, 1, 1] = y
    out[:, 2, 2] = z
    out[:, 0, 3] = y
    out[:, 1, 3] = x
    out[:, 0, 4] = z
    out[:, 2, 4] = x
    out[:, 1, 5] = z
    out[:, 2, 5] = y
    return out
