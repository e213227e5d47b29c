"""Sliding: policies that hit a puck to goals, for the distributions that each method finds, on a
target that is another simulation.
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

NEAR = 0.05  # [m]
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
class Size:
    """transitions: of a data set, 375 a hit; fits: data sets, and so fits of each method; bounds:
    of uniform randomization; droid, published: evaluations of DROID and of the method as
    published; draws: of a distribution for its policy; grid: latents along each axis that it is
    looked for on.
    """

    transitions: int = 5 * STEPS
    fits: int = 3
    bounds: int = BOUNDS
    droid: int = 500
    published: int = 200
    draws: int = 12
    grid: int = 11


FULL = Size()


def sliding_study(
    work: Work, seeds: int | None = None, *, published: bool = False, size: Size = FULL
) -> Study:
    """Table 6.5 and figure 6.9, simulation against simulation: 18 parameters fitted, and goals that
    a puck is hit to on the target.
    """
    fits = size.fits if seeds is None else seeds
    runs = work.map(slid, items(fits, size.bounds, asdict(size), published=published))
    tables = (
        comparison(runs, NEAR),
        differences(runs),
        found(runs, sliding(1), THESIS),
        cost(runs),
    )
    remarks = (
        *verdict(runs, NEAR),
        f"A run is a fit and its policy, over {len(GOALS)} goals; a policy is the hit, "
        "speed and direction, whose expected reward over the"
        " distribution is highest, for each goal.",
        "The target has numbers of its own for all 18 parameters; besides, its board is "
        "uneven, its puck is seen 12 ms late, and its"
        " sensors have noise, which no model here has.",
        *(
            [
                (
                    f"As published: K = {DRAWS}, epsilon {EPSILON:.0e}, CMA-ES with "
                    f"{size.published} evaluations."
                )
            ]
            if published
            else []
        ),
    )
    title = f"Sliding: a puck hit to {len(GOALS)} goals, {fits} data sets"
    return Study(
        "sliding", title, tables, remarks, {"runs": runs}, lambda figure: draw(figure, runs)
    )


def slid(item: Item) -> dict[str, Any]:
    """The item's distribution, its policy, and where the target's puck stops for every goal."""
    size = Size(**item["size"])
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
    """The latents (g, 2) of highest expected reward for goals (g, 2), under parameter vectors (K,
    d).

    Where the puck stops is simulated on a grid of latents for each vector, with cubic splines
    between.
    """
    axis = np.linspace(-LIMIT, LIMIT, grid)
    fine = np.linspace(-LIMIT, LIMIT, 161)
    rough = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2)
    ends = stops(simulator, values, rough.reshape(-1, 2)).reshape(len(values), grid, grid, 2)
    between = np.array(
        [
            [RectBivariateSpline(axis, axis, end[:, :, i])(fine, fine) for i in range(2)]
            for end in ends
        ]
    )
    best = [
        np.unravel_index(np.argmax(_expected(between, goal)), (len(fine), len(fine)))
        for goal in goals
    ]
    return fine[np.array(best)]


def _expected(ends: Array, goal: Array) -> Array:
    """The mean reward (f, f) over ends (K, 2, f, f)."""
    return np.asarray(reward(np.hypot(ends[:, 0] - goal[0], ends[:, 1] - goal[1])).mean(axis=0))


def on_target(latents: Array, goals: Array) -> Array:
    """(g,) distances [m] between where the target's puck stops and the goals (g, 2)."""
    simulator = sliding_simulator(1)
    ends = stops(sliding_target(simulator), simulator.space.vector(TRUTH)[None], latents)[0]
    return np.asarray(np.linalg.norm(ends - goals, axis=1))
