"""What contact forces alone show: the ground's friction, from short windows that are simulated.

A regression projects contact forces out, and how they depend on slip and depth is a matter of the
engine. So windows of a few rows are simulated from the measured states under several frictions,
with all that the regression found. A window is too short to go astray, and feet that slide in it
say which friction they have.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.validation import Array
from dropo.mjmodel.robot_simulator import RobotSimulator

EFFECT = "contact_friction"
"""The effect whose size is found."""
LARGEST = 1e12
"""Squared error that counts most, as of a window that diverged."""


@dataclass(frozen=True)
class ContactSettings:
    """How friction is found from windows.

    Attributes
    ----------
    lengths : (float, float)
        Of the windows [s]. What the longer ones say otherwise is part of the error: an error of a
        start grows along a window, what a friction does is the same.
    windows : int
        The largest number of each length.
    first : int
        So many of them try the factors.
    factors : tuple of float
        On the model's friction, tried first.
    closer : int
        Frictions tried between the neighbours of the best of them, twice: contacts make jumps, and
        a slope is that of many.
    degrees : float
        Degrees of freedom of the Student t by which errors count.
    block : float
        Length of the blocks of time that errors are computed from [s].
    blocks : int
        Smallest number of blocks, where the runs are short.
    folds : int
        Parts of the blocks, each of which is held out once.
    """

    lengths: tuple[float, float] = (0.05, 0.1)
    windows: int = 250
    first: int = 60
    factors: tuple[float, ...] = (0.05, 0.15, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)
    closer: int = 7
    degrees: float = 4.0
    block: float = 1.0
    blocks: int = 20
    folds: int = 5


SETTINGS = ContactSettings()


@dataclass(frozen=True, eq=False)
class FoundFriction:
    """A friction of contacts, as a change of the model's.

    Attributes
    ----------
    instance : EffectInstance
        Whose contacts.
    size, se : float
        What is added to the factor 1, and its standard error.
    gain, gain_se : float
        On windows held out [nats a window], with its standard error.
    before, after : float
        The median error at the windows' ends without and with it, in robust standard deviations of
        each signal.
    blocks : int
        Blocks of time with windows.
    """

    instance: EffectInstance
    size: float
    se: float
    gain: float
    gain_se: float
    before: float
    after: float
    blocks: int

    def is_certain(self, certain: float) -> bool:
        """Tell whether it is there.

        Parameters
        ----------
        certain : float
            Standard errors that size and gain must be away from 0.

        Returns
        -------
        bool
        """
        return abs(self.size) > certain * self.se and self.gain > certain * self.gain_se


def knows_starts(simulator: RobotSimulator) -> bool:
    """Tell whether windows can start: the whole moving state is in the data.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Returns
    -------
    bool
    """
    model = simulator.model
    observed = simulator.layout.observed
    positions = observed("qpos").issuperset(range(model.nq))
    return positions and observed("qvel").issuperset(range(model.nv)) and model.na == 0


def find_friction(
    simulator: RobotSimulator,
    trajectories: Trajectories,
    bias: float,
    settings: ContactSettings = SETTINGS,
) -> FoundFriction | None:
    """Find by which factor the friction of all contacts is another than the model's.

    Parameters
    ----------
    simulator : RobotSimulator
        With all that is known to be missing.
    trajectories : Trajectories
        What was measured.
    bias : float
        Fraction of the friction that is added to its error.
    settings : ContactSettings, optional
        How.

    Returns
    -------
    FoundFriction or None
        None where the model has no contacts, or the runs are too short.
    """
    everywhere = [
        instance
        for instance in instances_of(simulator.effect_context, EFFECT)
        if instance.target is None
    ]
    if not everywhere:
        return None
    windows = []
    for length in settings.lengths:
        horizon = max(1, round(length / simulator.control_step))
        if horizon > max(stop - start for start, stop in trajectories.spans):
            return None
        segments = trajectories.segments(horizon)
        windows.append(segments.take(segments.thin(settings.windows)))
    return _FrictionSearch(simulator, everywhere[0], settings).over(windows, bias)


@dataclass(frozen=True, eq=False)
class _FrictionSearch:
    """Tries sizes of the friction of one instance."""

    simulator: RobotSimulator
    instance: EffectInstance
    settings: ContactSettings

    def over(self, windows: Sequence[Segments], bias: float) -> FoundFriction:
        """What short and long windows say; their difference is part of the error."""
        near = self._interval(windows[0])
        short, long = (self._between(near, segments) for segments in windows)
        error = np.hypot(short.se, bias * (1 + short.size))
        return replace(short, se=float(np.hypot(error, long.size - short.size)))

    def _interval(self, segments: Segments) -> Array:
        """Sizes (K,) between the neighbours of the best, first of the factors, then of closer ones.

        A slope that is not the same on both sides would else move the parabola.
        """
        few = segments.take(segments.thin(self.settings.first))
        sizes = np.array(self.settings.factors) - 1.0
        for _ in range(2):
            errors = self._errors(few, sizes)
            scale = _scale(errors[np.argmin(np.abs(sizes))])
            best = int(np.argmin(self._losses(errors, scale).sum(axis=1)))
            low = float(sizes[max(best - 1, 0)])
            high = float(sizes[min(best + 1, len(sizes) - 1)])
            sizes = np.linspace(low, high, self.settings.closer)
        return sizes

    def _between(self, near: Array, segments: Segments) -> FoundFriction:
        """The best size of an interval, and what it gains."""
        errors = self._errors(segments, np.append(near, 0.0))
        middle = len(near) // 2
        scale = _scale(errors[middle])
        losses = self._losses(errors, scale)
        nominal = losses[-1]
        losses = losses[:-1]
        curve = _Parabola(near)
        blocks = _blocks(segments, self.simulator.control_step, self.settings)
        size, se = curve.minimum(losses, blocks)
        fold = blocks % self.settings.folds
        gains = np.zeros(len(nominal))
        for k in np.unique(fold).tolist():
            own = fold == k
            if not own.all():
                at, _ = curve.minimum(losses[:, ~own], blocks[~own])
                gains[own] = nominal[own] - curve.values(losses[:, own], at)
        by_block = np.bincount(blocks, gains)
        count = len(by_block)
        closest = int(np.argmin(np.abs(near - size)))
        return FoundFriction(
            instance=self.instance,
            size=size,
            se=se,
            gain=float(gains.mean()),
            gain_se=float(by_block.std(ddof=1) * np.sqrt(count) / len(gains)),
            before=_middle(errors[-1], scale),
            after=_middle(errors[closest], scale),
            blocks=count,
        )

    def _errors(self, segments: Segments, sizes: Array) -> Array:
        """(K, N, p) errors at the windows' ends under each size; infinite where one failed."""
        free = self.simulator.with_effects((self.instance,))
        values = np.tile(np.asarray(free.nominal, dtype=float), (len(sizes), 1))
        values[:, -1] = sizes
        errors = free.predict(values, segments) - free.targets(segments)
        self.simulator.steps += free.steps
        return np.where(np.isfinite(errors), errors, np.inf)

    def _losses(self, errors: Array, scale: Array) -> Array:
        """(K, N) negative log-densities of a Student t, less a constant [nats]."""
        nu = self.settings.degrees
        known = np.isfinite(scale)
        squares = np.minimum((errors[:, :, known] / scale[known]) ** 2, LARGEST)
        return np.asarray(0.5 * (nu + 1) * np.log1p(squares / nu).sum(axis=2))


def _scale(errors: Array) -> Array:
    """(p,) robust standard deviations of errors (N, p); infinite for signals without any."""
    middle = np.median(np.abs(errors), axis=0) / 0.6745
    return np.where((middle > 0) & np.isfinite(middle), middle, np.inf)


def _middle(errors: Array, scale: Array) -> float:
    """Root mean square over signals of the median error, in its scale."""
    middle = _scale(errors)[np.isfinite(scale)] / scale[np.isfinite(scale)]
    return float(np.sqrt(np.mean(np.where(np.isfinite(middle), middle, 0.0) ** 2)))


def _blocks(segments: Segments, step: float, settings: ContactSettings) -> Ints:
    """(N,) the block of time in its run that each window belongs to, numbered from 0."""
    spans = segments.trajectories.spans
    total = sum(stop - start for start, stop in spans)
    length = min(settings.block, total * step / settings.blocks)
    runs = np.asarray(segments.trajectory)
    time = (segments.steps[:, 0] - np.array(spans)[runs, 0]) * step
    pairs = np.stack([runs, np.floor(time / length).astype(np.int64)], axis=1)
    return np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1].ravel())


class _Parabola:
    """Parabolas through losses at some sizes (K,), by least squares."""

    def __init__(self, sizes: Array):
        self.sizes = sizes
        self.middle = float(sizes.mean())
        self.half = float(np.ptp(sizes)) / 2
        x = (sizes - self.middle) / self.half
        self.solve = np.linalg.pinv(np.stack([np.ones_like(x), x, x**2], axis=1))

    def values(self, losses: Array, size: float) -> Array:
        """(N,) of each window at a size."""
        x = (size - self.middle) / self.half
        return np.asarray(np.array([1.0, x, x**2]) @ (self.solve @ losses))

    def minimum(self, losses: Array, blocks: Ints) -> tuple[float, float]:
        """Where the sum of losses (K, N) is least, and its standard error by blocks (N,)."""
        parts = self.solve @ losses
        _, slope, bend = parts.sum(axis=1)
        total = losses.sum(axis=1)
        if bend <= 0:
            return float(self.sizes[np.argmin(total)]), np.inf
        x = float(np.clip(-slope / (2 * bend), -1, 1))
        scores = np.bincount(blocks, parts[1] + 2 * x * parts[2])
        scores = scores[np.unique(blocks)]
        count = len(scores)
        spread = np.sqrt(np.sum(scores**2) * count / max(count - 1, 1))
        return self.middle + x * self.half, float(self.half * spread / (2 * bend))
