"""One thread's own copy of a model: parameters and effects written into it, and steps in C."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

from dropo.core.contracts.effect import (
    ActiveEffects,
    EffectInstance,
    RecordedPast,
    StepState,
)
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.copies import ModelCopy
from dropo.mjmodel.fields import Binding
from dropo.mjmodel.names import element_name
from dropo.mjmodel.visuals import lost_shapes

MAX_COPIES = 1 << 27
"""The bytes of models that a worker may hold for states whose friction differs; no result depends
on it.
"""


class Worker:
    """A copy of a model and its data, for one thread.

    Without effects it computes bit for bit what the model alone does.

    Parameters
    ----------
    model : MjModel
        The model, which stays as it is.
    bindings : sequence of Binding
        The d declared parameters.

    Attributes
    ----------
    model : MjModel
        The copy, with parameters and effects written into it.
    """

    def __init__(self, model: mujoco.MjModel, bindings: Sequence[Binding]):
        self._copy = ModelCopy(model)
        self.model = self._copy.model
        self.data = mujoco.MjData(self.model)
        self.bindings = bindings
        self._lost = lost_shapes(model)
        self._changed = False
        self._twins: list[ModelCopy] = []

    def set(self, value: Array, active: ActiveEffects = ()) -> None:
        """Write parameters and effects into the model.

        mj_setConst follows where a parameter or effect changes derived constants, and leaves the
        other parameters as written.

        Parameters
        ----------
        value : (d,) array
            The declared parameters.
        active : sequence of (EffectInstance, (q,) array)
            The effects with their magnitudes.

        Raises
        ------
        Incompatible
            If MuJoCo takes no such model, as of a body that moves and has no mass.
        """
        if self._changed:
            self._copy.restore()
        changes = [(one.model, magnitudes) for one, magnitudes in active if one.model is not None]
        pairs = list(zip(self.bindings, value, strict=True))
        before = [pair for pair in pairs if pair[0].parameter.derived]
        after = [pair for pair in pairs if not pair[0].parameter.derived]
        # else derived constants would depend on what this copy simulated before
        for binding, _ in after:
            binding.set(self.model, binding.nominal())
        for binding, number in before:
            binding.set(self.model, number)
        # noted at once, since what a change raises may leave half of it
        self._changed = self._changed or bool(changes)
        for change, magnitudes in changes:
            change(self.model, magnitudes)
        if changes:
            self._refuse_lost_shapes()
        if before or changes:
            self._derive_constants()
        for binding, number in after:
            binding.set(self.model, number)
        unclamped = acts_after_clamp(active)
        if unclamped:
            self.model.actuator_ctrllimited[:] = 0
        # Whoever steps this copy sets its friction anew before every step.
        frictions = any(one.friction is not None for one, _ in active)
        self._changed = unclamped or frictions or bool(changes)

    def roll(
        self,
        states: Array,
        controls: Array,
        active: ActiveEffects = (),
        past: RecordedPast | None = None,
    ) -> tuple[Array, Array]:
        """Simulate from start states under commands.

        Parameters
        ----------
        states : (n, s) array
            Full physics states.
        controls : (n, steps, nu) array
            Commands, one a physics step.
        active : sequence of (EffectInstance, (q,) array)
            The effects with their magnitudes, as written with `set`.
        past : RecordedPast, optional
            What was recorded before the simulations begin.

        Returns
        -------
        states : (n, steps, s) array
            After every physics step.
        sensors : (n, steps, m) array
            Sensor data of every physics step.
        """
        reacting = reacting_effects(active)
        known_forces = any(
            one.wrench is not None or one.applied_force is not None for one, _ in active
        )
        if not reacting and not known_forces:
            control = controls if self.model.nu else None
            return mujoco.rollout.rollout(
                self.model, [self.data], states, control, nstep=controls.shape[1]
            )
        inputs, spec = self._inputs(controls, active)
        if not reacting:
            return mujoco.rollout.rollout(
                self.model, [self.data], states, inputs, control_spec=spec
            )
        return self._roll_stepwise(states, inputs, spec, reacting, past)

    def _roll_stepwise(
        self,
        states: Array,
        inputs: Array,
        spec: int,
        reacting: ActiveEffects,
        past: RecordedPast | None,
    ) -> tuple[Array, Array]:
        """As `roll`, one physics step at a time, with effects that depend on the state."""
        nu = self.model.nu
        nv = self.model.nv
        count, steps = inputs.shape[:2]
        trace = np.empty((steps, count, 1, states.shape[1]))
        sensors = np.empty((steps, count, 1, self.model.nsensordata))
        now = np.ascontiguousarray(states, dtype=float)
        given = np.empty((count, 1, inputs.shape[2]))
        memory: dict[Any, Any] = {}
        adds_friction = any(one.friction is not None for one, _ in reacting)
        models = self._models(count) if adds_friction else [self.model] * count
        for step in range(steps):
            given[:, 0] = inputs[:, step]
            reaction = react(self.model, now, inputs[:, step, :nu], step, reacting, memory, past)
            given[:, 0, :nu] = reaction.commands
            given[:, 0, nu : nu + nv] += reaction.forces
            friction = self.model.dof_frictionloss + reaction.friction
            # states that have models of their own are as many at a time as there are models
            for first in range(0, count, len(models)):
                some = slice(first, min(first + len(models), count))
                own = models[: some.stop - first]
                if adds_friction:
                    for model, row in zip(own, friction[some], strict=True):
                        model.dof_frictionloss[:] = row
                # The shapes are as they must be, and checking them costs as much as a step.
                mujoco.rollout.rollout(
                    own,
                    [self.data],
                    now[some],
                    given[some],
                    nstep=1,
                    control_spec=spec,
                    skip_checks=True,
                    state=trace[step, some],
                    sensordata=sensors[step, some],
                )
            now = trace[step, :, 0]
        return trace[:, :, 0].swapaxes(0, 1), sensors[:, :, 0].swapaxes(0, 1)

    def _models(self, count: int) -> list[mujoco.MjModel]:
        """Up to `count` models like this one, each for a friction of its own."""
        most = max(1, MAX_COPIES // mujoco.mj_sizeModel(self.model))
        own = min(count, most)
        for twin in self._twins[:own]:
            twin.restore()
        while len(self._twins) < own:
            self._twins.append(ModelCopy(self.model))
        return [twin.model for twin in self._twins[:own]]

    def _derive_constants(self) -> None:
        """Let what follows from the parameters follow them."""
        try:
            mujoco.mj_setConst(self.model, self.data)
        except mujoco.FatalError as error:
            raise Incompatible(f"MuJoCo takes no model with these parameters: {error}.") from None

    def _refuse_lost_shapes(self) -> None:
        """Refuses a change by which a mesh collides that was only seen, and is not here."""
        model = self.model
        for geom in self._lost.tolist():
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                raise Incompatible(
                    f"An effect makes the geom {element_name(model, 'geom', geom)!r} collide, whose"
                    " mesh is only seen in the model. Give it contype or conaffinity there."
                )

    def _inputs(self, controls: Array, active: ActiveEffects) -> tuple[Array, int]:
        """What MuJoCo is given at every step, (n, steps, nu + nv + 6 nbody), and its specification.

        They are commands, forces known beforehand, and constant wrenches.
        """
        steps = controls.shape[1]
        wrenches = constant_wrenches(active, self.model.nbody)
        forces = np.zeros((steps, self.model.nv))
        for instance, magnitudes in active:
            if instance.applied_force is not None:
                forces = forces + instance.applied_force(steps, magnitudes)
        repeated = np.broadcast_to(wrenches.ravel(), (steps, wrenches.size))
        applied = np.concatenate([forces, repeated], axis=1)
        for_all = np.broadcast_to(applied, (len(controls), *applied.shape))
        spec = (
            mujoco.mjtState.mjSTATE_CTRL
            | mujoco.mjtState.mjSTATE_QFRC_APPLIED
            | mujoco.mjtState.mjSTATE_XFRC_APPLIED
        )
        return np.concatenate([controls, for_all], axis=2), int(spec)


@dataclass(frozen=True, eq=False)
class Reaction:
    """What effects make of n states.

    Attributes
    ----------
    commands : (n, nu) array
        The commands.
    forces : (n, nv) array
        Generalised forces [N, N m].
    friction : (n, nv) array
        Dry friction beside the model's own [N, N m].
    """

    commands: Array
    forces: Array
    friction: Array


def react(
    model: mujoco.MjModel,
    states: Array,
    commands: Array,
    step: int,
    reacting: ActiveEffects,
    memory: dict[Any, Any],
    past: RecordedPast | None = None,
) -> Reaction:
    """Evaluate the effects that depend on the state.

    Parameters
    ----------
    model : MjModel
        The model, with all parameters and effects written into it.
    states : (n, s) array
        Full physics states at the beginning of a physics step.
    commands : (n, nu) array
        The commands of that step.
    step : int
        Physics steps since the start.
    reacting : sequence of (EffectInstance, (q,) array)
        The effects, see `reacting_effects`.
    memory : dict
        What effects noted in the steps before; {} at the start, and then the same one.
    past : RecordedPast, optional
        What was recorded before the start.

    Returns
    -------
    Reaction
    """
    sizes = [model.nq, model.nv, model.na]
    whole = states[:, 1 : 1 + sum(sizes)]
    qpos, qvel, act = np.split(whole, np.cumsum(sizes[:2]), axis=1)
    forces = np.zeros((len(states), model.nv))
    friction = np.zeros_like(forces)
    # A simulation that diverges ends in NaN, which is no news worth a warning.
    with np.errstate(over="ignore", invalid="ignore"):
        for instance, magnitudes in reacting:
            state = StepState(qpos, qvel, commands, step, act, model, states[:, 0], memory, past)
            if instance.command_feedback is not None:
                commands = instance.command_feedback(state, magnitudes)
            if instance.force is not None:
                forces += instance.force(state, magnitudes)
            if instance.friction is not None:
                friction += instance.friction(state, magnitudes)
    return Reaction(commands, forces, friction)


def reacting_effects(active: ActiveEffects) -> list[tuple[EffectInstance, Array]]:
    """Select the effects that depend on the state of every physics step.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    list of (EffectInstance, (q,) array)
        Those with a hook `command_feedback`, `force` or `friction`.
    """
    found = []
    for instance, magnitudes in active:
        hooks = (instance.command_feedback, instance.force, instance.friction)
        if any(hook is not None for hook in hooks):
            found.append((instance, magnitudes))
    return found


def constant_wrenches(active: ActiveEffects, nbody: int) -> Array:
    """Add up the constant forces and torques of the effects.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.
    nbody : int
        Number of bodies, the world's included.

    Returns
    -------
    (nbody, 6) array
        Force, then torque at each body's centre of mass, in the world's axes [N, N m].
    """
    total = np.zeros((nbody, 6))
    for instance, magnitudes in active:
        if instance.wrench is not None:
            body, wrench = instance.wrench(magnitudes)
            total[body] += wrench
    return total


def acts_after_clamp(active: ActiveEffects) -> bool:
    """Return whether commands are changed after they were clamped.

    MuJoCo must then not clamp them again.

    Parameters
    ----------
    active : sequence of (EffectInstance, (q,) array)
        The effects with their magnitudes.

    Returns
    -------
    bool
        True with a hook `actuation` or `command_feedback`.
    """
    return any(
        instance.actuation is not None or instance.command_feedback is not None
        for instance, _ in active
    )
