"""One thread's own copy of a model: parameters and effects written into it, and steps in C."""

import copy
from collections.abc import Sequence

import mujoco
import mujoco.rollout
import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Moment
from dropo.simulators.fields import Binding

Present = Sequence[tuple[Atom, Array]]
"""The effects that are there, with their sizes."""


class Worker:
    """A copy of the model and its data. Without effects it computes bit for bit what the model alone does."""

    def __init__(self, model: mujoco.MjModel, bindings: Sequence[Binding]):
        self.base, self.model = model, copy.copy(model)
        self.data = mujoco.MjData(self.model)
        self.bindings = bindings
        self._changed = False

    def set(self, value: Array, present: Present = ()) -> None:
        """Writes a parameter vector (d,) and the effects; mj_setConst follows those that want it, and leaves the others as written."""
        if self._changed:
            self.model = copy.copy(self.base)
        changes = [(atom.model, sizes) for atom, sizes in present if atom.model is not None]
        follow = [(b, v) for b, v in zip(self.bindings, value, strict=True) if b.parameter.derived]
        keep = [(b, v) for b, v in zip(self.bindings, value, strict=True) if not b.parameter.derived]
        for binding, _ in keep:  # else derived constants would depend on what this copy simulated before
            binding.set(self.model, binding.nominal())
        for binding, number in follow:
            binding.set(self.model, number)
        for change, sizes in changes:
            change(self.model, sizes)
        if follow or changes:
            mujoco.mj_setConst(self.model, self.data)
        for binding, number in keep:
            binding.set(self.model, number)
        if clamps_itself(present):
            self.model.actuator_ctrllimited[:] = 0
        self._changed = bool(present)

    def roll(self, states: Array, controls: Array, present: Present = ()) -> tuple[Array, Array]:
        """States (n, steps, s) and sensor data (n, steps, m) from start states (n, s) under commands (n, steps, nu), one a physics step."""
        wrenches = [atom.wrench(sizes) for atom, sizes in present if atom.wrench is not None]
        acting = [(atom, sizes) for atom, sizes in present if atom.drive is not None or atom.force is not None]
        if not wrenches and not acting:
            control = controls if self.model.nu else None
            return mujoco.rollout.rollout(self.model, [self.data], states, control, nstep=controls.shape[1])
        push = np.zeros((self.model.nbody, 6))
        for body, wrench in wrenches:
            push[body] += wrench
        if not acting:
            forces = np.zeros((*controls.shape[:2], self.model.nv))
            return self._pushed(states, controls, forces, push)
        parts, now = [], states
        for step in range(controls.shape[1]):
            commands, forces = self._reaction(now, controls[:, step], step, acting)
            parts.append(self._pushed(now, commands[:, None], forces[:, None], push))
            now = parts[-1][0][:, 0]
        return np.concatenate([part[0] for part in parts], axis=1), np.concatenate([part[1] for part in parts], axis=1)

    def _reaction(self, states: Array, commands: Array, step: int, acting: Present) -> tuple[Array, Array]:
        """Commands (n, nu) and generalised forces (n, nv) that follow from the states."""
        nq, nv = self.model.nq, self.model.nv
        forces = np.zeros((len(states), nv))
        for atom, sizes in acting:
            moment = Moment(states[:, 1 : 1 + nq], states[:, 1 + nq : 1 + nq + nv], commands, step)
            commands = commands if atom.drive is None else atom.drive(moment, sizes)
            forces += 0.0 if atom.force is None else atom.force(moment, sizes)
        return commands, forces

    def _pushed(self, states: Array, commands: Array, forces: Array, push: Array) -> tuple[Array, Array]:
        everywhere = np.broadcast_to(push.ravel(), (*commands.shape[:2], push.size))
        control = np.concatenate([commands, forces, everywhere], axis=2)
        spec = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED | mujoco.mjtState.mjSTATE_XFRC_APPLIED
        return mujoco.rollout.rollout(self.model, [self.data], states, control, control_spec=int(spec))


def clamps_itself(present: Present) -> bool:
    """Whether commands are changed after they were clamped, so that MuJoCo must not clamp them again."""
    return any(atom.actuation is not None or atom.drive is not None for atom, _ in present)
