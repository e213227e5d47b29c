"""What the residuals of a fit look like: the usual effects that a model lacks, each tried once."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.kept_rows import KeptRows
from dropo.core.numerics.tails import normal_tail
from dropo.core.records.independent_units import units_of
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.evaluation.model_check import evident_signals, groups_with_draws, score_of_sum
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
    fewest : int
        Of fewer segments there is no trial.
    share : float
        Of residuals that speak against the model already, an effect is named that explains at least
        this fraction of their mean square.
    level : float
        The probability, over all trials, that an effect speaks against a right model.
    outlier : float
        Standard deviations at which a residual is cut.
    factor : float
        An effect that does not act in proportion to its size may come out so many times smaller
        than its smallest trial, or larger than its largest.
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
    fewest: int = 20
    share: float = 0.2
    level: float = 0.001
    outlier: float = 4.0
    factor: float = 2.0


SETTINGS = LikelyCauseSettings()


@dataclass(frozen=True)
class LikelyCause:
    """The usual effect that explains most of a fit's residuals.

    Attributes
    ----------
    sentence : str
        What they look like.
    share : float
        The fraction of their mean square that it explains.
    certain : bool
        Whether a right model would not leave residuals that look like any usual effect so much.
    large : bool
        Whether it explains enough to be named where the model is known to be wrong.
    """

    sentence: str
    share: float
    certain: bool
    large: bool


def likely_cause(
    problem: Problem,
    mean: Array,
    jacobian: KeptRows,
    epsilon: Array,
    affordable: float = np.inf,
    settings: LikelyCauseSettings = SETTINGS,
) -> LikelyCause | None:
    """Find the usual effect that explains most of a fit's residuals.

    To first order, with the declared parameters free beside each effect: a hint, and no diagnosis.
    Each is a score test too, which sees what features of state and command do not: how the model
    itself would have moved.

    Parameters
    ----------
    problem : Problem
        With R compared rows of p signals.
    mean : (d,) array
        The fitted means.
    jacobian : (R, p, d) array, in memory or in a file
        Of the predictions there.
    epsilon : (p,) array
        The fit's noise variances.
    affordable : float
        Simulator steps that the trials may take.
    settings : LikelyCauseSettings

    Returns
    -------
    LikelyCause or None
        None where no usual effect acts, the residuals are no evidence, the simulator is no robot's,
        or too few segments can be afforded.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return None
    trials = _trials(simulator, settings)
    if not trials:  # a free body has neither joints nor drives
        return None
    each = problem.segments.lengths.max() * simulator.steps_per_action * (len(trials) + 1)
    count = min(_count(problem.segments, settings), int(min(affordable / each, settings.segments)))
    if count < min(settings.fewest, len(problem.segments.lengths)):
        return None
    chosen = problem.segments.thin(count)
    segments = problem.segments.take(chosen)
    base = simulator.predict(mean[None], segments)[0]
    rows = np.isin(problem.segments.rows[0], chosen)
    targets = simulator.targets(segments)
    free = _Free(base, targets, jacobian[rows], segments, epsilon, settings)
    if not free.evident.any():
        return None

    found: list[tuple[float, float, str]] = []
    moved = _tried(simulator, mean, trials, segments)
    for trial, predicted in zip(trials, moved, strict=True):
        if not np.isfinite(predicted[free.good]).all():
            continue
        share, coefficient, score = free.explained(predicted - base)
        size = trial.size * coefficient
        if trial.low < size < trial.high:
            found.append((share, score, _sentence(trial.instance, size, share)))
    if not found:
        return None
    share, _, sentence = max(found)
    largest = max(abs(score) for _, score, _ in found)
    certain = 2 * normal_tail(largest) * len(trials) < settings.level
    return LikelyCause(sentence, share, bool(certain), share > settings.share)


def _count(segments: Segments, settings: LikelyCauseSettings) -> int:
    """How many segments are simulated."""
    longest = int(segments.lengths.max())
    return max(1, min(settings.segments, settings.steps // longest))


@dataclass(frozen=True, eq=False)
class _Trial:
    """An effect, the size at which it is tried, and the sizes that its response stands for."""

    instance: EffectInstance
    size: float
    low: float
    high: float


def _trials(simulator: RobotSimulator, settings: LikelyCauseSettings) -> list[_Trial]:
    """Each effect at a size; at several, where it does not act in proportion to it."""
    found: list[_Trial] = []
    for name in settings.effects:
        instances = list(instances_of(simulator.effect_context, name))
        if name == "actuator_delay" and len(instances) > 1:  # that of all commands, not of each
            instances = [instance for instance in instances if instance.target is None]
        for instance in instances:
            if len(instance.quantities) > 1:
                continue
            quantity = instance.quantities[0]
            if instance.parameters[0].name in simulator.space.names:  # it is fitted
                continue
            if quantity.smooth:
                probes = quantity.probes[1:2]
                found += [_Trial(instance, one, quantity.low, quantity.high) for one in probes]
                continue
            # Each of several stands for the sizes that are nearest to it.
            sizes = np.sort(quantity.probes)
            between = np.sqrt(sizes[1:] * sizes[:-1])
            ends = [sizes[0] / settings.factor, *between, sizes[-1] * settings.factor]
            for size, low, high in zip(sizes, ends[:-1], ends[1:], strict=True):
                found.append(_Trial(instance, float(size), float(low), float(high)))
    stride = -(-len(found) // settings.places)
    return found[:: max(1, stride)]


def _tried(
    simulator: RobotSimulator, mean: Array, trials: list[_Trial], segments: Segments
) -> Array:
    """(K, R, p) predictions at the means with each of K effects, one at a time."""
    instances = list(dict.fromkeys(trial.instance for trial in trials))
    values = np.zeros((len(trials), len(mean) + len(instances)))
    values[:, : len(mean)] = mean
    for row, trial in zip(values, trials, strict=True):
        row[len(mean) + instances.index(trial.instance)] = trial.size
    changed = simulator.with_effects(instances)
    predicted = changed.predict(values, segments)
    simulator.steps += changed.steps
    return predicted


class _Free:
    """Residuals beside which the declared parameters are free, each signal in units of its own.

    Where groups may each have a draw of them, they are free in each.
    """

    def __init__(
        self,
        predicted: Array,
        targets: Array,
        jacobian: Array,
        segments: Segments,
        epsilon: Array,
        settings: LikelyCauseSettings,
    ):
        residual = targets - predicted
        self.good = np.asarray(np.isfinite(residual).all(axis=1))
        kept = residual[self.good]
        self.evident = evident_signals(kept, targets[self.good], epsilon)
        scale = np.sqrt(np.mean(kept**2, axis=0))
        self.scale = np.where(self.evident, scale, np.inf)
        cut = np.clip(kept / self.scale, -settings.outlier, settings.outlier)
        slopes = jacobian[self.good] / self.scale[:, None]
        group = groups_with_draws(segments, residual.shape[1], jacobian.shape[2])[self.good]
        self._basis = [_basis(slopes, np.flatnonzero(group == one)) for one in np.unique(group)]
        self.rest = self._without_parameters(cut)
        self._units = units_of(segments)

    def _without_parameters(self, values: Array) -> Array:
        """What of (n, p) values the declared parameters do not explain."""
        out = values.copy()
        for rows, basis in self._basis:
            own = values[rows].ravel()
            out[rows] -= (basis @ (basis.T @ own)).reshape(len(rows), -1)
        return out

    def explained(self, response: Array) -> tuple[float, float, float]:
        """The share of the residuals' square that a response (R, p) explains, how often it must be
        taken, and the normal score of its product with them.
        """
        own = self._without_parameters(response[self.good] / self.scale)
        square = float(np.sum(own**2))
        if square < 1e-12 * self.rest.size:
            return 0.0, 0.0, 0.0
        by_row = np.zeros((len(self.good), 1))
        by_row[self.good, 0] = np.sum(own * self.rest, axis=1)
        product = float(by_row.sum())
        share = product**2 / (square * float(np.sum(self.rest**2)))
        return share, product / square, float(score_of_sum(by_row, self._units)[0])


def _basis(slopes: Array, rows: Ints) -> tuple[Ints, Array]:
    """Some rows, and an orthonormal basis of what parameters do to them, from slopes (n, p, d)."""
    columns = slopes[rows].reshape(-1, slopes.shape[2])
    return rows, np.linalg.qr(columns)[0]


def _sentence(instance: EffectInstance, size: float, share: float) -> str:
    """The effect, where, how large, and what it explains."""
    quantity = instance.quantities[0]
    place = f"at {instance.target}"
    if instance.target is None:
        place = f"of all {instance.variant or 'commands'}"
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    return (
        f"the residuals look like {instance.effect.replace('_', ' ')} {place}, {quantity.name} "
        f"about {number(size, 2)}{unit}, which explains {share:.0%} of their square: run `dropo "
        "diagnose`"
    )
