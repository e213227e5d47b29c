"""What the residuals of a fit look like: the usual effects that a model lacks, each tried once."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.kept_rows import KeptRows
from dropo.core.records.trajectories import Segments
from dropo.core.services.registry import find
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True)
class LikelyCauseSettings:
    """What is tried, and when it is said.

    Attributes
    ----------
    effects : tuple of str
        The effects that first models lack most often, at every place; commands together.
    segments : int
        About so many segments are simulated for each trial, if `steps` allows it.
    steps : int
        The simulated segments have about so many control steps in all, at most.
    places : int
        Trials at most; beyond them, every second or third place is left out.
    share : float
        An effect is named that explains at least this fraction of the residuals' mean square.
    outlier : float
        Standard deviations at which a residual is cut.
    factor : float
        How many times larger or smaller than its trial an effect may come out that does not act in
        proportion to its size.
    """

    effects: tuple[str, ...] = (
        "actuator_delay",
        "joint_friction",
        "joint_damping",
        "joint_armature",
        "actuator_gain",
        "joint_stiffness",
    )
    segments: int = 200
    steps: int = 4000
    places: int = 80
    share: float = 0.2
    outlier: float = 4.0
    factor: float = 2.0


SETTINGS = LikelyCauseSettings()


def likely_cause(
    problem: Problem, mean: Array, jacobian: KeptRows, settings: LikelyCauseSettings = SETTINGS
) -> str | None:
    """Say which usual effect explains most of a fit's residuals.

    To first order, with the declared parameters free beside each effect: a hint, and no diagnosis.

    Parameters
    ----------
    problem : Problem
        With R compared rows of p signals.
    mean : (d,) array
        The fitted means.
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions there.
    settings : LikelyCauseSettings

    Returns
    -------
    str or None
        A sentence; None where no usual effect explains much, or the simulator is no robot's.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return None
    chosen = problem.segments.thin(_count(problem.segments, settings))
    segments = problem.segments.take(chosen)
    base = simulator.predict(mean[None], segments)[0]
    residual = simulator.targets(segments) - base
    good = np.isfinite(residual).all(axis=1)
    rows = np.isin(problem.segments.rows[0], chosen)
    free = _Free(residual, jacobian[rows], good, settings)
    trials = _trials(simulator, settings)
    if not trials:  # a free body has neither joints nor drives
        return None
    best = (settings.share, "")
    for (instance, size), moved in zip(
        trials, _tried(simulator, mean, trials, segments), strict=True
    ):
        if not np.isfinite(moved[good]).all():
            continue
        share, coefficient = free.explained(moved - base)
        within = 1 / settings.factor < coefficient < settings.factor
        if share > best[0] and (within or (instance.quantities[0].smooth and coefficient)):
            best = (share, _sentence(instance, size * coefficient, share))
    return best[1] or None


def _count(segments: Segments, settings: LikelyCauseSettings) -> int:
    """How many segments are simulated."""
    longest = int(segments.lengths.max())
    return max(1, min(settings.segments, settings.steps // longest))


def _trials(
    simulator: RobotSimulator, settings: LikelyCauseSettings
) -> list[tuple[EffectInstance, float]]:
    """Each effect with a size to try it at; several, where it does not act in proportion to it."""
    found = []
    for name in settings.effects:
        for instance in find("effects", name)(simulator.effect_context):
            if len(instance.quantities) > 1 or (name == "actuator_delay" and instance.target):
                continue
            quantity = instance.quantities[0]
            probes = quantity.probes[1:2] if quantity.smooth else quantity.probes
            found += [(instance, probe) for probe in probes]
    stride = -(-len(found) // settings.places)
    return found[:: max(1, stride)]


def _tried(
    simulator: RobotSimulator,
    mean: Array,
    trials: list[tuple[EffectInstance, float]],
    segments: Segments,
) -> Array:
    """(K, R, p) predictions at the means with each of K effects, one at a time."""
    instances = list(dict.fromkeys(instance for instance, _ in trials))
    values = np.zeros((len(trials), len(mean) + len(instances)))
    values[:, : len(mean)] = mean
    for row, (instance, size) in zip(values, trials, strict=True):
        row[len(mean) + instances.index(instance)] = size
    changed = simulator.with_effects(instances)
    predicted = changed.predict(values, segments)
    simulator.steps += changed.steps
    return predicted


class _Free:
    """Residuals beside which the declared parameters are free, each signal in units of its own."""

    def __init__(
        self, residual: Array, jacobian: Array, good: Array, settings: LikelyCauseSettings
    ):
        self.good = good
        kept = residual[good]
        scale = np.sqrt(np.mean(kept**2, axis=0))
        self.scale = np.where(scale > 0, scale, np.inf)
        cut = np.clip(kept / self.scale, -settings.outlier, settings.outlier)
        columns = (jacobian[good] / self.scale[:, None]).reshape(cut.size, -1)
        self.basis = np.linalg.qr(columns)[0]
        self.rest = self._without_parameters(cut.ravel())

    def _without_parameters(self, values: Array) -> Array:
        """What the declared parameters do not explain."""
        out: Array = values - self.basis @ (self.basis.T @ values)
        return out

    def explained(self, response: Array) -> tuple[float, float]:
        """The share of the residuals' square that a response explains, and how often it must be
        taken.
        """
        own = self._without_parameters((response[self.good] / self.scale).ravel())
        square = float(own @ own)
        if square < 1e-12 * self.rest.size:
            return 0.0, 0.0
        product = float(own @ self.rest)
        return product**2 / (square * float(self.rest @ self.rest)), product / square


def _sentence(instance: EffectInstance, size: float, share: float) -> str:
    """The effect, where, how large, and what it explains."""
    quantity = instance.quantities[0]
    place = "of all commands" if instance.target is None else f"at {instance.target}"
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    return (
        f"the residuals look like {instance.effect.replace('_', ' ')} {place}, {quantity.name} "
        f"about {number(size, 2)}{unit}, which explains {share:.0%} of their square: run `dropo "
        "diagnose`"
    )
