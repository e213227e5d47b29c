"""Environments side by side, each with its own draw of the parameters: what training and evaluation
run policies in.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, require
from dropo.simulators.mujoco.episodes import Episodes
from dropo.training.distributions import ParameterDistribution, draw, variances_of

REDRAWS = 20
"""How often in a row parameters under which the simulation breaks are drawn again (thesis, section
5.3).
"""

Bools = NDArray[np.bool_]
Seeds = Sequence[int | None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """One step of m environments: observations (m, o); rewards (m,), and how much of them is the
    bonus (m,) for being alive.

    terminated, truncated, broken: (m,) bool, whether the episode ended by the task, by its length,
    or because the simulation diverged (which is a truncation too); infos: what Gymnasium's
    environment said, one a mapping.
    """

    observations: Array
    rewards: Array
    bonus: Array
    terminated: Bools
    truncated: Bools
    broken: Bools
    infos: list[dict[str, Any]]

    @property
    def ended(self) -> Bools:
        """(m,) whether the episode is over."""
        return self.terminated | self.truncated


@dataclass(eq=False)
class _Streams:
    """An environment's random numbers, by what they decide."""

    draws: Generator
    starts: Generator
    noise: Generator

    @classmethod
    def of(cls, seed: int | None) -> "_Streams":
        return cls(*np.random.default_rng(seed).spawn(3))


class BatchedEnv(ABC):
    """`count` environments in one batch of simulations; each begins its episodes when it is told
    to.

    name: of what is simulated; observations: o; limits: (2, q) of the actions; length: steps of a
    whole episode; draws: (count, d) the parameters of the present episodes; steps: those made so
    far; failures: draws that broke the simulation. An environment depends on its own seeds alone,
    not on the others.
    """

    observations: int
    limits: Array
    length: int

    def __init__(
        self,
        name: str,
        episodes: Episodes,
        fill: Callable[[Array], Array],
        distribution: ParameterDistribution,
        noise: ArrayLike | None,
    ):
        self.name = name
        self.episodes = episodes
        self.distribution = distribution
        self.count = episodes.count
        self.steps = 0
        self.failures = 0
        self.draws = np.zeros((self.count, len(distribution.space)))
        self._fill = fill
        self._deviation = noise_deviation(noise, distribution, len(episodes.simulator.signals))
        self._streams = [_Streams.of(None) for _ in range(self.count)]

    def reset(self, ids: Ints, seeds: Seeds) -> Array:
        """Starts an episode in the environments `ids` and gives what they observe (m, o).

        A seed of None: random numbers go on.
        """
        for i, seed in zip(ids.tolist(), seeds, strict=True):
            if seed is not None:
                self._streams[i] = _Streams.of(seed)
        self._draw(ids)
        return self._reset(ids, seeds)

    def step(self, ids: Ints, actions: Array) -> Outcome:
        """One step of the environments `ids` under actions (m, q)."""
        outcome = self._step(ids, actions)
        self.steps += len(ids)
        self.failures += int(outcome.broken.sum())
        return outcome

    def describe(self, i: int) -> dict[str, float]:
        """The parameters of environment i's episode by name."""
        return dict(zip(self.distribution.space.names, self.draws[i].tolist(), strict=True))

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Frees what environments hold."""

    @abstractmethod
    def _reset(self, ids: Ints, seeds: Seeds) -> Array:
        """Starts episodes under the models that are set; observations (m, o)."""

    @abstractmethod
    def _step(self, ids: Ints, actions: Array) -> Outcome:
        """One step."""

    def _draw(self, ids: Ints) -> None:
        """New parameters for episodes; those that MuJoCo refuses are drawn again."""
        for _ in range(REDRAWS):
            values = np.stack(
                [draw(self.distribution, self._streams[i].draws, self.steps) for i in ids.tolist()]
            )
            self.draws[ids] = values
            refused = ~self.episodes.set(ids, self._fill(values))
            self.failures += int(refused.sum())
            ids = ids[refused]
            if not len(ids):
                return
        raise SimulationFailed(
            f"MuJoCo refused {REDRAWS} draws in a row, the last {self.describe(int(ids[0]))}."
        )

    def _noisy(self, ids: Ints, rows: Array) -> Array:
        """Observation rows (m, P) as they are measured: by sensors with effects and noise."""
        rows = self.episodes.measured(ids, rows)
        if not self._deviation.any() or not len(ids):
            return rows
        errors = np.stack(
            [self._streams[i].noise.standard_normal(len(self._deviation)) for i in ids.tolist()]
        )
        return self.episodes.simulator.layout.move(rows, self._deviation * errors)


def noise_deviation(
    noise: ArrayLike | None, distribution: ParameterDistribution, signals: int
) -> Array:
    """(p,) the standard deviation of each signal's noise from variances: those given, or else those
    that the fit learned.
    """
    variances = variances_of(distribution) if noise is None else np.asarray(noise, dtype=float)
    if variances is None:
        return np.zeros(signals)
    require(
        bool((np.asarray(variances) >= 0).all()),
        "noise",
        "variances of 0 or more",
        noise,
        "randomize",
    )
    if np.ndim(variances) and len(variances) != signals:
        raise Incompatible(
            f"The noise has {len(variances)} variances, and {signals} signals are observed "
            "here. Give `noise`: one variance, one for"
            " each signal, or 0 for none."
        )
    return np.broadcast_to(np.sqrt(variances), (signals,))
