"""What a policy is to do on a simulator: where episodes begin, what a step is worth, when an
episode ends.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from dropo.core.services.validation import Array, check_shape, require


@dataclass(frozen=True, eq=False)
class Task:
    """A task on a simulator; its functions take m simulations at once, and use no state beside what
    they are given.

    reward(before, actions, after) -> (m,): what a step was worth, from the states (m, nq + nv)
    around it, positions before velocities, and the policy's actions (m, q). starts(rng, n) -> (n,
    nq + nv): states in which episodes begin. steps: the policy's steps in a whole episode.
    alive(states) -> (m,) bool: an episode ends with the step after which it is False.
    bonus: what each step is worth on top that leaves the simulation alive; a search may leave it
    out, as it rewards standing still. observe(rows) -> (m, o): what the policy sees of the
    observation rows (m, P); left out, the rows.

    goals(rng, n) -> (n, g): a goal for each episode; `reward` and `observe` then take goals (m, g)
    last, and without `observe` the policy sees them behind the rows. controls(states, actions) ->
    (m, H, c): the commands of H control steps for one action; left out, the action is the command
    of one. limits: (2, q) the lowest and highest actions; left out, the control ranges of the
    actuators. source: how a problem file names the task.
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
        """(n, g) goals; g = 0 where there are none."""
        return (
            np.zeros((n, 0)) if self.goals is None else np.asarray(self.goals(rng, n), dtype=float)
        )

    def worth(self, before: Array, actions: Array, after: Array, goals: Array) -> Array:
        """(m,) the reward without the bonus."""
        given = (before, actions, after) if self.goals is None else (before, actions, after, goals)
        rewards = np.asarray(self.reward(*given), dtype=float)
        check_shape("reward", rewards, (len(after),), "Task")
        return rewards

    def lives(self, states: Array) -> NDArray[np.bool_]:
        """(m,) bool, which episodes go on."""
        if self.alive is None:
            return np.ones(len(states), dtype=bool)
        lives = np.asarray(self.alive(states), dtype=bool)
        check_shape("alive", lives, (len(states),), "Task")
        return lives

    def seen(self, rows: Array, goals: Array) -> Array:
        """(m, o) what the policy sees."""
        if self.observe is None:
            return np.concatenate([rows, goals], axis=1)
        return np.asarray(
            self.observe(rows) if self.goals is None else self.observe(rows, goals), dtype=float
        )

    def commands(self, states: Array, actions: Array) -> Array:
        """(m, H, c) one command a control step."""
        return (
            actions[:, None]
            if self.controls is None
            else np.asarray(self.controls(states, actions), dtype=float)
        )
