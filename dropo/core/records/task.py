"""What a policy is to do on a simulator: where episodes begin, their rewards and their ends."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from dropo.core.services.validation import Array, check_shape, require


@dataclass(frozen=True, eq=False)
class Task:
    """A task on a simulator, by functions of m simulations at once.

    The functions use no state but their arguments. A state (m, nq + nv) has positions before
    velocities. With `goals`, `reward` and `observe` take the goals (m, g) as their last argument.

    Attributes
    ----------
    reward : callable
        reward(before, actions, after) gives the reward (m,) of a step, from the states around it
        and the policy's actions (m, q).
    starts : callable
        starts(rng, n) gives states (n, nq + nv) in which episodes begin.
    steps : int
        The policy's steps in a whole episode.
    alive : callable or None
        alive(states) gives (m,) bool; an episode ends with the step after which it is False.
    bonus : float
        Added to the reward of each step after which the simulation is alive; a search may leave it
        out, as it rewards standing still.
    observe : callable or None
        observe(rows) gives the policy's observations (m, o) from observation rows (m, P). None:
        the rows, with the goals behind them.
    goals : callable or None
        goals(rng, n) gives a goal (n, g) for each episode.
    controls : callable or None
        controls(states, actions) gives the commands (m, H, c) of H control steps for one action.
        None: the action is the command of one step.
    limits : (2, q) array or None
        The lowest and highest actions; None: the control ranges of the actuators.
    source : Any
        How a problem file names the task.

    Raises
    ------
    BadArgument
        If `steps` is less than 1 or `limits` has another shape.
    """

    reward: Callable[..., Array]
    starts: Callable[[Generator, int], Array]
    _: KW_ONLY
    steps: int
    alive: Callable[[Array], NDArray[np.bool_]] | None = None
    bonus: float = 0.0
    observe: Callable[..., Array] | None = None
    goals: Callable[[Generator, int], Array] | None = None
    controls: Callable[[Array, Array], Array] | None = None
    limits: Array | None = None
    source: Any = None

    def __post_init__(self) -> None:
        require(self.steps >= 1, "steps", "at least 1", self.steps, "Task")
        if self.limits is not None:
            check_shape("limits", np.asarray(self.limits), (2, None), "Task")

    def draw_goals(self, rng: Generator, n: int) -> Array:
        """Draw the goals of episodes.

        Parameters
        ----------
        rng : numpy.random.Generator
            Draws them.
        n : int
            Number of episodes.

        Returns
        -------
        (n, g) array
            A row for each episode; g is 0 if the task has no goals.
        """
        if self.goals is None:
            return np.zeros((n, 0))
        return np.asarray(self.goals(rng, n), dtype=float)

    def rewards(self, before: Array, actions: Array, after: Array, goals: Array) -> Array:
        """Evaluate the rewards of a step, without the bonus.

        Parameters
        ----------
        before, after : (m, nq + nv) array
            The states around the step.
        actions : (m, q) array
            The policy's actions.
        goals : (m, g) array
            The episodes' goals.

        Returns
        -------
        (m,) array

        Raises
        ------
        BadArgument
            If the task's reward has another shape.
        """
        given = (before, actions, after) if self.goals is None else (before, actions, after, goals)
        rewards = np.asarray(self.reward(*given), dtype=float)
        check_shape("reward", rewards, (len(after),), "Task")
        return rewards

    def are_alive(self, states: Array) -> NDArray[np.bool_]:
        """Evaluate which episodes go on after their states.

        Parameters
        ----------
        states : (m, nq + nv) array
            The states after a step.

        Returns
        -------
        (m,) array of bool

        Raises
        ------
        BadArgument
            If the task's `alive` gives another shape.
        """
        if self.alive is None:
            return np.ones(len(states), dtype=bool)
        alive = np.asarray(self.alive(states), dtype=bool)
        check_shape("alive", alive, (len(states),), "Task")
        return alive

    def observations(self, rows: Array, goals: Array) -> Array:
        """Make the policy's observations.

        Parameters
        ----------
        rows : (m, P) array
            Observation rows of m simulations.
        goals : (m, g) array
            The goal of each episode.

        Returns
        -------
        (m, o) array
            What `observe` makes of both; the rows with the goals beside them where the task has
            none.
        """
        if self.observe is None:
            return np.concatenate([rows, goals], axis=1)
        given = (rows,) if self.goals is None else (rows, goals)
        return np.asarray(self.observe(*given), dtype=float)

    def commands(self, states: Array, actions: Array) -> Array:
        """Make the commands of the H control steps for which an action is held.

        Parameters
        ----------
        states : (m, nq + nv) array
            States in which the actions are given.
        actions : (m, q) array
            Actions of the policy.

        Returns
        -------
        (m, H, c) array
            What `controls` makes of both; the actions themselves, H = 1, where the task has none.
        """
        if self.controls is None:
            return actions[:, None]
        return np.asarray(self.controls(states, actions), dtype=float)
