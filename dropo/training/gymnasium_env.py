"""Gymnasium's MuJoCo environments side by side: their own code for starts, rewards and
observations, our simulations under it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.episodes import Episodes
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.batched_env import BatchedEnv, Outcome, Seeds
from dropo.training.distributions import ParameterDistribution

ALIVE = "reward_survive"
"""What Gymnasium's walkers call the bonus in their infos."""


class _Diverged(Exception):
    """The simulation of an environment left the numbers that MuJoCo can handle."""


class BatchedGymnasiumEnv(BatchedEnv):
    """Gymnasium environments of one kind, whose `do_simulation` is answered from the batch.

    Where an environment hands its action to the simulation once and as it is, as all of Gymnasium's
    do, all of them are simulated together; else each in its turn. With the model as it is, the
    motion is Gymnasium's own, bit for bit. visible: whether the observation begins with the
    simulator's rows, as noise and sensors' effects need.
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
            flags=int(inner.model.opt.disableflags),
            whole=True,
        )
        super().__init__(name, episodes, fill, distribution, noise)
        changed = self._deviation.any() or any(
            instance.measurement is not None or instance.sensor_delay is not None
            for instance, _ in simulator.fixed
        )
        if changed and not visible:
            raise Incompatible(
                f"The observation of {name!r} does not begin with positions and velocities "
                "as they are, so that noise and effects of"
                " sensors have no place in it. Give noise=0, and leave those effects out."
            )
        self._seen = simulator.layout if changed else None
        self.limits = np.array([envs[0].action_space.low, envs[0].action_space.high], dtype=float)
        self.observations = int(np.prod(envs[0].observation_space.shape))
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
        """What the sensors add to observations that begin with the simulator's rows."""
        if self._seen is not None and len(ids):
            rows = self.episodes.rows(ids)
            self._last[ids, : rows.shape[1]] += self._noisy(ids, rows) - rows

    def _step(self, ids: Ints, actions: Array) -> Outcome:
        sound = np.ones(len(ids), dtype=bool)
        if self._together:
            sound = self.episodes.step(ids, actions)
            self._expected = dict(zip(ids.tolist(), actions, strict=True))
        rewards = np.zeros(len(ids))
        bonus = np.zeros(len(ids))
        infos = []
        terminated = np.zeros(len(ids), dtype=bool)
        truncated = np.zeros(len(ids), dtype=bool)
        for k, i in enumerate(ids.tolist()):
            info: dict[str, Any] = {}
            try:
                if not sound[k]:
                    raise _Diverged
                observed, rewards[k], terminated[k], truncated[k], info = self.envs[i].step(
                    actions[k].reshape(self.envs[i].action_space.shape)
                )
                self._last[i], bonus[k] = np.ravel(observed), info.get(ALIVE, 0.0)
            except _Diverged:
                sound[k], truncated[k] = False, True
            infos.append(info)
        self._measure(ids[sound])
        return Outcome(self._last[ids], rewards, bonus, terminated, truncated, ~sound, infos)

    def _simulate(self, i: int, ctrl: Any, frames: int) -> None:
        """In the place of an environment's `do_simulation`."""
        inner = self.envs[i].unwrapped
        if self._together:
            expected = self._expected.pop(i, None)
            if expected is None or not np.array_equal(ctrl, expected):
                raise Incompatible(
                    f"{self.name!r} changes some of its actions before they are simulated. "
                    "Take one environment at a time."
                )
        elif not self.episodes.step(np.array([i]), np.asarray(ctrl, dtype=float)[None], frames)[0]:
            raise _Diverged
        self.episodes.give(i, data=inner.data)
        mujoco.mj_rnePostConstraint(inner.model, inner.data)  # as Gymnasium does behind its steps

    def close(self) -> None:
        """Closes the environments."""
        for env in self.envs:
            env.close()


def _passes_actions_on(env: Any) -> bool:
    """Whether an environment simulates its action as it is, once, for `frame_skip` physics steps:
    found by one step of its own.
    """
    inner = env.unwrapped
    given = []
    simulate = inner.do_simulation

    def watched(ctrl: Any, frames: int) -> None:
        given.append((np.array(ctrl), frames))
        simulate(ctrl, frames)

    inner.do_simulation = watched
    env.reset(seed=int(np.random.default_rng().integers(2**31)))
    action = env.action_space.sample()
    env.step(action)
    inner.do_simulation = simulate
    return (
        len(given) == 1 and np.array_equal(given[0][0], action) and given[0][1] == inner.frame_skip
    )
