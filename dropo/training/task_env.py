"""The environments of a problem: its simulator, and its task's rewards in arrays."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.problem import Problem
from dropo.core.records.task import Task
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.episodes import Episodes
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.batched_env import BatchedEnv, Outcome, Seeds
from dropo.training.distributions import ParameterDistribution


class BatchedTaskEnv(BatchedEnv):
    """`count` environments of a problem with a task; steps: of an episode, in place of the task's."""

    def __init__(
        self,
        problem: Problem,
        simulator: MujocoSimulator,
        fill: Callable[[Array], Array],
        distribution: ParameterDistribution,
        count: int,
        *,
        noise: ArrayLike | None = None,
        steps: int | None = None,
        threads: int = 1,
    ):
        super().__init__(
            problem.name, Episodes(simulator, count, threads=threads), fill, distribution, noise
        )
        self.task = task_of(problem)
        self.length = steps or task_of(problem).steps
        self.limits = self._limits()
        self.goals = self.task.draw_goals(np.random.default_rng(0), count)
        self._places = simulator.controls
        self._rows = np.tile(
            problem.trajectories.observations[:1], (count, 1)
        )  # what each one measured last
        self._age = np.zeros(count, dtype=np.int64)
        self.observations = self.task.seen(self._rows, self.goals).shape[1]

    def _limits(self) -> Array:
        if self.task.limits is not None:
            return np.asarray(self.task.limits, dtype=float)
        model = self.episodes.simulator.model
        places = self.episodes.simulator.controls
        limited = np.asarray(model.actuator_ctrllimited[places], dtype=bool)
        return np.where(
            limited, model.actuator_ctrlrange[places].T, np.array([[-np.inf], [np.inf]])
        )

    def _reset(self, ids: Ints, seeds: Seeds) -> Array:
        streams = [self._streams[i].starts for i in ids.tolist()]
        self.episodes.reset(
            ids, np.concatenate([self.task.starts(stream, 1) for stream in streams])
        )
        self.goals[ids] = np.concatenate([self.task.draw_goals(stream, 1) for stream in streams])
        self._age[ids] = 0
        return self._observe(ids)

    def _observe(self, ids: Ints) -> Array:
        self._rows[ids] = self._noisy(ids, self.episodes.rows(ids))
        return self.task.seen(self._rows[ids], self.goals[ids])

    def _step(self, ids: Ints, actions: Array) -> Outcome:
        before = self.episodes.states(ids)
        actions = np.asarray(actions, dtype=float)
        sound = self._move(ids, np.clip(actions, *self.limits), before)
        after = np.where(sound[:, None], self.episodes.states(ids), before)
        self._age[ids] += 1
        lives = self.task.lives(after)
        bonus = np.where(sound & lives, self.task.bonus, 0.0)
        rewards = (
            np.where(sound, self.task.worth(before, actions, after, self.goals[ids]), 0.0) + bonus
        )
        self._observe(ids[sound])
        return Outcome(
            self.task.seen(self._rows[ids], self.goals[ids]),
            rewards,
            bonus,
            terminated=sound & ~lives,
            truncated=~sound | (self._age[ids] >= self.length),
            broken=~sound,
            infos=[{} for _ in ids],
        )

    def _move(self, ids: Ints, actions: Array, before: Array) -> np.ndarray:
        """(m,) bool, which simulations are sound after the control steps of an action."""
        commands = self.task.commands(before, actions)
        sound = np.ones(len(ids), dtype=bool)
        full = np.zeros((*commands.shape[:2], self.episodes.simulator.model.nu))
        full[:, :, self._places] = commands
        for step in range(full.shape[1]):
            going = np.flatnonzero(sound)
            sound[going] = self.episodes.step(ids[going], full[going, step])
        return sound


def task_of(problem: Problem) -> Task:
    """The problem's task; Incompatible where it has none."""
    if problem.task is None:
        raise Incompatible(
            f"The problem {problem.name!r} has no task to train for. Name a reward under "
            "`task` in its problem file"
            " (task: {reward: reward.py:function}), or give Problem(..., task=Task(...))."
        )
    return problem.task
