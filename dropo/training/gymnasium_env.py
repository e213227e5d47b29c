"""Gymnasium's MuJoCo environments in one batch.

Starts, rewards and observations are computed by Gymnasium's own code, simulations by dropo's.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import add_contact_forces
from dropo.mjmodel.options import disabled
from dropo.simulators.mujoco.episodes import Episodes
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.batched_env import BatchedEnv, Outcome, Seeds
from dropo.training.distributions import ParameterDistribution

ALIVE = "reward_survive"
"""The key of the bonus for being alive in the infos of Gymnasium's walkers."""


class _Diverged(Exception):
    """The simulation of an environment diverged."""


class BatchedGymnasiumEnv(BatchedEnv):
    """Gymnasium environments of one kind, whose `do_simulation` is answered from a batch.

    Where an environment passes its action on to the simulation once and unchanged, as all of
    Gymnasium's do, all environments are simulated together, otherwise one after another. With the
    unchanged model, the motion is Gymnasium's own, bit for bit.

    Parameters
    ----------
    name : str
        Name of the environments.
    envs : sequence of gymnasium.Env
        The environments.
    simulator : MujocoSimulator
        A simulator of their model, in which the distribution's parameters are declared.
    fill : callable
        Parameter vectors (m, D) of the simulator from draws (m, d) of the distribution.
    distribution : ParameterDistribution
        Distribution of the parameters.
    visible : bool
        Whether the observation begins with the simulator's rows, as noise and effects of sensors
        need.
    noise : float or (p,) array, optional
        Variances of the measurement noise; by default those that a fit learned.
    threads : int
        Number of threads, 0 for all cores.

    Raises
    ------
    Incompatible
        If there is noise or an effect of sensors, and `visible` is False.
    """

    def __init__(
        self,
        name: str,
        envs: Sequence[Any],
        simulator: MujocoSimulator,
        fill: Callable[[Array], Array],
        distribution: ParameterDistribution,
        *,
        visible: bool,
        noise: ArrayLike | None = None,
        threads: int = 1,
    ):
        self.envs = list(envs)
        inner = envs[0].unwrapped
        episodes = Episodes(
            simulator,
            len(self.envs),
            threads=threads,
            flags=disabled(inner.model),
            whole=True,
        )
        super().__init__(name, episodes, fill, distribution, noise)
        sensor_effects = any(
            instance.measurement is not None or instance.sensor_delay is not None
            for instance, _ in simulator.fixed
        )
        self._measures = bool(self._noise_sd.any()) or sensor_effects
        if self._measures and not visible:
            raise Incompatible(
                f"The observation of {name!r} does not begin with positions and velocities "
                "as they are, so that noise and effects of sensors have no place in it. "
                "Give noise=0, and leave those effects out."
            )
        self.limits = np.array([envs[0].action_space.low, envs[0].action_space.high], dtype=float)
        self.observations = int(np.prod(envs[0].observation_space.shape))
        # an environment without a limit never ends by its length
        self.length = getattr(envs[0].spec, "max_episode_steps", None) or 10**9
        self._last = np.zeros((self.count, self.observations))
        self._together = _passes_actions_on(envs[0])
        self._expected: dict[int, Array] = {}
        for i, env in enumerate(self.envs):
            env.unwrapped.do_simulation = partial(self._simulate, i)

    def _reset(self, ids: Ints, seeds: Seeds) -> Array:
        for i, seed in zip(ids.tolist(), seeds, strict=True):
            env = self.envs[i]
            self.episodes.give(i, model=env.unwrapped.model)
            self._last[i] = np.ravel(env.reset(seed=seed)[0])
            self.episodes.take(i, env.unwrapped.data)
        self._measure(ids)
        return self._last[ids]

    def _measure(self, ids: Ints) -> None:
        """Adds the errors of sensors to observations, which begin with the simulator's rows."""
        if self._measures and len(ids):
            rows = self.episodes.rows(ids)
            self._last[ids, : rows.shape[1]] += self._measure_rows(ids, rows) - rows

    def _step(self, ids: Ints, actions: Array) -> Outcome:
        m = len(ids)
        finite = np.ones(m, dtype=bool)
        if self._together:
            finite = self.episodes.step(ids, actions)
            self._expected = dict(zip(ids.tolist(), actions, strict=True))
        rewards = np.zeros(m)
        bonus = np.zeros(m)
        terminated = np.zeros(m, dtype=bool)
        truncated = np.zeros(m, dtype=bool)
        infos: list[dict[str, Any]] = [{} for _ in range(m)]
        for k, i in enumerate(ids.tolist()):
            env = self.envs[i]
            action = actions[k].reshape(env.action_space.shape)
            try:
                if not finite[k]:
                    raise _Diverged
                observed, rewards[k], terminated[k], truncated[k], infos[k] = env.step(action)
            except _Diverged:
                finite[k] = False
                truncated[k] = True
            else:
                self._last[i] = np.ravel(observed)
                bonus[k] = infos[k].get(ALIVE, 0.0)
        self._measure(ids[finite])
        return Outcome(self._last[ids], rewards, bonus, terminated, truncated, ~finite, infos)

    def _simulate(self, i: int, ctrl: Any, frames: int) -> None:
        """Takes the place of environment i's `do_simulation`."""
        inner = self.envs[i].unwrapped
        if self._together:
            expected = self._expected.pop(i, None)
            if expected is None or not np.array_equal(ctrl, expected):
                raise Incompatible(
                    f"{self.name!r} changes some of its actions before they are simulated. "
                    "Take one environment at a time."
                )
        else:
            command = np.asarray(ctrl, dtype=float)[None]
            finite = self.episodes.step(np.array([i]), command, frames)
            if not finite[0]:
                raise _Diverged
        self.episodes.give(i, data=inner.data)
        # as Gymnasium does after its steps
        add_contact_forces(inner.model, inner.data)

    def close(self) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()


def _passes_actions_on(env: Any) -> bool:
    """Returns whether an environment simulates its action unchanged, once, for `frame_skip` steps.

    It is found by one step of the environment.
    """
    inner = env.unwrapped
    simulated = []
    simulate = inner.do_simulation

    def record(ctrl: Any, frames: int) -> None:
        simulated.append((np.array(ctrl), frames))
        simulate(ctrl, frames)

    inner.do_simulation = record
    env.reset(seed=int(np.random.default_rng().integers(2**31)))
    action = env.action_space.sample()
    env.step(action)
    inner.do_simulation = simulate
    if len(simulated) != 1:
        return False
    ctrl, frames = simulated[0]
    return np.array_equal(ctrl, action) and frames == inner.frame_skip
