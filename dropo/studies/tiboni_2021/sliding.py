"""Sliding: policies that strike a puck to goals, for the distributions that each method finds.

The target is another simulation.
"""

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from dropo.core.services.validation import Array
from dropo.problems.panda.sliding import (
    DRAWS,
    EPSILON,
    GOALS,
    STEPS,
    TRUTH,
    reward,
    sliding,
    sliding_simulator,
    sliding_target,
    stops,
)
from dropo.problems.panda.strikes import LIMIT
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.studies.engine.study import Study
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.transfer import (
    BOUNDS,
    Item,
    comparison,
    cost,
    data_set,
    differences,
    distribution,
    draw,
    estimator,
    found,
    items,
    verdict,
)

NEAR = 0.05  # [m] of the goal
THESIS = {
    "thesis, dropo": {
        "puck_mass": "0.111",
        "friction_x": "0.349",
        "friction_y": "0.231",
        "contact_time": "0.019",
    },
    "thesis, droid": {
        "puck_mass": "0.100",
        "friction_x": "0.334",
        "friction_y": "0.226",
        "contact_time": "0.019",
    },
}
"""Table 6.5: means on its real robot."""


@dataclass(frozen=True)
class SlidingStudySize:
    """How large the study is.

    Attributes
    ----------
    transitions : int
        Transitions of a data set, 375 a strike.
    fits : int
        Data sets, and so fits of each method.
    bounds : int
        Bounds of uniform randomization.
    droid, published : int
        Evaluations of DROID, and of the method as published.
    draws : int
        Draws of a distribution for its policy.
    grid : int
        Latents along each axis on which a policy is searched.
    """

    transitions: int = 5 * STEPS
    fits: int = 3
    bounds: int = BOUNDS
    droid: int = 500
    published: int = 200
    draws: int = 12
    grid: int = 11


FULL = SlidingStudySize()


def sliding_study(
    work: Work, seeds: int | None = None, *, published: bool = False, size: SlidingStudySize = FULL
) -> Study:
    """Table 6.5 and figure 6.9, simulation against simulation.

    18 parameters are fitted, and a puck is struck to goals on the target.

    Parameters
    ----------
    work : Work
        Runs the fits and the policies.
    seeds : int or None
        Number of data sets; None for that of `size`.
    published : bool
        Whether the method is also run once as published.
    size : SlidingStudySize
        How large the study is.

    Returns
    -------
    Study
        Distances on the target, what was found, and what it cost.
    """
    fits = size.fits if seeds is None else seeds
    runs = work.map(slid, items(fits, size.bounds, asdict(size), published=published))
    tables = (
        comparison(runs, NEAR),
        differences(runs),
        found(runs, sliding(1), THESIS),
        cost(runs),
    )
    remarks: tuple[str, ...] = (
        *verdict(runs, NEAR),
        f"A run is a fit and its policy, over {len(GOALS)} goals; a policy is the hit, "
        "speed and direction, whose expected reward over the distribution is highest, for each "
        "goal.",
        "The target has numbers of its own for all 18 parameters; besides, its board is "
        "uneven, its puck is seen 12 ms late, and its sensors have noise, which no model here has.",
    )
    if published:
        as_published = f"K = {DRAWS}, epsilon {EPSILON:.0e}, CMA-ES"
        remarks = (*remarks, f"As published: {as_published} with {size.published} evaluations.")
    title = f"Sliding: a puck hit to {len(GOALS)} goals, {fits} data sets"
    return Study(
        "sliding", title, tables, remarks, {"runs": runs}, lambda figure: draw(figure, runs)
    )


def slid(item: Item) -> dict[str, Any]:
    """Fit the item's distribution, make its policy, and run it on the target.

    Parameters
    ----------
    item : dict
        One of `transfer.items`.

    Returns
    -------
    dict
        The distribution, the policy, and how far from every goal the target's puck stops [m].
    """
    size = SlidingStudySize(**item["size"])
    problem = sliding(1, data_set(item)).using(transitions=size.transitions)
    values, kept = distribution(item, problem, estimator(item, DRAWS, EPSILON), size.draws)
    simulator = sliding_simulator(1)
    begun = time.perf_counter()
    latents = policy(simulator, values, GOALS, size.grid)
    seconds = time.perf_counter() - begun
    distances = on_target(latents, GOALS)
    return {
        "method": item["method"],
        "number": item["number"],
        **kept,
        "latents": latents.tolist(),
        "distances": distances.tolist(),
        "rewards": reward(distances).tolist(),
        "policy_steps": simulator.steps,
        "policy_seconds": seconds,
    }


def policy(simulator: MujocoSimulator, values: Array, goals: Array, grid: int) -> Array:
    """The strikes of highest expected reward.

    Where the puck stops is simulated on a grid of latents for each parameter vector, with cubic
    splines between.

    Parameters
    ----------
    simulator : MujocoSimulator
        The simulator of sliding.
    values : (K, d) array
        Parameter vectors over which rewards are averaged.
    goals : (g, 2) array
        Goals [m].
    grid : int
        Number of latents along each axis that are simulated.

    Returns
    -------
    (g, 2) array
        Latents.
    """
    axis = np.linspace(-LIMIT, LIMIT, grid)
    rough = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2)
    ends = stops(simulator, values, rough.reshape(-1, 2)).reshape(len(values), grid, grid, 2)
    fine = np.linspace(-LIMIT, LIMIT, 161)
    fine_ends = np.empty((len(values), 2, len(fine), len(fine)))
    for k, i in np.ndindex(len(values), 2):
        fine_ends[k, i] = RectBivariateSpline(axis, axis, ends[k, :, :, i])(fine, fine)
    best = []
    for goal in goals:
        rewards = _expected_reward(fine_ends, goal)
        best.append(np.unravel_index(np.argmax(rewards), rewards.shape))
    return fine[np.array(best)]


def _expected_reward(ends: Array, goal: Array) -> Array:
    """The mean reward (f, f) over ends (K, 2, f, f) [m]."""
    distances = np.hypot(ends[:, 0] - goal[0], ends[:, 1] - goal[1])
    return np.asarray(reward(distances).mean(axis=0))


def on_target(latents: Array, goals: Array) -> Array:
    """Distances between goals and where the target's puck stops.

    Parameters
    ----------
    latents : (g, 2) array
        A strike for each goal.
    goals : (g, 2) array
        Goals [m].

    Returns
    -------
    (g,) array
        Distances [m].
    """
    simulator = sliding_simulator(1)
    ends = stops(sliding_target(simulator), simulator.space.vector(TRUTH)[None], latents)[0]
    return np.asarray(np.linalg.norm(ends - goals, axis=1))
