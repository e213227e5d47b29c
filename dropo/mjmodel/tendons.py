"""The tendons of a model: lines along sites, and fixed combinations of joints."""

from dataclasses import dataclass

import mujoco

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


def _turns(model: mujoco.MjModel, place: int) -> bool:
    """Whether a tendon is a combination of hinges alone."""
    first = int(model.tendon_adr[place])
    parts = range(first, first + int(model.tendon_num[place]))
    for part in parts:
        if model.wrap_type[part] != mujoco.mjtWrap.mjWRAP_JOINT:
            return False
        if model.jnt_type[model.wrap_objid[part]] != mujoco.mjtJoint.mjJNT_HINGE:
            return False
    return True
