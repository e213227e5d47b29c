"""A model with numbers that it lacked, each with its value."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.arithmetic import Arithmetic
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.mjmodel.dynamics.dry_friction import FrictionKind, friction_kind
from dropo.mjmodel.robot_simulator import RobotSimulator

GAIN = "actuator_gain"
"""The effect that is on the scale of all forces."""

PAYLOAD = "payload"
"""The effect that stands in for gains that differ."""

ROOM = 10.0
"""Multiple of what is added to a number of the model that its bounds hold at least."""


@dataclass(frozen=True, eq=False)
class FarOffModel:
    """A model with numbers that it lacked.

    Attributes
    ----------
    problem : Problem
        The model as it came.
    declared : (d,) array
        The declared parameters.
    free : int array
        Those of them that are fitted.
    numbers : sequence of (EffectInstance, (q,) array)
        What was missing else, with its magnitudes.
    arithmetic : Arithmetic or None
        Physics steps by which motions are evaluated; the model's own if None.
    """

    problem: Problem
    declared: Array
    free: Ints
    numbers: ActiveEffects
    arithmetic: Arithmetic | None = None

    @cached_property
    def library(self) -> Library:
        """The simulator with the numbers' effects."""
        return self.library_with(())

    @cached_property
    def exact(self) -> RobotSimulator | None:
        """The library's simulator in the steps by which motions are evaluated, if not its own."""
        if self.arithmetic is None:
            return None
        return self.arithmetic.of(robot_of(self.problem).with_effects(self.library.instances))

    def in_exact_steps(self) -> "FarOffModel":
        """Make the model whose own steps are those by which motions are evaluated.

        Returns
        -------
        FarOffModel
            Itself where they are its own already.
        """
        if self.arithmetic is None:
            return self
        simulator = self.arithmetic.of(robot_of(self.problem))
        return replace(self, problem=replace(self.problem, simulator=simulator), arithmetic=None)

    def library_with(self, more: Sequence[EffectInstance]) -> Library:
        """Build the simulator with the numbers' effects, then others.

        Parameters
        ----------
        more : sequence of EffectInstance
            The other effects, whose magnitudes come last.

        Returns
        -------
        Library
            The simulator with the places of all magnitudes.
        """
        instances = [*(instance for instance, _ in self.numbers), *more]
        simulator = robot_of(self.problem).with_effects(instances)
        return Library(simulator, instances, len(self.declared))

    def theta_with(self, more: int = 0) -> Array:
        """Join the declared parameters, the magnitudes, and zeros for other effects.

        Parameters
        ----------
        more : int
            Number of magnitudes of other effects.

        Returns
        -------
        (m + more,) array
            All numbers, each in its own unit.
        """
        sizes = [size for _, size in self.numbers]
        return np.concatenate([self.declared, *sizes, np.zeros(more)])

    @property
    def theta(self) -> Array:
        """(m,) the declared parameters, then the magnitudes."""
        return self.theta_with()

    @property
    def fitted(self) -> Ints:
        """(f,) the indices in theta of what is fitted."""
        effects = np.arange(len(self.declared), len(self.theta))
        return np.concatenate([self.free, effects]).astype(np.int64)

    def at(self, theta: Array) -> "FarOffModel":
        """Set other values of the same numbers.

        Parameters
        ----------
        theta : (m,) array
            The declared parameters, then the magnitudes.

        Returns
        -------
        FarOffModel
            The model with these values.
        """
        numbers = []
        for instance, _ in self.numbers:
            sizes = theta[self.library.indices_of[instance.label]]
            numbers.append((instance, sizes))
        return replace(self, declared=theta[: len(self.declared)], numbers=tuple(numbers))

    def as_it_came(self) -> "FarOffModel":
        """Set every number to what it is in the model as it came.

        Returns
        -------
        FarOffModel
            The declared parameters at their nominal values, and numbers of 0; a payload keeps its
            place, of which a mass of 0 tells nothing.
        """
        simulator = robot_of(self.problem)
        numbers = []
        for instance, sizes in self.numbers:
            nothing = sizes.copy() if instance.effect == PAYLOAD else np.zeros_like(sizes)
            nothing[0] = 0.0
            numbers.append((instance, nothing))
        declared = simulator.space.clip(simulator.nominal)
        return replace(self, declared=declared, numbers=tuple(numbers))

    @property
    def friction(self) -> FrictionKind:
        """What dry friction, where there is some, does near rest."""
        return friction_kind(robot_of(self.problem).model)

    def with_friction(self, kind: FrictionKind) -> "FarOffModel":
        """Make the model with dry friction of another kind.

        Parameters
        ----------
        kind : FrictionKind
            HOLDING or TURNING.

        Returns
        -------
        FarOffModel
            The same numbers, in such a simulator.
        """
        simulator = robot_of(self.problem).with_friction(kind)
        return replace(self, problem=replace(self.problem, simulator=simulator))

    def with_data_of(self, problem: Problem) -> "FarOffModel":
        """Exchange the data.

        Parameters
        ----------
        problem : Problem
            What the trajectories, held-out ones too, are taken from.

        Returns
        -------
        FarOffModel
            The model with these data; itself where it has them already.
        """
        if problem.trajectories is self.problem.trajectories:
            return self
        return replace(self, problem=replace(problem, simulator=self.problem.simulator))

    def without(self, labels: Sequence[str]) -> "FarOffModel":
        """Leave out some effects.

        Parameters
        ----------
        labels : sequence of str
            The labels of the effects that are left out.

        Returns
        -------
        FarOffModel
            The model with its other numbers as they are.
        """
        kept = [(one, sizes) for one, sizes in self.numbers if one.label not in labels]
        return replace(self, numbers=tuple(kept))

    def with_numbers(self, numbers: ActiveEffects) -> "FarOffModel":
        """Add effects.

        Parameters
        ----------
        numbers : sequence of (EffectInstance, (q,) array)
            The effects and their magnitudes, which come last.

        Returns
        -------
        FarOffModel
            The model with these numbers too.
        """
        return replace(self, numbers=(*self.numbers, *numbers))


def reaching(instance: EffectInstance, sizes: Array) -> EffectInstance:
    """An effect whose bounds hold the magnitudes (q,), with room.

    Parameters
    ----------
    instance : EffectInstance
        Any.
    sizes : (q,) array
        Its magnitudes.

    Returns
    -------
    EffectInstance
    """
    quantities = [
        _reaching(quantity, size)
        for quantity, size in zip(instance.quantities, sizes.tolist(), strict=True)
    ]
    return replace(instance, quantities=tuple(quantities))


def _reaching(quantity: Quantity, size: float) -> Quantity:
    """A quantity whose bounds hold a magnitude, with room."""
    lowest = 2 * size
    highest = 2 * size
    if quantity.relative:
        # A tenth of what is left of the model's own number.
        lowest = 0.1 * (1 + size) - 1
    elif quantity.base is not None:
        # What is added to a number of the model may be much more than usual.
        highest = ROOM * size
    low = quantity.low if size >= quantity.low else lowest
    high = max(quantity.high, highest)
    return replace(quantity, low=low, high=high)
