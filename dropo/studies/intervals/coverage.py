"""How often 95 % intervals hold the truth: under independent, autocorrelated and start-state noise,
and with friction left out.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array, require
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

REPLICATIONS = 100
AIM = (0.90, 0.98)  # of 95 % intervals
RHO = 0.9  # autocorrelation of the autocorrelated noise from one control step to the next
NOISE = 5e-3  # standard deviation, in each signal's unit
DRY = 0.3  # N, the friction that the model leaves out
BLOCK = np.array([1.5, 0.8])  # kg, N s/m
# trajectories, control steps of each
FEW = (2, 500)
MANY = (25, 40)

METHODS: dict[str, Callable[[], Estimator]] = {
    "least squares": LeastSquares,
    "dropo": lambda: DROPO(family="point", epsilon="learn"),
}
CASES: tuple[tuple[str, str, str, tuple[int, int]], ...] = (
    ("block", "independent", "least squares", MANY),
    ("block", "independent", "least squares", FEW),
    ("block", "independent", "dropo", MANY),
    ("block", "autocorrelated", "least squares", MANY),
    ("block", "autocorrelated", "least squares", FEW),
    ("block", "autocorrelated", "dropo", MANY),
    ("block", "start", "dropo", MANY),
    ("block", "start", "dropo", FEW),
    ("hopper", "independent", "dropo", MANY),
    ("hopper", "autocorrelated", "dropo", MANY),
    ("block", "dry friction", "least squares", MANY),
    ("block", "dry friction", "least squares", FEW),
    ("block", "dry friction", "dropo", MANY),
)
"""Robot, noise, method, and the data's size.

"dry friction": independent noise, and friction that the model does not have.
"""


class DryBlock(SlidingBlock):
    """The sliding block with Coulomb friction beside the viscous one, solved exactly: it slides one
    way until it stops, then stays where the push is weaker than the friction, or slides the
    other way.
    """

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        mass, damping = value
        out = np.empty((*actions.shape[:2], 2))
        x, v = starts.T
        for j, u in enumerate(actions[:, :, 0].T):
            final = (u - DRY * np.sign(v)) / damping
            turns = v * final < 0  # it will stop, after this time
            stop = np.where(
                turns,
                mass / damping * np.log1p(np.where(turns, -v / np.where(turns, final, 1.0), 0.0)),
                np.inf,
            )
            first = np.where(v == 0, 0.0, np.minimum(stop, self.dt))
            x, v = _slide(x, v, final, mass / damping, first)
            v = np.where(first < self.dt, 0.0, v)
            again = np.sign(u) * np.maximum(np.abs(u) - DRY, 0.0) / damping
            x, v = _slide(
                x, v, np.where(first < self.dt, again, v), mass / damping, self.dt - first
            )
            out[:, j] = np.stack([x, v], axis=-1)
        return out


def _slide(x: Array, v: Array, final: Array, lag: float, time: Array) -> tuple[Array, Array]:
    """Position and velocity after a time, towards a final velocity with a time constant."""
    decay = np.exp(-time / lag)
    return x + final * time + (v - final) * (1 - decay) * lag, final + (v - final) * decay


def coverage(
    work: Work,
    seeds: int | None = None,
    *,
    cases: tuple[tuple[str, str, str, tuple[int, int]], ...] = CASES,
) -> Study:
    """The share of data sets whose 95 % intervals hold the truth, and of those where the fit says
    that its model is wrong.
    """
    count = REPLICATIONS if seeds is None else seeds
    require(count >= 2, "seeds", "at least 2", count, "coverage")
    rows = []
    data = {}
    remarks = []
    answers = work.map(
        replication, [[*case[:3], list(case[3]), seed] for case in cases for seed in range(count)]
    )
    for i, (robot, noise, method, (trajectories, steps)) in enumerate(cases):
        own = answers[i * count : (i + 1) * count]
        inside = np.array([answer["inside"] for answer in own])
        flagged = float(np.mean([answer["flagged"] for answer in own]))
        share = inside.mean(axis=0)
        size = f"{trajectories} x {steps}"
        shown = ", ".join(f"{s:.0%} ± {np.sqrt(s * (1 - s) / count):.0%}" for s in share)
        rows.append(
            (f"{robot}, {noise}", size, method, shown, f"{inside.mean():.1%}", f"{flagged:.0%}")
        )
        data[f"{robot}, {noise}, {method}, {size}"] = {
            "coverage": share,
            "flagged": flagged,
            "sentences": sorted({sentence for answer in own for sentence in answer["sentences"]}),
        }
        if noise != "dry friction" and not AIM[0] <= inside.mean() <= AIM[1]:
            remarks.append(
                f"{robot}, {noise}, {method}, {size}: {inside.mean():.1%} is not within "
                f"{AIM[0]:.0%} to {AIM[1]:.0%}."
            )
    header = (
        "data",
        "trajectories",
        "method",
        "coverage of each mean",
        "of all",
        "said to be wrong",
    )
    table = Table("Intervals of 95 %", header, tuple(rows))
    remarks.append(
        f"With a dry friction of {DRY} N left out the intervals cannot hold; the last "
        "column is how often the fit says so."
    )
    return Study(
        "coverage",
        f"Coverage of 95 % intervals, {count} data sets each",
        (table,),
        tuple(remarks),
        data,
    )


def replication(item: list[Any]) -> dict[str, Any]:
    """One data set and its fit: whether each mean's interval holds the truth, and what the fit says
    of its model.
    """
    robot, noise, method, (count, steps), seed = item
    problem, truth = data_set(robot, noise, count, steps, np.random.default_rng([seed, count]))
    fit = METHODS[method]().fit(problem, rng=seed)
    low, high = fit.interval().T
    told = [text for text in fit.warnings if text.startswith("the model is wrong")]
    return {
        "inside": ((low <= truth) & (truth <= high)).tolist(),
        "flagged": not fit.trusted,
        "sentences": told,
    }


def data_set(
    robot: str, noise: str, count: int, steps: int, rng: np.random.Generator
) -> tuple[Problem, Array]:
    """A problem with `count` trajectories of `steps` control steps, and the true parameters."""
    known = ("independent", "autocorrelated", "start", "dry friction")
    require(noise in known, "noise", f"one of {known}", noise, "data_set")
    if robot == "block":
        truth = BLOCK
        forces = np.repeat(rng.normal(0.0, 3.0, (count, -(-steps // 5), 1)), 5, axis=1)[:, :steps]
        simulator = DryBlock() if noise == "dry friction" else SlidingBlock()
        clean = simulate(simulator, np.tile(truth, (count, 1)), forces, np.zeros(2))
        model: Any = SlidingBlock()
    else:
        model = hopper_simulator(threads=1)
        truth = np.array([TRUTH[name] for name in model.space.names])
        clean, _ = simulate_hopper(steps, count, rng=rng)
    before = clean.observations
    after = clean.next_observations
    if (
        noise == "start"
    ):  # one error for each measured state, that of a step's end and of the next one's start
        errors = NOISE * rng.standard_normal((count, steps + 1, before.shape[1]))
        before = before + errors[:, :-1].reshape(before.shape)
        after = after + errors[:, 1:].reshape(after.shape)
    else:
        shape = (count, steps, after.shape[1])
        after = after + (
            autocorrelated(shape, rng)
            if noise == "autocorrelated"
            else NOISE * rng.standard_normal(shape)
        ).reshape(after.shape)
    data = Trajectories(before, clean.actions, after, clean.terminals)
    return Problem(f"{robot}, {noise}", model, data, start_noise=noise == "start"), truth


def autocorrelated(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """(trajectories, steps, signals) of a stationary first-order autoregression along the steps."""
    errors = NOISE * rng.standard_normal(shape)
    for t in range(1, shape[1]):
        errors[:, t] = RHO * errors[:, t - 1] + np.sqrt(1 - RHO**2) * errors[:, t]
    return errors
