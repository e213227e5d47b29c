"""The contract of simulators of a robot's model: what effects, diagnosis, data checks, reports and
training ask for.
"""

from abc import abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import ActiveEffects, EffectContext, EffectInstance
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import Binding
from dropo.mjmodel.names import actuator_names
from dropo.mjmodel.observation import Layout


class RobotSimulator(Simulator):
    """A simulator with a MuJoCo model, to which effects can be added.

    A room that works on any simulator asks `isinstance(simulator, RobotSimulator)` before it uses
    what follows. Beside these, every attribute of `Simulator` holds; `nominal` and `control_step`
    are always known.

    Attributes
    ----------
    model : MjModel
        As it is simulated, without parameters and effects written into it.
    frame_skip : int
        The physics steps for which an action is held.
    control_step : float
        The time for which an action is held [s].
    layout : Layout
        The columns of observation rows, by name and unit.
    controls : (q,) array of int
        The place in ctrl of each action column.
    bindings : sequence of Binding
        The declared parameters, which come first in `space`, as numbers of the model.
    effects : sequence of Atom
        The effects whose sizes are parameters, behind the declared ones.
    fixed : sequence of (Atom, (q,) array)
        The effects that the simulation has, with their sizes.
    """

    model: mujoco.MjModel
    frame_skip: int
    control_step: float
    nominal: Array
    layout: Layout
    controls: NDArray[np.int64]
    bindings: Sequence[Binding]
    effects: Sequence[EffectInstance]
    fixed: ActiveEffects

    @property
    def action_names(self) -> list[str]:
        """The q names of the action columns: those of their actuators."""
        names = actuator_names(self.model)
        return [names[place] for place in self.controls.tolist()]

    @property
    @abstractmethod
    def effect_context(self) -> EffectContext:
        """What effects are offered for."""

    @abstractmethod
    def with_effects(
        self, effects: Sequence[EffectInstance] = (), fixed: ActiveEffects = ()
    ) -> "RobotSimulator":
        """The same simulator with more effects beside those it has.

        Parameters
        ----------
        effects : sequence of Atom
            Free ones, whose sizes are parameters behind those there are.
        fixed : sequence of (Atom, (q,) array)
            Others, with their sizes.

        Returns
        -------
        RobotSimulator
            One whose counts of steps and failures begin anew.
        """
