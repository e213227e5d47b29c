"""The environments of a problem: its simulator, with the rewards of its task."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.problem import Problem
from dropo.core.records.task import Task
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import command_limits
from dropo.simulators.mujoco.episodes import Episodes
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.batched_env import BatchedEnv, Bools, Outcome, Seeds
from dropo.training.distributions import ParameterDistribution


class BatchedTaskEnv(BatchedEnv):
    """Environments of a problem with a task, simulated together.

    Parameters
    ----------
    problem : Problem
        A problem with a task.
    simulator : MujocoSimulator
        The problem's simulator, in which the distribution's parameters are declared.
    fill : callable
        Parameter vectors (m, D) of the simulator from draws (m, d) of the distribution.
    distribution : ParameterDistribution
        Distribution of the parameters.
    count : int
        Number of environments.
    noise : float or (p,) array, optional
        Variances of the measurement noise; by default those that a fit learned.
    steps : int, optional
        Steps of an episode, by default the task's.
    threads : int
        Number of threads, 0 for all cores.

    Raises
    ------
    Incompatible
        If the problem has no task.
    """

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
        episodes = Episodes(simulator, count, threads=threads)
        super().__init__(problem.name, episodes, fill, distribution, noise)
        self.task = task_of(problem)
        self.length = steps or self.task.steps
        self.goals = self.task.draw_goals(np.random.default_rng(0), count)
        self._controls = simulator.controls
        # the row that each environment measured last, and the steps of its present episode
        self._rows = np.tile(problem.trajectories.observations[:1], (count, 1))
        self._age = np.zeros(count, dtype=np.int64)
        self.limits = self._limits()
        self.observations = self.task.observations(self._rows, self.goals).shape[1]

    def _limits(self) -> Array:
        """Returns the limits (2, q) of the actions, infinite where an actuator has none."""
        if self.task.limits is not None:
            return np.asarray(self.task.limits, dtype=float)
        return command_limits(self.episodes.simulator.model)[:, self._controls]

    def _reset(self, ids: Ints, seeds: Seeds) -> Array:
        streams = [self._streams[i].starts for i in ids.tolist()]
        starts = [self.task.starts(stream, 1) for stream in streams]
        self.episodes.reset(ids, np.concatenate(starts))
        self.goals[ids] = np.concatenate([self.task.draw_goals(stream, 1) for stream in streams])
        self._age[ids] = 0
        return self._observe(ids)

    def _observe(self, ids: Ints) -> Array:
        """Measures the environments `ids` (m,) and returns what the policy observes (m, o)."""
        self._rows[ids] = self._measure_rows(ids, self.episodes.rows(ids))
        return self.task.observations(self._rows[ids], self.goals[ids])

    def _step(self, ids: Ints, actions: Array) -> Outcome:
        before = self.episodes.states(ids)
        actions = np.asarray(actions, dtype=float)
        finite = self._simulate(ids, np.clip(actions, *self.limits), before)
        after = np.where(finite[:, None], self.episodes.states(ids), before)
        self._age[ids] += 1
        # rewards, without those of steps that diverged
        alive = self.task.are_alive(after)
        bonus = np.where(finite & alive, self.task.bonus, 0.0)
        rewards = self.task.rewards(before, actions, after, self.goals[ids])
        rewards = np.where(finite, rewards, 0.0) + bonus
        self._observe(ids[finite])
        return Outcome(
            self.task.observations(self._rows[ids], self.goals[ids]),
            rewards,
            bonus,
            terminated=finite & ~alive,
            truncated=~finite | (self._age[ids] >= self.length),
            broken=~finite,
            infos=[{} for _ in ids],
        )

    def _simulate(self, ids: Ints, actions: Array, before: Array) -> Bools:
        """Simulates the control steps of an action; returns which simulations are finite (m,)."""
        commands = self.task.commands(before, actions)
        controls = np.zeros((*commands.shape[:2], self.episodes.simulator.model.nu))
        controls[:, :, self._controls] = commands
        finite = np.ones(len(ids), dtype=bool)
        for step in range(controls.shape[1]):
            running = np.flatnonzero(finite)
            finite[running] = self.episodes.step(ids[running], controls[running, step])
        return finite


def task_of(problem: Problem) -> Task:
    """Return the task of a problem.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    Task
        Its task.

    Raises
    ------
    Incompatible
        If it has none.
    """
    if problem.task is None:
        raise Incompatible(
            f"The problem {problem.name!r} has no task to train for. Name a reward under "
            "`task` in its problem file (task: {reward: reward.py:function}), or give "
            "Problem(..., task=Task(...))."
        )
    return problem.task
