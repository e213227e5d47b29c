"""One thread's own copy of a model: parameters and effects written into it, and steps in C."""

import copy
from collections.abc import Sequence

import mujoco
import mujoco.rollout
import numpy as np

from dropo.core.contracts.effect import ActiveEffects, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import Binding


class Worker:
    """A copy of the model and its data.

    Without effects it computes bit for bit what the model alone does.
    """

    def __init__(self, model: mujoco.MjModel, bindings: Sequence[Binding]):
        self.base = model
        self.model = copy.copy(model)
        self.data = mujoco.MjData(self.model)
        self.bindings = bindings
        self._changed = False

    def set(self, value: Array, active: ActiveEffects = ()) -> None:
        """Writes a parameter vector (d,) and the effects; mj_setConst follows those that want it,
        and leaves the others as written.
        """
        if self._changed:
            self.model = copy.copy(self.base)
        changes = [
            (instance.model, magnitudes)
            for instance, magnitudes in active
            if instance.model is not None
        ]
        follow = [(b, v) for b, v in zip(self.bindings, value, strict=True) if b.parameter.derived]
        keep = [
            (b, v) for b, v in zip(self.bindings, value, strict=True) if not b.parameter.derived
        ]
        for (
            binding,
            _,
        ) in keep:  # else derived constants would depend on what this copy simulated before
            binding.set(self.model, binding.nominal())
        for binding, number in follow:
            binding.set(self.model, number)
        for change, magnitudes in changes:
            change(self.model, magnitudes)
        if follow or changes:
            mujoco.mj_setConst(self.model, self.data)
        for binding, number in keep:
            binding.set(self.model, number)
        if clamps_itself(active):
            self.model.actuator_ctrllimited[:] = 0
        self._changed = bool(active)

    def roll(
        self, states: Array, controls: Array, active: ActiveEffects = ()
    ) -> tuple[Array, Array]:
        """States (n, steps, s) and sensor data (n, steps, m) from start states (n, s) under
        commands (n, steps, nu), one a physics step.
        """
        acting = [
            (instance, magnitudes)
            for instance, magnitudes in active
            if instance.command_feedback is not None or instance.force is not None
        ]
        if not acting and all(
            instance.wrench is None and instance.applied_force is None for instance, _ in active
        ):
            control = controls if self.model.nu else None
            return mujoco.rollout.rollout(
                self.model, [self.data], states, control, nstep=controls.shape[1]
            )
        inputs, spec = self._inputs(controls, active)
        if not acting:
            return mujoco.rollout.rollout(
                self.model, [self.data], states, inputs, control_spec=spec
            )
        trace = np.empty((*controls.shape[:2], states.shape[1]))
        sensors = np.empty((*controls.shape[:2], self.model.nsensordata))
        now = states
        one = np.empty((len(states), 1, inputs.shape[2]))
        nu = self.model.nu
        nv = self.model.nv
        for step in range(controls.shape[1]):
            one[:, 0] = inputs[:, step]
            one[:, 0, :nu], forces = self.reaction(now, controls[:, step], step, acting)
            one[:, 0, nu : nu + nv] += forces
            state, sensor = mujoco.rollout.rollout(
                self.model, [self.data], now, one, control_spec=spec
            )
            now = trace[:, step] = state[:, 0]
            sensors[:, step] = sensor[:, 0]
        return trace, sensors

    def _inputs(self, controls: Array, active: ActiveEffects) -> tuple[Array, int]:
        """What MuJoCo is given at every step (n, steps, nu + nv + 6 nbody): commands, pushes and
        wrenches.
        """
        push = np.zeros((self.model.nbody, 6))
        for body, wrench in (
            instance.wrench(magnitudes)
            for instance, magnitudes in active
            if instance.wrench is not None
        ):
            push[body] += wrench
        steps = controls.shape[1]
        forces = sum(
            (
                instance.applied_force(steps, magnitudes)
                for instance, magnitudes in active
                if instance.applied_force is not None
            ),
            start=np.zeros((steps, self.model.nv)),
        )
        outside = np.concatenate(
            [forces, np.broadcast_to(push.ravel(), (steps, push.size))], axis=1
        )
        spec = (
            mujoco.mjtState.mjSTATE_CTRL
            | mujoco.mjtState.mjSTATE_QFRC_APPLIED
            | mujoco.mjtState.mjSTATE_XFRC_APPLIED
        )
        return np.concatenate(
            [controls, np.broadcast_to(outside, (len(controls), *outside.shape))], axis=2
        ), int(spec)

    def reaction(
        self, states: Array, commands: Array, step: int, acting: ActiveEffects
    ) -> tuple[Array, Array]:
        """Commands (n, nu) and generalised forces (n, nv) that follow from the states."""
        qpos, qvel, act = np.split(
            states[:, 1 : 1 + self.model.nq + self.model.nv + self.model.na],
            np.cumsum([self.model.nq, self.model.nv]),
            axis=1,
        )
        forces = np.zeros((len(states), self.model.nv))
        for instance, magnitudes in acting:
            step_state = StepState(qpos, qvel, commands, step, act, self.model)
            commands = (
                commands
                if instance.command_feedback is None
                else instance.command_feedback(step_state, magnitudes)
            )
            forces += 0.0 if instance.force is None else instance.force(step_state, magnitudes)
        return commands, forces


def clamps_itself(active: ActiveEffects) -> bool:
    """Whether commands are changed after they were clamped, so that MuJoCo must not clamp them
    again.
    """
    return any(
        instance.actuation is not None or instance.command_feedback is not None
        for instance, _ in active
    )
