"""The tendons of a model: lines along sites, and fixed combinations of joints."""

from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.services.validation import Array
from dropo.mjmodel.names import element_names


@dataclass(frozen=True)
class Tendon:
    """A tendon.

    Attributes
    ----------
    id : int
        Its number in the model.
    name : str
        Its name.
    turns : bool
        Whether its length is an angle: a fixed combination of hinges alone.
    inertia : float
        What moves with it in the model's reference pose [kg or kg m^2].
    """

    id: int
    name: str
    turns: bool
    inertia: float

    @property
    def force(self) -> str:
        """The unit of the force along it."""
        return "N m" if self.turns else "N"

    @property
    def damping(self) -> str:
        """The unit of its viscous damping."""
        return "N m s/rad" if self.turns else "N s/m"

    @property
    def mass(self) -> str:
        """The unit of its inertia."""
        return "kg m^2" if self.turns else "kg"


@dataclass(frozen=True, eq=False)
class FixedTendon:
    """A named tendon that is a combination of hinges and slides.

    Attributes
    ----------
    tendon : Tendon
        Its name and units.
    moments : (nv,) array
        What a force of 1 along it gives at each degree of freedom; by the velocities its speed.
    driven : bool
        Whether an actuator pulls it.
    stiffness, feedback : float
        Of the servos that do: what they give against each m or rad, and each m/s or rad/s.
    armature, damping, friction : float
        What the model has along it: rotor inertia, viscous and dry friction.
    """

    tendon: Tendon
    moments: Array
    driven: bool
    stiffness: float
    feedback: float
    armature: float
    damping: float
    friction: float


def tendons(model: mujoco.MjModel) -> list[Tendon]:
    """List a model's named tendons that something hangs on.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of Tendon
    """
    found = []
    for name, place in element_names(model, "tendon").items():
        inverse = float(model.tendon_invweight0[place])
        if inverse > 0:
            found.append(Tendon(place, name, _turns(model, place), 1.0 / inverse))
    return found


def fixed_tendons(model: mujoco.MjModel) -> list[FixedTendon]:
    """List a model's named tendons that are combinations of hinges and slides.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of FixedTendon
    """
    found = []
    for tendon in tendons(model):
        coefficients = tendon_coefficients(model, tendon.id)
        if not coefficients:
            continue
        moments = np.zeros(model.nv)
        for joint, coefficient in coefficients.items():
            moments[model.jnt_dofadr[joint]] = coefficient
        pulls = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        pulls &= model.actuator_trnid[:, 0] == tendon.id
        feedback = model.actuator_gear[pulls, :1] ** 2 * np.abs(model.actuator_biasprm[pulls, 1:3])
        stiffness, speed = feedback.sum(axis=0).tolist()
        found.append(
            FixedTendon(
                tendon,
                moments,
                bool(pulls.any()),
                stiffness,
                speed,
                float(model.tendon_armature[tendon.id]),
                float(np.ravel(model.tendon_damping[tendon.id])[0]),
                float(model.tendon_frictionloss[tendon.id]),
            )
        )
    return found


def moved_by_tendons(model: mujoco.MjModel) -> frozenset[int]:
    """Find the degrees of freedom that drives move through fixed tendons alone.

    A differential is such: two joints on two tendons. What rubs and turns with its drives is along
    the tendons. Where there are fewer tendons than joints, joints have friction of their own.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    frozenset of int
    """
    pulled = [line.moments for line in fixed_tendons(model) if line.driven]
    if not pulled:
        return frozenset()
    moments = np.array(pulled)
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    at_joints = model.actuator_trnid[np.isin(model.actuator_trntype, kinds), 0]
    moments[:, model.jnt_dofadr[at_joints]] = 0.0
    dofs = np.flatnonzero(moments.any(axis=0))
    if np.linalg.matrix_rank(moments) < len(dofs):
        return frozenset()
    return frozenset(dofs.tolist())


def tendon_coefficients(model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Read what a fixed tendon is made of.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    tendon : int
        The tendon's number.

    Returns
    -------
    dict of int to float
        By the number of each hinge or slide its coefficient; empty for a tendon along sites.
    """
    first = int(model.tendon_adr[tendon])
    parts = range(first, first + int(model.tendon_num[tendon]))
    if any(model.wrap_type[part] != mujoco.mjtWrap.mjWRAP_JOINT for part in parts):
        return {}
    return {int(model.wrap_objid[part]): float(model.wrap_prm[part]) for part in parts}


def _turns(model: mujoco.MjModel, place: int) -> bool:
    """Whether a tendon is a combination of hinges alone."""
    joints = tendon_coefficients(model, place)
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return bool(joints) and all(model.jnt_type[joint] == hinge for joint in joints)
