"""Randomized environments as Gymnasium has them: one, or many at once."""

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
from dropo.simulators.gymnasium import make_environment, observed_columns
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.mujoco.warnings import suppress_mujoco_warnings
from dropo.training.batched_env import BatchedEnv
from dropo.training.binding import bind, declaring
from dropo.training.distributions import ParameterDistribution, Point
from dropo.training.gymnasium_env import BatchedGymnasiumEnv
from dropo.training.task_env import BatchedTaskEnv, task_of

Target = Any
"""What policies run in: a Problem, its name or file, the id of a Gymnasium environment, or such an
environment.
"""


def randomize(
    target: Target,
    distribution: ParameterDistribution | None = None,
    count: int | None = None,
    *,
    noise: ArrayLike | None = None,
    effects: ActiveEffects = (),
    steps: int | None = None,
    threads: int = 1,
    **options: Any,
) -> "RandomizedEnv | TaskEnv | RandomizedVectorEnv":
    """A Gymnasium environment whose parameters are drawn anew at the start of every episode.

    target: a Gymnasium MuJoCo environment by its id or made, or a Problem with a task, by its name
    or file too. law: a Fit, Uniform or Point, or one of them Widening; None: the model as it is.
    count: None for one environment, else a VectorEnv of so many, each with its own draws, simulated
    together on `threads` threads (0: all cores). noise: variances of the measurement noise, one or
    one a signal; None: those that the fit learned, 0 for none. effects: what a Gymnasium
    environment's machine has beside its model, as `problem.simulator.fixed` of an extended problem;
    a problem brings its own. steps: of an episode. options: of `gymnasium.make`.
    `info["parameters"]` of `reset` has the draw; an episode whose simulation diverges is truncated,
    with `info["broken"]`.
    """
    require(count is None or count >= 1, "count", "None or at least 1", count, "randomize")
    target = resolve(target)
    if count is None and not isinstance(target, Problem):
        return RandomizedEnv(
            _made(target, steps, options), distribution, noise=noise, effects=effects
        )
    made = batched_env(
        target,
        distribution,
        count or 1,
        noise=noise,
        effects=effects,
        steps=steps,
        threads=threads,
        **options,
    )
    return TaskEnv(made) if count is None else RandomizedVectorEnv(made)


def resolve(target: Target) -> Target:
    """A problem by its name or file; ids of Gymnasium and what is no text stay as they are."""
    from dropo.problems.file.reader import is_file, load

    if not isinstance(target, str | Path) or target in gymnasium.registry:
        return target
    if is_file(target) or target in names("problems"):
        return load(target)
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
    """`count` environments in one batch; arguments as for `randomize`."""
    target = resolve(target)
    if isinstance(target, Problem):
        if effects or options:
            raise BadArgument(
                f"The problem {target.name!r} has its own effects and takes no options of "
                "gymnasium.make."
            )
        return _of_problem(target, distribution, count, noise, steps, threads)
    envs = [_made(target, steps, options) for _ in range(count)]
    if count > 1 and envs[0] is target:
        raise Incompatible("Of an environment that is made there is one. Give its id for several.")
    return _of_gymnasium(envs, distribution, noise, effects, threads)


def _made(target: Target, steps: int | None, options: dict[str, Any]) -> Any:
    """A Gymnasium environment by its id, with its wrappers; one that is made, as it is."""
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


def _of_gymnasium(
    envs: Sequence[Any],
    distribution: ParameterDistribution | None,
    noise: ArrayLike | None,
    effects: ActiveEffects,
    threads: int,
) -> BatchedGymnasiumEnv:
    inner = envs[0].unwrapped
    name = getattr(envs[0].spec, "id", type(inner).__name__)
    if not all(hasattr(inner, has) for has in ("model", "data", "frame_skip", "do_simulation")):
        raise Incompatible(
            f"{name!r} is not one of Gymnasium's MuJoCo environments, whose model and "
            "simulation can be reached."
        )
    columns, visible = _columns(name, inner)
    distribution = Point(ParameterSpace(()), np.zeros(0)) if distribution is None else distribution
    simulator = declaring(
        inner.model, distribution, repr(name), columns, int(inner.frame_skip), effects
    )
    free, fill = bind(simulator, distribution, repr(name))
    return BatchedGymnasiumEnv(
        name, envs, free, fill, distribution, visible=visible, noise=noise, threads=threads
    )


def _columns(name: str, inner: Any) -> tuple[tuple[str, ...], bool]:
    """The simulator's observation rows, and whether the environment's observation begins with them."""
    try:
        return tuple(observed_columns(name, inner)), True
    except Incompatible:
        return ("qpos", "qvel"), False


def _of_problem(
    problem: Problem,
    distribution: ParameterDistribution | None,
    count: int,
    noise: ArrayLike | None,
    steps: int | None,
    threads: int,
) -> BatchedTaskEnv:
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        raise Incompatible(
            f"Policies are trained in MuJoCo, and the problem {problem.name!r} has a "
            f"{type(simulator).__name__}."
        )
    task_of(problem)
    distribution = (
        Point(simulator.space, simulator.nominal) if distribution is None else distribution
    )
    free, fill = bind(simulator, distribution, f"the problem {problem.name!r}")
    return BatchedTaskEnv(
        problem, free, fill, distribution, count, noise=noise, steps=steps, threads=threads
    )


ONE = np.zeros(1, dtype=np.int64)


class RandomizedEnv(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """One of Gymnasium's environments with a draw of the parameters for every episode; `arena`
    keeps count of draws that break it.

    env: the environment; law, noise, effects: as for `randomize`.
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
        self.batched_env = _of_gymnasium([env], distribution, noise, effects, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """As `gymnasium.Env.reset`; the same seed gives the same draws, starts and noise."""
        observed = self.batched_env.reset(ONE, [seed])[0]
        return observed.copy(), {"parameters": self.batched_env.describe(0)}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """As `gymnasium.Env.step`."""
        return _one_step(self.batched_env, action)


class TaskEnv(gymnasium.Env[Any, Any]):
    """A problem's task as a Gymnasium environment, with a draw of the parameters for every episode."""

    def __init__(self, made: BatchedEnv):
        self.batched_env = made
        self.observation_space, self.action_space = _spaces(made)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """As `gymnasium.Env.reset`; the same seed gives the same draws, starts and noise."""
        super().reset(seed=seed)
        observed = self.batched_env.reset(ONE, [seed])[0]
        return observed.copy(), {"parameters": self.batched_env.describe(0)}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """As `gymnasium.Env.step`."""
        return _one_step(self.batched_env, action)


def _one_step(made: BatchedEnv, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    found = made.step(ONE, np.ravel(action)[None])
    info = {**found.infos[0], **({"broken": True} if found.broken[0] else {})}
    return (
        found.observations[0].copy(),
        float(found.rewards[0]),
        bool(found.terminated[0]),
        bool(found.truncated[0]),
        info,
    )


def _spaces(made: BatchedEnv) -> tuple[spaces.Box, spaces.Box]:
    """Of observations and actions."""
    if isinstance(made, BatchedGymnasiumEnv):
        return made.envs[0].observation_space, made.envs[0].action_space
    low, high = made.limits.astype(np.float32)
    return spaces.Box(-np.inf, np.inf, (made.observations,), np.float64), spaces.Box(
        low, high, dtype=np.float32
    )


class RandomizedVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Many environments simulated together; one that ended begins anew in the next step, whose
    action it does not take.
    """

    def __init__(self, made: BatchedEnv):
        self.batched_env = made
        self.num_envs = made.count
        self.single_observation_space, self.single_action_space = _spaces(made)
        self.observation_space = batch_space(self.single_observation_space, made.count)
        self.action_space = batch_space(self.single_action_space, made.count)
        self.metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        self._ended = np.zeros(made.count, dtype=bool)
        self._shown = np.zeros((made.count, made.observations))

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """As `gymnasium.vector.VectorEnv.reset`: environment i takes the seed + i."""
        seeds = (
            seed
            if isinstance(seed, list)
            else [None if seed is None else seed + i for i in range(self.num_envs)]
        )
        self._ended[:] = False
        self._shown[:] = self.batched_env.reset(np.arange(self.num_envs), seeds)
        return self._shown.copy(), {"parameters": self._parameters()}

    def step(self, actions: Any) -> tuple[Array, Array, np.ndarray, np.ndarray, dict[str, Any]]:
        """As `gymnasium.vector.VectorEnv.step`."""
        going = np.flatnonzero(~self._ended)
        over = np.flatnonzero(self._ended)
        if len(over):
            self._shown[over] = self.batched_env.reset(over, [None] * len(over))
        rewards, terminated, truncated, broken = (
            np.zeros(self.num_envs),
            *np.zeros((3, self.num_envs), dtype=bool),
        )
        if len(going):
            found = self.batched_env.step(
                going, np.asarray(actions).reshape(self.num_envs, -1)[going]
            )
            self._shown[going], rewards[going] = found.observations, found.rewards
            terminated[going], truncated[going], broken[going] = (
                found.terminated,
                found.truncated,
                found.broken,
            )
        self._ended = terminated | truncated
        return (
            self._shown.copy(),
            rewards,
            terminated,
            truncated,
            {"parameters": self._parameters(), "broken": broken},
        )

    def _parameters(self) -> dict[str, Array]:
        return dict(
            zip(
                self.batched_env.distribution.space.names,
                self.batched_env.draws.T.copy(),
                strict=True,
            )
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the environments."""
        self.batched_env.close()
