"""Joints that an equality constraint couples to another, as a gripper's second finger."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.names import joint_names

_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Follower:
    """A joint whose position is a polynomial of another's.

    Attributes
    ----------
    name, leader : str
        The joints.
    places, dofs : tuple of int
        In qpos and qvel, of the follower and of its leader.
    zeros : tuple of float
        Positions from which both count.
    polynomial : tuple of float
        Coefficients, of the lowest power first.
    """

    name: str
    leader: str
    places: tuple[int, int]
    dofs: tuple[int, int]
    zeros: tuple[float, float]
    polynomial: tuple[float, ...]

    def position(self, leading: Array) -> Array:
        """Give the follower's positions.

        Parameters
        ----------
        leading : array
            The leader's.

        Returns
        -------
        array
            Of the same shape.
        """
        past = leading - self.zeros[1]
        return np.asarray(self.zeros[0] + np.polynomial.polynomial.polyval(past, self.polynomial))

    def slope(self, leading: Array) -> Array:
        """Give the follower's speed by that of its leader.

        Parameters
        ----------
        leading : array
            The leader's positions.

        Returns
        -------
        array
            Of the same shape.
        """
        derivative = np.polynomial.polynomial.polyder(self.polynomial)
        return np.asarray(
            np.polynomial.polynomial.polyval(leading - self.zeros[1], derivative), dtype=float
        )


def followers_of(model: mujoco.MjModel) -> list[Follower]:
    """Find the joints that follow another by an active equality constraint.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of Follower
        Hinges and slides; of a linear coupling both ways.
    """
    names = joint_names(model)
    found = []
    for i in range(model.neq):
        is_joint = model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[i]
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if not is_joint or second < 0:
            continue
        if any(int(model.jnt_type[joint]) not in _SINGLE for joint in (first, second)):
            continue
        polynomial = tuple(model.eq_data[i, :5].tolist())
        found.append(_follower(model, names, first, second, polynomial))
        offset, slope, *higher = polynomial
        if slope and not any(higher):
            found.append(_follower(model, names, second, first, (-offset / slope, 1 / slope)))
    return found


def couplings_of(model: mujoco.MjModel, driven: Collection[int]) -> list[Follower]:
    """Find one follower of each equality constraint: the joint that no drive moves.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    driven : collection of int
        The degrees of freedom at which drives act.

    Returns
    -------
    list of Follower
        None of them leads another.

    Raises
    ------
    Incompatible
        If another equality constraint than one of two hinges or slides is active, if drives act at
        both joints, or if a joint follows and leads, or follows twice.
    """
    pairs: dict[frozenset[int], Follower] = {}
    for follower in followers_of(model):
        if follower.dofs[0] not in driven:
            pairs.setdefault(frozenset(follower.dofs), follower)
    found = list(pairs.values())
    active = int(np.count_nonzero(model.eq_active0))
    if len(found) < active:
        raise Incompatible(
            f"The model has {active} active equality constraints, of which {len(found)} couple a "
            "joint without a drive to one other joint: the forces of the others are not known."
        )
    own = [follower.name for follower in found]
    chained = sorted(set(own).intersection(follower.leader for follower in found))
    chained += sorted({name for name in own if own.count(name) > 1})
    if chained:
        raise Incompatible(f"Joint {chained[0]!r} is coupled to several others, one after another.")
    return found


def _follower(
    model: mujoco.MjModel,
    names: Sequence[str],
    follower: int,
    leader: int,
    polynomial: tuple[float, ...],
) -> Follower:
    """A follower by the numbers of both joints."""
    places = tuple(model.jnt_qposadr[[follower, leader]].tolist())
    dofs = tuple(model.jnt_dofadr[[follower, leader]].tolist())
    zeros = tuple(model.qpos0[list(places)].tolist())
    return Follower(names[follower], names[leader], places, dofs, zeros, polynomial)
