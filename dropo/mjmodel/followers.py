"""Joints that an equality constraint couples to another, as a gripper's second finger."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

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
