"""Randomized environments with Gymnasium's interface: one, or many at once."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from dropo.core.contracts.effect import ActiveEffects
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible, UnknownName
from dropo.core.services.registry import names
from dropo.core.services.validation import Array, nearest, require
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.gymnasium import make_environment, observed_columns
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.batched_env import BatchedEnv
from dropo.training.binding import bind, declare
from dropo.training.distributions import ParameterDistribution, Point, predictive
from dropo.training.gymnasium_env import BatchedGymnasiumEnv
from dropo.training.task_env import BatchedTaskEnv, task_of

Target = Any
"""A Problem, its name or file, the id of a Gymnasium environment, or such an environment."""
FIRST = np.zeros(1, dtype=np.int64)
"""The ids of a batch of one environment."""


def randomize(
    target: Target,
    distribution: ParameterDistribution | None = None,
    count: int | None = None,
    *,
    noise: ArrayLike | None = None,
    effects: ActiveEffects = (),
    steps: int | None = None,
    threads: int = 1,
    uncertainty: bool = True,
    **options: Any,
) -> "RandomizedEnv | TaskEnv | RandomizedVectorEnv":
    """Make a Gymnasium environment whose parameters are drawn anew for every episode.

    `info["parameters"]` of `reset` holds the draw. An episode whose simulation diverges is
    truncated, with `info["broken"]`.

    Parameters
    ----------
    target : Problem, str, Path or gymnasium.Env
        A Gymnasium MuJoCo environment or its id, or a problem with a task, its name or file.
    distribution : ParameterDistribution, optional
        A Fit, Uniform or Point, or a Curriculum of one of them; None for the model as it is.
    count : int, optional
        Number of environments, each with its own draws, that are simulated together in a VectorEnv;
        by default one environment that is no VectorEnv.
    noise : float or (p,) array, optional
        Variances of the measurement noise, one or one a signal; by default those that the fit
        learned, 0 for none.
    effects : sequence of (EffectInstance, array)
        Effects of a Gymnasium environment's robot beside its model, as `problem.simulator.fixed` of
        an extended problem. A problem brings its own.
    steps : int, optional
        Steps of an episode, by default the target's.
    threads : int
        Number of threads, 0 for all cores.
    uncertainty : bool
        Whether draws of a fit hold what is not known of its means (see `Predictive`).
    **options
        Options of `gymnasium.make`.

    Returns
    -------
    gymnasium.Env or gymnasium.vector.VectorEnv
        The environment.

    Raises
    ------
    BadArgument
        If `count` is below 1, a noise variance is negative, or the target takes no `effects`,
        `steps` or `options`.
    UnknownName
        If there is no such target, or the simulator has no such parameter or effect.
    Incompatible
        If the target is not simulated by MuJoCo or has no task, or `distribution`, `noise` or
        `count` does not fit it.
    """
    require(count is None or count >= 1, "count", "None or at least 1", count, "randomize")
    target = resolve(target)
    if uncertainty and distribution is not None:
        distribution = predictive(distribution)
    if count is None and not isinstance(target, Problem):
        env = _gymnasium_env(target, steps, options)
        return RandomizedEnv(env, distribution, noise=noise, effects=effects)
    batch = batched_env(
        target,
        distribution,
        count or 1,
        noise=noise,
        effects=effects,
        steps=steps,
        threads=threads,
        **options,
    )
    return TaskEnv(batch) if count is None else RandomizedVectorEnv(batch)


def resolve(target: Target, *, trusted: bool = True) -> Target:
    """Load a problem by its name or file.

    Parameters
    ----------
    target : Problem, str, Path or gymnasium.Env
        The target. Ids of Gymnasium, problems and environments are returned as they are.
    trusted : bool
        As in `dropo.load`.

    Returns
    -------
    Problem, str or gymnasium.Env
        The target.

    Raises
    ------
    UnknownName
        If there is no problem and no Gymnasium environment of that name.
    """
    from dropo.problems.loading import is_file, load

    if not isinstance(target, str | Path) or target in gymnasium.registry:
        return target
    if is_file(target) or target in names("problems"):
        return load(target, trusted=trusted)
    raise UnknownName(
        f"No problem and no Gymnasium environment called {str(target)!r}. "
        f"{nearest(target, [*names('problems'), *gymnasium.registry])}"
    )


def batched_env(
    target: Target,
    distribution: ParameterDistribution | None,
    count: int,
    *,
    noise: ArrayLike | None = None,
    effects: ActiveEffects = (),
    steps: int | None = None,
    threads: int = 1,
    **options: Any,
) -> BatchedEnv:
    """Make environments that are simulated together.

    Parameters
    ----------
    target, distribution, noise, effects, steps, threads, **options
        As for `randomize`.
    count : int
        Number of environments.

    Returns
    -------
    BatchedEnv
        The environments.

    Raises
    ------
    BadArgument, UnknownName, Incompatible
        As for `randomize`.
    """
    target = resolve(target)
    if isinstance(target, Problem):
        if effects or options:
            raise BadArgument(
                f"The problem {target.name!r} has its own effects and takes no options of "
                "gymnasium.make."
            )
        return _batch_of_problem(target, distribution, count, noise, steps, threads)
    envs = [_gymnasium_env(target, steps, options) for _ in range(count)]
    if count > 1 and envs[0] is target:
        raise Incompatible("Of an environment that is made there is one. Give its id for several.")
    return _batch_of_gymnasium(envs, distribution, noise, effects, threads)


def _gymnasium_env(target: Target, steps: int | None, options: dict[str, Any]) -> Any:
    """Returns an environment by its id, with its wrappers; an environment is returned as it is."""
    if not isinstance(target, str):
        if steps is not None or options:
            raise BadArgument(
                "An environment that is made has its own steps and options. Give its id to "
                "choose them."
            )
        return target
    make_environment(target, options).close()  # refuses with the nearest id
    with suppress_mujoco_warnings():
        return gymnasium.make(target, max_episode_steps=steps, **options)


def _batch_of_gymnasium(
    envs: Sequence[Any],
    distribution: ParameterDistribution | None,
    noise: ArrayLike | None,
    effects: ActiveEffects,
    threads: int,
) -> BatchedGymnasiumEnv:
    """Returns Gymnasium's MuJoCo environments as a batch; refuses others."""
    inner = envs[0].unwrapped
    name = getattr(envs[0].spec, "id", type(inner).__name__)
    needed = ("model", "data", "frame_skip", "do_simulation")
    if not all(hasattr(inner, attribute) for attribute in needed):
        raise Incompatible(
            f"{name!r} is not one of Gymnasium's MuJoCo environments, whose model and "
            "simulation can be reached."
        )
    if distribution is None:
        distribution = Point(ParameterSpace(()), np.zeros(0))
    columns, visible = _columns(name, inner)
    owner = repr(name)
    simulator = declare(inner.model, distribution, owner, columns, int(inner.frame_skip), effects)
    simulator, fill = bind(simulator, distribution, owner)
    return BatchedGymnasiumEnv(
        name, envs, simulator, fill, distribution, visible=visible, noise=noise, threads=threads
    )


def _columns(name: str, inner: Any) -> tuple[tuple[str, ...], bool]:
    """Returns the columns of the simulator's rows, and whether observations begin with them."""
    try:
        return tuple(observed_columns(name, inner)), True
    except Incompatible:
        return ("qpos", "qvel"), False


def _batch_of_problem(
    problem: Problem,
    distribution: ParameterDistribution | None,
    count: int,
    noise: ArrayLike | None,
    steps: int | None,
    threads: int,
) -> BatchedTaskEnv:
    """Returns a problem's environments as a batch; refuses where it has no task or no MuJoCo."""
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        raise Incompatible(
            f"Policies are trained in MuJoCo, and the problem {problem.name!r} has a "
            f"{type(simulator).__name__}."
        )
    task_of(problem)  # refuses where there is none
    if distribution is None:
        distribution = Point(simulator.space, simulator.nominal)
    simulator, fill = bind(simulator, distribution, f"the problem {problem.name!r}")
    return BatchedTaskEnv(
        problem, simulator, fill, distribution, count, noise=noise, steps=steps, threads=threads
    )


class RandomizedEnv(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """A Gymnasium environment with a draw of the parameters for every episode.

    Parameters
    ----------
    env : gymnasium.Env
        One of Gymnasium's MuJoCo environments.
    distribution, noise, effects
        As for `randomize`.

    Attributes
    ----------
    batched_env : BatchedEnv
        A batch of this environment alone; its `failures` counts the draws that broke it.

    Raises
    ------
    BadArgument, UnknownName, Incompatible
        As for `randomize`.
    """

    def __init__(
        self,
        env: Any,
        distribution: ParameterDistribution | None = None,
        *,
        noise: ArrayLike | None = None,
        effects: ActiveEffects = (),
    ):
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, distribution=distribution, noise=noise, effects=effects
        )
        gymnasium.Wrapper.__init__(self, env)
        self.batched_env = _batch_of_gymnasium([env], distribution, noise, effects, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Draw parameters and begin an episode, as `gymnasium.Env.reset`.

        Parameters
        ----------
        seed : int, optional
            The same seed gives the same draws, starts and noise; with None, random numbers go on.
        options : dict, optional
            Ignored.

        Returns
        -------
        observation : (o,) array
            First observation.
        info : dict
            The draw under "parameters", by name.
        """
        return _reset_one(self.batched_env, seed)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make a control step, as `gymnasium.Env.step`.

        Parameters
        ----------
        action : (q,) array_like
            The action, in the units of the action space.

        Returns
        -------
        observation : array
            The next observation.
        reward : float
            The step's reward.
        terminated, truncated : bool
            Whether the episode has ended, or was cut off.
        info : dict
            With "broken" where the simulation broke.
        """
        return _step_one(self.batched_env, action)


class TaskEnv(gymnasium.Env[Any, Any]):
    """A problem's task as a Gymnasium environment, with a draw of the parameters for every episode.

    Parameters
    ----------
    batch : BatchedEnv
        A batch of one environment.

    Attributes
    ----------
    batched_env : BatchedEnv
        That batch; its `failures` counts the draws that broke it.
    """

    def __init__(self, batch: BatchedEnv):
        self.batched_env = batch
        self.observation_space, self.action_space = _spaces(batch)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Draw parameters and begin an episode, as `gymnasium.Env.reset`.

        Parameters
        ----------
        seed : int, optional
            The same seed gives the same draws, starts and noise; with None, random numbers go on.
        options : dict, optional
            Ignored.

        Returns
        -------
        observation : (o,) array
            First observation.
        info : dict
            The draw under "parameters", by name.
        """
        super().reset(seed=seed)
        return _reset_one(self.batched_env, seed)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make a control step, as `gymnasium.Env.step`.

        Parameters
        ----------
        action : (q,) array_like
            The action, in the units of the action space.

        Returns
        -------
        observation : array
            The next observation.
        reward : float
            The step's reward.
        terminated, truncated : bool
            Whether the episode has ended, or was cut off.
        info : dict
            With "broken" where the simulation broke.
        """
        return _step_one(self.batched_env, action)


def _reset_one(batch: BatchedEnv, seed: int | None) -> tuple[Any, dict[str, Any]]:
    """Returns what `gymnasium.Env.reset` returns, of a batch of one environment."""
    observations = batch.reset(FIRST, [seed])
    return observations[0].copy(), {"parameters": batch.describe(0)}


def _step_one(batch: BatchedEnv, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    """Returns what `gymnasium.Env.step` returns, of a batch of one environment."""
    outcome = batch.step(FIRST, np.ravel(action)[None])
    info = dict(outcome.infos[0])
    if outcome.broken[0]:
        info["broken"] = True
    return (
        outcome.observations[0].copy(),
        float(outcome.rewards[0]),
        bool(outcome.terminated[0]),
        bool(outcome.truncated[0]),
        info,
    )


def _spaces(batch: BatchedEnv) -> tuple[spaces.Box, spaces.Box]:
    """Returns the spaces of observations and actions of one environment."""
    if isinstance(batch, BatchedGymnasiumEnv):
        return batch.envs[0].observation_space, batch.envs[0].action_space
    low, high = batch.limits.astype(np.float32)
    observations = spaces.Box(-np.inf, np.inf, (batch.observations,), np.float64)
    return observations, spaces.Box(low, high, dtype=np.float32)


class RandomizedVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Many environments simulated together.

    An environment whose episode ended is reset in the next step, whose action it ignores.

    Parameters
    ----------
    batch : BatchedEnv
        The environments.

    Attributes
    ----------
    batched_env : BatchedEnv
        The environments; its `failures` counts the draws that broke them.
    """

    def __init__(self, batch: BatchedEnv):
        self.batched_env = batch
        self.num_envs = batch.count
        self.single_observation_space, self.single_action_space = _spaces(batch)
        self.observation_space = batch_space(self.single_observation_space, batch.count)
        self.action_space = batch_space(self.single_action_space, batch.count)
        self.metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        self._ended = np.zeros(batch.count, dtype=bool)
        self._observations = np.zeros((batch.count, batch.observations))

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Reset all, as `gymnasium.vector.VectorEnv.reset`.

        Parameters
        ----------
        seed : int or list of int, optional
            A seed for each environment, or an integer to which environment i adds i.
        options : dict, optional
            Ignored.

        Returns
        -------
        observations : (count, o) array
            First observations.
        info : dict
            The draws under "parameters", by name (count,).
        """
        seeds: list[int | None]
        if isinstance(seed, list):
            seeds = seed
        elif seed is None:
            seeds = [None] * self.num_envs
        else:
            seeds = [seed + i for i in range(self.num_envs)]
        self._ended[:] = False
        self._observations[:] = self.batched_env.reset(np.arange(self.num_envs), seeds)
        return self._observations.copy(), {"parameters": self._parameters()}

    def step(self, actions: Any) -> tuple[Array, Array, np.ndarray, np.ndarray, dict[str, Any]]:
        """Make a control step of all environments, as `gymnasium.vector.VectorEnv.step`.

        An environment whose episode ended in the step before is reset instead.

        Parameters
        ----------
        actions : (count, q) array_like
            An action for each environment.

        Returns
        -------
        observations : (count, o) array
            The next observations.
        rewards : (count,) array
            Rewards; 0 where an environment is reset.
        terminated, truncated : (count,) bool arrays
            Whether episodes have ended, or were cut off.
        info : dict
            The parameters of the present episodes, and which simulations are broken.
        """
        rewards = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=bool)
        truncated = np.zeros(self.num_envs, dtype=bool)
        broken = np.zeros(self.num_envs, dtype=bool)
        running = np.flatnonzero(~self._ended)
        ended = np.flatnonzero(self._ended)
        if len(ended):
            self._observations[ended] = self.batched_env.reset(ended, [None] * len(ended))
        if len(running):
            actions = np.asarray(actions).reshape(self.num_envs, -1)
            outcome = self.batched_env.step(running, actions[running])
            self._observations[running] = outcome.observations
            rewards[running] = outcome.rewards
            terminated[running] = outcome.terminated
            truncated[running] = outcome.truncated
            broken[running] = outcome.broken
        self._ended = terminated | truncated
        info = {"parameters": self._parameters(), "broken": broken}
        return self._observations.copy(), rewards, terminated, truncated, info

    def _parameters(self) -> dict[str, Array]:
        """Returns the draws (count,) of each parameter, by name."""
        names = self.batched_env.distribution.space.names
        return dict(zip(names, self.batched_env.draws.T.copy(), strict=True))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments.

        Parameters
        ----------
        **kwargs
            Without effect.
        """
        self.batched_env.close()
