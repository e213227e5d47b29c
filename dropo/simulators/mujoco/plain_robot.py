"""A robot with effects around its physics, stepped by mujoco alone.

What is here is written into `model.py` files, which run without this package.
"""

import copy
from collections.abc import Mapping

import mujoco
import numpy as np

from dropo.core.contracts.effect import ActiveEffects, RecordedPast
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import OPTION
from dropo.simulators.mujoco.layers import change_commands
from dropo.simulators.mujoco.worker import (
    acts_after_clamp,
    constant_wrenches,
    react,
    reacting_effects,
)


class Robot:
    """A MuJoCo model with effects around it, one control step at a time.

    A command is given once a control step; delays, lags and play remember those before it, from the
    last `reset` on.

    Parameters
    ----------
    model : MjModel
        The model, which stays as it is.
    frame_skip : int
        Physics steps in a control step.
    effects : sequence of (effect, (q,) array)
        The effects with their magnitudes.

    Attributes
    ----------
    given_model : MjModel
        The model.
    model, data : MjModel, MjData
        What is stepped, for reading.
    """

    def __init__(self, model: mujoco.MjModel, frame_skip: int, effects: ActiveEffects = ()):
        self.given_model = model
        self.model = copy.copy(model)
        if acts_after_clamp(effects):
            self.model.actuator_ctrllimited[:] = 0
        self.data = mujoco.MjData(self.model)
        self.frame_skip = frame_skip
        self.effects = effects
        self._reacting = reacting_effects(effects)
        self.reset(model.qpos0, np.zeros(model.nv))

    def reset(
        self,
        qpos: Array,
        qvel: Array,
        act: Array | float = 0.0,
        past: RecordedPast | None = None,
    ) -> None:
        """Begin anew, without memory of the commands before.

        Parameters
        ----------
        qpos : (nq,) array
            Positions, in the model's units.
        qvel : (nv,) array
            Velocities.
        act : (na,) array or float
            States of the actuators that have one.
        past : RecordedPast, optional
            What was recorded before, of a robot that goes on where a recording was.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = qpos
        self.data.qvel[:] = qvel
        self.data.act[:] = act
        self.data.xfrc_applied[:] = constant_wrenches(self.effects, self.model.nbody)
        self._given: list[Array] = []
        self._memory: dict[object, object] = {}
        self._past = past
        if past is not None:
            self.data.time = past.states[past.start[0], 0]
        self._steps = 0

    def step(self, command: Array) -> None:
        """Hold a command for a control step.

        Parameters
        ----------
        command : (nu,) array
            As it is given, before any effect.
        """
        self._given.append(np.array(command, dtype=float))
        for one in self.commands(np.stack(self._given))[-self.frame_skip :]:
            self.advance(one)

    def commands(self, given: Array) -> Array:
        """Change the commands of a motion from its beginning on as the effects do.

        Parameters
        ----------
        given : (T, nu) array
            The commands of T control steps.

        Returns
        -------
        (T frame_skip, nu) array
            A row for each physics step.
        """
        return change_commands(given, self.given_model, self.frame_skip, self.effects)

    def advance(self, command: Array) -> None:
        """Make one physics step.

        Parameters
        ----------
        command : (nu,) array
            A row of what `commands` gives.
        """
        self.data.ctrl[:] = command
        if self._reacting:
            self._react(command)
        mujoco.mj_step(self.model, self.data)
        self._steps += 1

    def state(self) -> Array:
        """Give the present state.

        Returns
        -------
        (1 + nq + nv + na,) array
            Time, positions, velocities and the states of actuators.
        """
        data = self.data
        return np.concatenate([[data.time], data.qpos, data.qvel, data.act])

    def sensors(self) -> Array:
        """Give what sensors show in the present state.

        Returns
        -------
        (m,) array
            The model's sensordata.
        """
        mujoco.mj_forward(self.model, self.data)
        return self.data.sensordata.copy()

    def _react(self, command: Array) -> None:
        """Sets what depends on the present state."""
        now = self.state()[None]
        steps = self._steps
        found = react(
            self.model, now, command[None], steps, self._reacting, self._memory, self._past
        )
        self.data.ctrl[:] = found.commands[0]
        self.data.qfrc_applied[:] = found.forces[0]
        self.model.dof_frictionloss[:] = self.given_model.dof_frictionloss + found.friction[0]


def write_numbers(model: mujoco.MjModel, numbers: Mapping[str, Array]) -> None:
    """Write numbers by the names of their fields into a model.

    Parameters
    ----------
    model : MjModel
        It is changed in place.
    numbers : mapping of str to array
        All numbers of each field; the names of fields of mjOption begin with "opt.".
    """
    for name, value in numbers.items():
        owner = model.opt if name.startswith(OPTION) else model
        field = name.removeprefix(OPTION)
        if isinstance(getattr(owner, field), np.ndarray):
            getattr(owner, field)[:] = value
        else:
            setattr(owner, field, np.asarray(value).item())
