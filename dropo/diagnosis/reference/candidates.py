"""What may differ in a run: numbers that describe it, and others that these can express."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.diagnosis.search.library import instances_for
from dropo.mjmodel.robot_simulator import RobotSimulator

LESS = "<0"
MORE = ">0"
"""What a name may end with where a difference can have one sign alone."""


@dataclass(frozen=True)
class PossibleDifference:
    """One number in which a run may differ.

    Attributes
    ----------
    effect, target, variant, quantity, unit
        As in `Difference`.
    low, high : float
        What may be added to the number of the reference runs.
    instance : EffectInstance or None
        None of a declared parameter.
    """

    effect: str
    target: str | None
    variant: str
    quantity: str
    unit: str
    low: float
    high: float
    instance: EffectInstance | None = None

    @property
    def label(self) -> str:
        """As of `Difference`."""
        return self.target or "" if self.instance is None else self.instance.label

    @property
    def family(self) -> str:
        """What varies alike among normal runs: one effect at all its places."""
        if self.instance is None:
            return self.label
        everywhere = "" if self.target else " of all"
        return f"{self.effect}/{self.quantity}{everywhere}"


def effect_candidates(problem: Problem, effects: Sequence[str]) -> list[PossibleDifference]:
    """List the numbers of effects, in their order.

    Parameters
    ----------
    problem : Problem
        With a MuJoCo model.
    effects : sequence of str
        Names, or EFFECT:PLACE; with "<0" or ">0" behind it, differences of that sign alone.

    Returns
    -------
    list of PossibleDifference
        Those instances that have one number; an effect of several at once has none.

    Raises
    ------
    UnknownName
        If there is no such effect or place.
    BadArgument
        If none of an effect's instances has a single number.
    """
    found = []
    for text in effects:
        name = text.removesuffix(LESS).removesuffix(MORE)
        single = [one for one in instances_for(problem, [name]) if len(one.quantities) == 1]
        if not single:
            raise BadArgument(
                f"A comparison of runs takes effects of one number at each place. Got {text!r},"
                " which has several at all of them."
            )
        for instance in single:
            quantity = instance.quantities[0]
            low = 0.0 if text.endswith(MORE) else quantity.low
            high = 0.0 if text.endswith(LESS) else quantity.high
            found.append(
                PossibleDifference(
                    instance.effect,
                    instance.target,
                    instance.variant,
                    quantity.name,
                    quantity.unit,
                    low,
                    high,
                    instance,
                )
            )
    return found


def parameter_candidates(simulator: RobotSimulator) -> list[PossibleDifference]:
    """List the declared parameters, which may differ to both sides.

    Parameters
    ----------
    simulator : RobotSimulator
        Whose parameters they are.

    Returns
    -------
    list of PossibleDifference
        One for each of the d parameters, in the order of the simulator's space.
    """
    return [
        PossibleDifference("parameter", own.name, "", "value", own.unit, -np.inf, np.inf)
        for own in simulator.space
    ]


def responses(
    simulator: RobotSimulator, instances: Sequence[EffectInstance], values: Array, windows: Segments
) -> Array:
    """How predictions respond to parameters and effects, in units of what is unexplained.

    Parameters
    ----------
    simulator : RobotSimulator
        With d parameters.
    instances : sequence of EffectInstance
        J effects of one number each.
    values : (d,) array
        The parameters; the effects are at 0.
    windows : Segments
        R compared rows.

    Returns
    -------
    (R p, d + J) array
    """
    extended = simulator.with_effects(instances)
    centre = np.concatenate([values, np.zeros(len(instances))])
    predicted, jacobian = extended.linearize(centre, windows)
    residual = extended.targets(windows) - predicted
    residual = residual - np.median(residual, axis=0)
    # 1.4826 median absolute deviations are a standard deviation of a normal law.
    spread = 1.4826 * np.median(np.abs(residual), axis=0)
    spread = np.where(spread > 0, spread, np.maximum(residual.std(axis=0), 1e-12))
    scaled = jacobian / spread[:, None]
    return np.asarray(scaled.reshape(-1, jacobian.shape[2]))


def independent(columns: Array, least: float) -> list[int]:
    """Choose columns of which none is nearly a combination of those chosen before.

    Parameters
    ----------
    columns : (n, K) array
        In the order in which they are tried.
    least : float
        Part of a column's length that the ones before must leave.

    Returns
    -------
    list of int
    """
    chosen: list[int] = []
    basis = np.zeros((len(columns), 0))
    for k in range(columns.shape[1]):
        length = np.linalg.norm(columns[:, k])
        rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
        if length > 0 and np.linalg.norm(rest) > least * length:
            chosen.append(k)
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return chosen
