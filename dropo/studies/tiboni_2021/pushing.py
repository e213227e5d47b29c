"""Pushing: policies that push a box to a goal, for the distributions that each method finds.

The target is another simulation.
"""

import time
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import body_place
from dropo.mjmodel.names import element_id
from dropo.problems.panda.pusher import boxes_of, drive
from dropo.problems.panda.pushing import (
    DRAWS,
    EPSILON,
    FRAME_SKIP,
    GOAL,
    TRUTH,
    Pusher,
    pushing,
    pushing_simulator,
    target_model,
)
from dropo.simulators.mujoco.closed_loop import fields_of
from dropo.studies.engine.study import Study
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.transfer import (
    BOUNDS,
    Item,
    by_method,
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

NEAR = 0.02  # [m] of the goal
SHIFT = 0.005  # [m] error of the centre of mass
THESIS = {
    "thesis, dropo": {
        "box_mass": "1.065",
        "friction_x": "0.387",
        "friction_y": "0.921",
        "com_x": "0.012",
        "com_y": "-0.032",
    },
    "thesis, droid": {
        "box_mass": "0.826",
        "friction_x": "0.444",
        "friction_y": "0.665",
        "com_x": "-0.028",
        "com_y": "-0.028",
    },
}
"""Table 6.6: means on its real robot, whose bolts were on the other side."""
POLICY = ParameterSpace(
    (
        Parameter("aim", -0.05, 0.05, "m"),
        Parameter("by_turn", -0.3, 0.3, "m"),
        Parameter("by_side", -1.5, 1.5),
        Parameter("short", -0.02, 0.02, "m"),
    )
)
STARTS = np.array([0.005, 0.005, 0.05])
"""Standard deviations [m, m, rad] of where the box stands at first."""
SEEN = 1e-3  # [m, rad] sd of the noise with which a policy sees the box
STEPS = 300  # control steps of 10 ms


@dataclass(frozen=True)
class PushingStudySize:
    """How large the study is.

    Attributes
    ----------
    transitions : int
        Transitions of a data set.
    fits : int
        Data sets, and so fits of each method.
    bounds : int
        Runs of uniform randomization, which take its ten bounds in turn.
    droid, published : int
        Evaluations of DROID, and of the method as published.
    draws : int
        Draws of a distribution in each evaluation of a policy.
    evaluations : int
        Evaluations of policies in a search.
    trials : int
        Tries of each policy on the target.
    """

    transitions: int = 1050
    fits: int = 5
    bounds: int = 2 * BOUNDS
    droid: int = 300
    published: int = 100
    draws: int = 8
    evaluations: int = 96
    trials: int = 20


FULL = PushingStudySize()


def pushing_study(
    work: Work, seeds: int | None = None, *, published: bool = False, size: PushingStudySize = FULL
) -> Study:
    """Table 6.6 and figure 6.10, simulation against simulation.

    A box' centre of mass is found, and the box is pushed 24 cm on the target.

    Parameters
    ----------
    work : Work
        Runs the fits and the policies.
    seeds : int or None
        Number of data sets; None for that of `size`.
    published : bool
        Whether the method is also run once as published.
    size : PushingStudySize
        How large the study is.

    Returns
    -------
    Study
        Distances on the target, what was found, and what it cost.
    """
    fits = size.fits if seeds is None else seeds
    runs = work.map(pushed, items(fits, size.bounds, asdict(size), published=published))
    tables = (
        comparison(runs, NEAR, rewards=False),
        differences(runs),
        found(runs, pushing(1), THESIS),
        cost(runs),
    )
    remarks: tuple[str, ...] = (
        *verdict(runs, NEAR),
        _centre(runs),
        f"A run is a fit and its policy, tried {size.trials} times from boxes that stand a "
        "little elsewhere; a policy's actions are joint accelerations, and its four numbers are "
        "those of least expected distance over the distribution, by CMA-ES.",
        "The target's bolts move its box' centre of mass by 3 cm; besides, they change its "
        "inertia and its height, the arm's gains are others, and its sensors have noise, which no "
        "model here has.",
    )
    if published:
        as_published = f"K = {DRAWS}, epsilon {EPSILON:.0e}, CMA-ES"
        remarks = (*remarks, f"As published: {as_published} with {size.published} evaluations.")
    title = f"Pushing: a box pushed {100 * GOAL:.0f} cm ahead, {fits} data sets"
    return Study(
        "pushing", title, tables, remarks, {"runs": runs}, lambda figure: draw(figure, runs)
    )


def _centre(runs: list[dict[str, Any]]) -> str:
    """How well DROPO finds the centre of mass."""
    place = list(TRUTH).index("com_y")
    errors = np.abs(by_method(runs, "mean")["dropo"][:, place] - TRUTH["com_y"])
    within = "within" if errors.max() <= SHIFT else "not within"
    return (
        f"DROPO finds the centre of mass, {1000 * TRUTH['com_y']:.0f} mm aside, to "
        f"{1000 * errors.max():.2g} mm at worst: {within} 5 mm."
    )


def pushed(item: Item) -> dict[str, Any]:
    """Fit the item's distribution, search its policy, and try it on the target.

    Parameters
    ----------
    item : dict
        One of `transfer.items`.

    Returns
    -------
    dict
        The distribution, the policy, and how far from the goal the target's box stops in every
        trial [m].
    """
    size = PushingStudySize(**item["size"])
    problem = pushing(1, data_set(item)).using(transitions=size.transitions)
    values, kept = distribution(item, problem, estimator(item, DRAWS, EPSILON), size.draws)
    begun = time.perf_counter()
    rng = np.random.default_rng([7, item["number"]])
    numbers, steps = policy(values, size, rng)
    seconds = time.perf_counter() - begun
    trials = np.tile(numbers, (size.trials, 1))
    distances = ends(target_model(), trials, {}, np.random.default_rng([8, item["number"]]))
    return {
        "method": item["method"],
        "number": item["number"],
        **kept,
        "policy": numbers.tolist(),
        "distances": distances.tolist(),
        "policy_steps": steps,
        "policy_seconds": seconds,
    }


def policy(values: Array, size: PushingStudySize, rng: np.random.Generator) -> tuple[Array, int]:
    """Searches the policy of least expected distance by CMA-ES.

    Parameters
    ----------
    values : (K, d) array
        Parameter vectors over which distances are averaged.
    size : PushingStudySize
        How many of them are taken, and the evaluations of the search.
    rng : numpy.random.Generator
        Source of the starts, of the noise and of the search.

    Returns
    -------
    numbers : (4,) array
        The policy's numbers.
    steps : int
        Simulator steps that it took.
    """
    own = values[np.arange(size.draws) % len(values)]
    model, fields = fields_of(pushing_simulator(1), own)
    randomness, search = rng.spawn(2)
    seed = int(randomness.integers(2**63))  # every policy meets the same starts and the same noise
    optimizer = find("optimizers", "cma-es")(len(POLICY), search, restarts=0)
    evaluations = 0
    while evaluations < size.evaluations:
        # Every candidate with every parameter vector.
        points = optimizer.ask()
        numbers = np.repeat(POLICY.from_unit(points), size.draws, axis=0)
        tiled = {}
        for name, array in fields.items():
            tiled[name] = np.tile(array, (len(points), *(1,) * (array.ndim - 1)))
        distances = ends(model, numbers, tiled, np.random.default_rng(seed), same=size.draws)
        optimizer.tell(points, distances.reshape(len(points), -1).mean(axis=1))
        evaluations += len(points)
    return POLICY.from_unit(optimizer.best[0]), evaluations * size.draws * STEPS * FRAME_SKIP


def ends(
    model: mujoco.MjModel,
    numbers: Array,
    fields: dict[str, Array],
    rng: np.random.Generator,
    *,
    same: int | None = None,
) -> Array:
    """Distances of boxes to the goal after policies.

    Parameters
    ----------
    model : mujoco.MjModel
        The arm with the box.
    numbers : (n, 4) array
        Numbers of the policies.
    fields : dict of (n, 1, ...) arrays
        Fields of the model in each run.
    rng : numpy.random.Generator
        Source of the starts and of the noise with which policies see the box.
    same : int or None
        Starts repeat after so many runs; None if every run has its own.

    Returns
    -------
    (n,) array
        Distances [m]; 1 m if a simulation diverged.
    """
    count = len(numbers)
    starts = np.resize(STARTS * rng.standard_normal((same or count, 3)), (count, 3))
    place = body_place(model, element_id(model, "body", "box"))[:2]
    runs = drive(
        model,
        Pusher(numbers, place),
        starts,
        STEPS,
        frame_skip=FRAME_SKIP,
        noise=SEEN,
        fields=fields,
        rng=rng,
    )
    last = boxes_of(runs.states[:, -1])
    return np.nan_to_num(np.hypot(last[:, 0] - place[0] - GOAL, last[:, 1] - place[1]), nan=1.0)
