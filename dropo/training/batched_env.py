"""Environments in one batch of simulations, each with its own draw of the parameters."""

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

Bools = NDArray[np.bool_]
Seeds = Sequence[int | None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of one step of m environments.

    Attributes
    ----------
    observations : (m, o) array
        Observations after the step.
    rewards : (m,) array
        Rewards, with the bonus.
    bonus : (m,) array
        How much of the rewards is the bonus for being alive.
    terminated : (m,) bool array
        Whether the task ended the episode.
    truncated : (m,) bool array
        Whether the episode reached its length, or its simulation diverged.
    broken : (m,) bool array
        Whether the simulation diverged.
    infos : list of dict
        The `info` of each Gymnasium environment; empty for tasks of a problem.
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
        """Whether each episode is over (m,)."""
        return self.terminated | self.truncated


@dataclass(eq=False)
class _Streams:
    """An environment's random generators, by what they decide."""

    draws: Generator
    starts: Generator
    noise: Generator

    @classmethod
    def from_seed(cls, seed: int | None) -> "_Streams":
        """Return three independent generators."""
        draws, starts, noise = np.random.default_rng(seed).spawn(3)
        return cls(draws, starts, noise)


class BatchedEnv(ABC):
    """Environments in one batch of simulations, whose episodes begin and step independently.

    An environment depends on its own seeds alone, not on the other environments.

    Parameters
    ----------
    name : str
        Name of what is simulated.
    episodes : Episodes
        The simulations, one for each environment.
    fill : callable
        Parameter vectors (m, D) of the simulator from draws (m, d) of the distribution.
    distribution : ParameterDistribution
        Distribution of the parameters, drawn at the start of every episode.
    noise : float or (p,) array, optional
        Variances of the measurement noise; by default those that a fit learned.

    Attributes
    ----------
    count : int
        Number of environments.
    observations : int
        Number o of observed values.
    limits : (2, q) array
        Lowest and highest actions.
    length : int
        Steps of a whole episode.
    draws : (count, d) array
        Parameters of the present episodes.
    steps : int
        Steps made so far, over all environments.
    failures : int
        Number of draws that broke the simulation.
    redraws : int
        How often in a row parameters that break the simulation are drawn again (thesis, section
        5.3).

    Raises
    ------
    BadArgument
        If a noise variance is negative.
    Incompatible
        If there are as many noise variances as neither one nor signals.
    """

    observations: int
    limits: Array
    length: int
    redraws = 20

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
        self._noise_sd = noise_deviation(noise, distribution, len(episodes.simulator.signals))
        self._streams = [_Streams.from_seed(None) for _ in range(self.count)]

    def reset(self, ids: Ints, seeds: Seeds) -> Array:
        """Start an episode in some of the environments.

        Parameters
        ----------
        ids : (m,) int array
            The environments.
        seeds : sequence of int or None
            A seed for each; with None, an environment's random numbers go on.

        Returns
        -------
        (m, o) array
            First observations.

        Raises
        ------
        SimulationFailed
            If MuJoCo refuses `redraws` draws in a row.
        """
        for i, seed in zip(ids.tolist(), seeds, strict=True):
            if seed is not None:
                self._streams[i] = _Streams.from_seed(seed)
        self._draw(ids)
        return self._reset(ids, seeds)

    def step(self, ids: Ints, actions: Array) -> Outcome:
        """Make one step in some of the environments.

        Parameters
        ----------
        ids : (m,) int array
            The environments.
        actions : (m, q) array
            Their actions.

        Returns
        -------
        Outcome
            Observations, rewards and ends.
        """
        outcome = self._step(ids, actions)
        self.steps += len(ids)
        self.failures += int(outcome.broken.sum())
        return outcome

    def describe(self, i: int) -> dict[str, float]:
        """Name the parameters of one environment's present episode.

        Parameters
        ----------
        i : int
            The environment.

        Returns
        -------
        dict of str to float
            By parameter, in its unit.
        """
        return dict(zip(self.distribution.space.names, self.draws[i].tolist(), strict=True))

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Frees what environments hold."""

    @abstractmethod
    def _reset(self, ids: Ints, seeds: Seeds) -> Array:
        """Starts episodes under the models that are set; returns observations (m, o)."""

    @abstractmethod
    def _step(self, ids: Ints, actions: Array) -> Outcome:
        """Makes one step."""

    def _draw(self, ids: Ints) -> None:
        """Draws new parameters; those that MuJoCo refuses are drawn again."""
        for _ in range(self.redraws):
            draws = [
                draw(self.distribution, self._streams[i].draws, self.steps) for i in ids.tolist()
            ]
            values = np.stack(draws)
            self.draws[ids] = values
            refused = ~self.episodes.set(ids, self._fill(values))
            self.failures += int(refused.sum())
            ids = ids[refused]
            if not len(ids):
                return
        raise SimulationFailed(
            f"MuJoCo refused {self.redraws} draws in a row, the last {self.describe(int(ids[0]))}."
        )

    def _measure_rows(self, ids: Ints, rows: Array) -> Array:
        """Returns observation rows (m, P) as sensors with effects and noise measure them."""
        rows = self.episodes.measured(ids, rows)
        if not self._noise_sd.any() or not len(ids):
            return rows
        normals = [
            self._streams[i].noise.standard_normal(len(self._noise_sd)) for i in ids.tolist()
        ]
        return self.episodes.simulator.layout.move(rows, self._noise_sd * np.stack(normals))


def noise_deviation(
    noise: ArrayLike | None, distribution: ParameterDistribution, signals: int
) -> Array:
    """Return the standard deviation of each signal's noise.

    Parameters
    ----------
    noise : float or (p,) array, optional
        Variances; by default those that a fit learned, and 0 where the distribution is no fit.
    distribution : ParameterDistribution
        Distribution of the parameters.
    signals : int
        Number p of signals.

    Returns
    -------
    (p,) array
        Standard deviations, each in the unit of its signal.

    Raises
    ------
    BadArgument
        If a variance is negative.
    Incompatible
        If there are as many variances as neither one nor signals.
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
            f"The noise has {len(variances)} variances, and {signals} signals are observed here. "
            "Give `noise`: one variance, one for each signal, or 0 for none."
        )
    return np.broadcast_to(np.sqrt(variances), (signals,))
