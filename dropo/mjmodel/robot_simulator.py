"""The contract of simulators that have a MuJoCo model.

Effects, diagnosis, data checks, reports and training ask for it.
"""

from abc import abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import (
    ActiveEffects,
    EffectContext,
    EffectInstance,
    RecordedPast,
)
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.dry_friction import FrictionKind
from dropo.mjmodel.fields import Binding
from dropo.mjmodel.names import actuator_names
from dropo.mjmodel.observation import Layout


class RobotSimulator(Simulator):
    """A simulator with a MuJoCo model, to which effects can be added.

    Code for any simulator asks `isinstance(simulator, RobotSimulator)` before it uses what follows.
    Every attribute of `Simulator` holds too; `nominal` and `control_step` are always known.

    Attributes
    ----------
    model : MjModel
        The compiled model, without parameters and effects written into it.
    simulated : MjModel
        The same without meshes and textures that are only seen, which is what is stepped and
        copied; elements have the same places in both.
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
    effects : sequence of EffectInstance
        The effects whose magnitudes are parameters, behind the declared ones.
    fixed : sequence of (EffectInstance, (q,) array)
        The effects that the simulation has, with their magnitudes.
    """

    model: mujoco.MjModel
    simulated: mujoco.MjModel
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
        """The names of the q action columns: those of their actuators."""
        names = actuator_names(self.model)
        return [names[place] for place in self.controls.tolist()]

    @property
    @abstractmethod
    def effect_context(self) -> EffectContext:
        """The robot for which effects are offered."""

    @abstractmethod
    def model_of(self, values: Array, active: ActiveEffects = ()) -> mujoco.MjModel:
        """Make a copy of the model with parameters and effects written into it.

        Parameters
        ----------
        values : (d,) array
            The declared parameters; what follows them is left out.
        active : sequence of (EffectInstance, (q,) array)
            Effects with their magnitudes, of which those count that change numbers of the model.

        Returns
        -------
        MjModel
        """

    @abstractmethod
    def commands_of(self, actions: Array) -> Array:
        """Make commands of actions; actuators without one get 0.

        Parameters
        ----------
        actions : (..., q) array
            In the order of the action columns.

        Returns
        -------
        (..., nu) array

        Raises
        ------
        BadArgument
            If there are more or fewer columns.
        """

    @abstractmethod
    def recorded_past(self, segments: Segments, block: Ints) -> RecordedPast:
        """Give what was recorded before some segments begin.

        Parameters
        ----------
        segments : Segments
            N segments.
        block : (n,) array of int
            Which of them.

        Returns
        -------
        RecordedPast
        """

    @abstractmethod
    def without_parameters(self) -> "RobotSimulator":
        """Make the same simulator without declared parameters, at the model's own numbers.

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.
        """

    @abstractmethod
    def with_finer_steps(self, times: int) -> "RobotSimulator":
        """Make the same simulator with shorter physics steps, and control steps as they are.

        Parameters
        ----------
        times : int
            How many physics steps take the place of one.

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.
        """

    @abstractmethod
    def with_integrator(self, name: str) -> "RobotSimulator":
        """Make the same simulator with another integrator.

        Parameters
        ----------
        name : str
            As in MJCF: "Euler", "RK4", "implicit" or "implicitfast".

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.
        """

    @abstractmethod
    def with_friction(self, kind: FrictionKind) -> "RobotSimulator":
        """Make the same simulator with dry friction of a kind (`set_friction_kind`).

        Parameters
        ----------
        kind : FrictionKind
            HOLDING or TURNING.

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.
        """

    @abstractmethod
    def with_fitted(self, effects: Sequence[EffectInstance]) -> "RobotSimulator":
        """Make the same simulator with some of its fixed effects as free ones.

        Parameters
        ----------
        effects : sequence of EffectInstance
            Each takes the place of the last fixed effect of its label; their magnitudes are
            parameters.

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.
        """

    @abstractmethod
    def with_effects(
        self, effects: Sequence[EffectInstance] = (), fixed: ActiveEffects = ()
    ) -> "RobotSimulator":
        """Make the same simulator with more effects beside those it has.

        Parameters
        ----------
        effects : sequence of EffectInstance
            Free effects, whose magnitudes are parameters behind those there are.
        fixed : sequence of (EffectInstance, (q,) array)
            Fixed effects, with their magnitudes.

        Returns
        -------
        RobotSimulator
            A new one, whose counts of steps and failures begin at 0.

        Raises
        ------
        Incompatible
            If an effect needs bodies to be compiled anew, and the model was given compiled.
        """
