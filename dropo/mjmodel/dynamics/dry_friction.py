"""Three kinds of dry friction: MuJoCo's, one that holds what rests, one that turns promptly.

MuJoCo's friction is a soft constraint: under a load F below the friction, a joint does not rest but
creeps with the speed (1 - d) F T / (2 m), with the constraint's impedance d = 0.9 and time constant
T = 20 ms by default, and the joint's inertia m. A servo that holds 0.3 N m on 0.03 kg m^2 moves by
10 mrad in a second, where a gearbox stays.

The time constant matters where a joint turns, too: friction is 0 where the acceleration without it
is -2 v / (d T), which a joint that slows down reaches about d T / 2 = 9 ms before it turns. Next to
a gearbox, whose friction turns with the velocity, that looks like a shorter delay and more damping:
by 12 % for a servo of 18 N m/rad with a damping of 0.08 N m s/rad and a friction of 0.15 N m.

Near rest a joint with MuJoCo's friction has the force -d m (2 v / (d T) + a), with the acceleration
a that it would have without friction; above the friction, it slides. With d next to 1 and a short T
it stays where it rests. With d next to 0 the acceleration does not count: the friction is
proportional to the velocity up to T F / (2 m), as other engines have it, and as lubricated joints
do that turn slowly.

References
----------
MuJoCo documentation, "Computation: Constraint model", solver parameters.
"""

from enum import StrEnum

import mujoco
import numpy as np

IMPEDANCE = float(mujoco.mjMAXIMP)
"""The hardest constraint that MuJoCo computes: what creeps is a thousandth of its default."""


SOFTEST = float(mujoco.mjMINIMP)
"""The softest: friction that is proportional to the velocity until a joint slides."""


SHORTEST = 1e-4
"""A time constant [s] below those that MuJoCo takes: at least two physics steps."""


class FrictionKind(StrEnum):
    """What the dry friction of a model's joints and tendons does near rest.

    CREEPING is MuJoCo's own, with whatever numbers a model has. HOLDING holds what rests, and turns
    with the velocity. TURNING is proportional to the velocity up to as little of it as is stable:
    by MuJoCo the friction times two physics steps over twice the inertia. Explicit steps need those
    of Runge and Kutta for it.
    """

    CREEPING = "creeping"
    HOLDING = "holding"
    TURNING = "turning"


_IMPEDANCES = {FrictionKind.HOLDING: IMPEDANCE, FrictionKind.TURNING: SOFTEST}


def set_friction_kind(model: mujoco.MjModel, kind: FrictionKind) -> None:
    """Make the dry friction of all joints and tendons one of a kind.

    Where such friction and stops are all that constrains the model, Gauss and Seidel's solver is
    faster than Newton's, and both come to the same forces.

    Parameters
    ----------
    model : MjModel
        Changed in place: the impedances and time constants of the friction of joints and tendons,
        and the solver.
    kind : FrictionKind
        Not CREEPING, which has no numbers of its own.
    """
    impedance = _IMPEDANCES[kind]
    model.dof_solimp[:, :2] = impedance
    model.tendon_solimp_fri[:, :2] = impedance
    model.dof_solref[:] = (_shortest(model), 1.0)
    model.tendon_solref_fri[:] = (_shortest(model), 1.0)
    if not model.neq and not _collides(model):
        model.opt.solver = mujoco.mjtSolver.mjSOL_PGS


def friction_kind(model: mujoco.MjModel) -> FrictionKind:
    """Tell which kind of dry friction a model has, or would have.

    Parameters
    ----------
    model : MjModel
        Any.

    Returns
    -------
    FrictionKind
        That of `set_friction_kind` if the friction of all joints and tendons is of that kind.
    """
    constants = np.concatenate([model.dof_solref[:, 0], model.tendon_solref_fri[:, 0]])
    if not np.all((constants > 0) & (constants <= _shortest(model))):
        return FrictionKind.CREEPING
    impedances = np.concatenate([model.dof_solimp[:, :2], model.tendon_solimp_fri[:, :2]])
    if np.all(impedances >= IMPEDANCE):
        return FrictionKind.HOLDING
    if np.all(impedances <= SOFTEST):
        return FrictionKind.TURNING
    return FrictionKind.CREEPING


def rubs(model: mujoco.MjModel) -> bool:
    """Tell whether a model has dry friction.

    Parameters
    ----------
    model : MjModel
        Any.

    Returns
    -------
    bool
    """
    sizes = np.concatenate([model.dof_frictionloss, model.tendon_frictionloss])
    return bool(np.any(sizes > 0))


def impedance(model: mujoco.MjModel) -> float:
    """Return the impedance of the dry friction of a model's joints.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    float
        The first number of `solimpfriction`.
    """
    return float(model.dof_solimp[0, 0])


def time_constant(model: mujoco.MjModel) -> float:
    """Return the time constant of the dry friction of a model's joints.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    float
        The first number of `solreffriction` [s]; MuJoCo takes two physics steps where it is less.
    """
    return float(model.dof_solref[0, 0])


def _collides(model: mujoco.MjModel) -> bool:
    """Whether any bodies of a model can touch."""
    off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    touching = model.geom_contype[:, None] & model.geom_conaffinity
    return not off and bool(model.npair or np.any(touching))


def _shortest(model: mujoco.MjModel) -> float:
    """The shortest time constant [s] with which a model's friction is stable."""
    unsafe = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    return max(SHORTEST, 2 * float(model.opt.timestep)) if unsafe else SHORTEST
