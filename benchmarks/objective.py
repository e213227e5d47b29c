"""Speed of one objective evaluation, of `predict` beside MuJoCo's own rollout, and of a whole fit:
ratios from one run.

python benchmarks/objective.py            the table of the README; less than three minutes on two
cores python benchmarks/objective.py --tiny     a few seconds, for trying it out
"""

import argparse
import copy
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np

sys.path.insert(
    0, str(Path(__file__).resolve().parents[1])
)  # the slow twin lies beside the tests, not in the package

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Segments
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.problems.hopper.model import BODIES, FRAME_SKIP
from dropo.problems.hopper.problem import hopper
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.reference.published_loop import log_likelihood

EPSILON = 1e-5
PUBLISHED_EVALUATIONS = 5000
PUBLISHED_DRAWS = 100


@dataclass(frozen=True)
class Sizes:
    """K draws and transitions of an evaluation; how many of both the slow loop does, and the draws
    of predict beside rollout; repeats of an evaluation and of predict, of which the median
    counts.
    """

    draws: int = 100
    transitions: int = 1000
    loop_draws: int = 10
    loop_transitions: int = 300
    predict_draws: int = 25
    repeats: int = 3
    predict_repeats: int = 5


TINY = Sizes(draws=10, transitions=200, loop_draws=5, loop_transitions=20, predict_draws=10)


@dataclass(frozen=True)
class Timing:
    """What one way of making an evaluation takes."""

    name: str
    seconds: float
    steps: int

    @property
    def rate(self) -> float:
        """Physics steps a second."""
        return self.steps / self.seconds


def timed(function: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one call."""
    begun = clock()
    function()
    return clock() - begun


def problem_of(sizes: Sizes, threads: int) -> Problem:
    """The hopper with so many transitions."""
    return hopper(threads).using(transitions=sizes.transitions)


def simulator_of(problem: Problem) -> MujocoSimulator:
    """The problem's simulator, as what it is."""
    assert isinstance(problem.simulator, MujocoSimulator)
    return problem.simulator


def truth_of(problem: Problem) -> np.ndarray:
    """(4,) the true masses."""
    assert problem.truth is not None
    return problem.space.vector(problem.truth)


def draws_near_truth(problem: Problem, count: int) -> np.ndarray:
    """(K, 4) masses within 5 % of the truth."""
    truth = truth_of(problem)
    return truth * np.random.default_rng(0).uniform(0.95, 1.05, (count, len(truth)))


def published_loop(sizes: Sizes) -> Timing:
    """The published way, on fewer draws and transitions, its time scaled up to all of them: it is
    linear in both.
    """
    problem = problem_of(sizes, 1)
    model = simulator_of(problem).model
    data = problem.trajectories.head(sizes.loop_transitions)
    masses = draws_near_truth(problem, sizes.loop_draws)
    begun = time.perf_counter()
    _, steps = log_likelihood(model, BODIES, masses, data, EPSILON, FRAME_SKIP)
    seconds = time.perf_counter() - begun
    share = sizes.loop_draws * len(data) / (sizes.draws * sizes.transitions)
    return Timing("published loop, Python", seconds / share, round(steps / share))


def monte_carlo(sizes: Sizes, threads: int) -> Timing:
    """One evaluation of the `monte-carlo` likelihood: draws, predictions, moments and densities."""
    problem = problem_of(sizes, threads)
    family = TruncatedGaussian(problem.space)
    truth = truth_of(problem)
    phi = family.phi(truth, 0.02 * truth)
    objective = MonteCarlo(sizes.draws).bind(
        problem.simulator, problem.segments, family, EPSILON, np.random.default_rng(0)
    )
    seconds = np.median([timed(lambda: objective(phi)) for _ in range(sizes.repeats)])
    return Timing(
        f"monte-carlo, {threads} thread{'s' * (threads > 1)}",
        float(seconds),
        problem.simulator.steps // sizes.repeats,
    )


class Bare:
    """MuJoCo's own rollout on the same work: one call a draw, on its own threads, masses set as a
    user would.
    """

    def __init__(
        self, simulator: MujocoSimulator, segments: Segments, values: np.ndarray, threads: int
    ):
        self.models = [copy.copy(simulator.model) for _ in values]
        for model, draw in zip(self.models, values, strict=True):
            for body, mass in zip(BODIES, draw, strict=True):
                model.body(body).mass[0] = mass
        self.states = np.column_stack(
            [np.zeros((len(segments), 2)), segments.starts]
        )  # time and the distance travelled
        self.controls = np.repeat(segments.actions, simulator.frame_skip, axis=1)
        self.data = [mujoco.MjData(simulator.model) for _ in range(threads)]
        self.rollout = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def run(self) -> None:
        """All draws, all segments."""
        for model in self.models:
            self.rollout.rollout(model, self.data, self.states, self.controls)


def predict_beside_bare(
    sizes: Sizes, threads: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[Timing, Timing, float]:
    """Timings of bare rollout and of predict, in turn, and the median over repeats of their
    throughputs' ratio.
    """
    problem = problem_of(sizes, threads)
    values = draws_near_truth(problem, sizes.predict_draws)
    ways = [
        Bare(simulator_of(problem), problem.segments, values, threads).run,
        lambda: problem.simulator.predict(values, problem.segments),
    ]
    for way in ways:  # the first call fills caches
        way()
    seconds = np.array([[timed(way, clock) for way in ways] for _ in range(sizes.predict_repeats)])
    steps = int(problem.segments.lengths.sum()) * len(values) * FRAME_SKIP
    name = f"K = {len(values)}, {threads} thread{'s' * (threads > 1)}"
    bare, predict = np.median(seconds, axis=0).tolist()
    return (
        Timing(f"bare rollout, {name}", bare, steps),
        Timing(f"predict, {name}", predict, steps),
        float(np.median(seconds[:, 0] / seconds[:, 1])),
    )


def emulated_fit(sizes: Sizes, threads: int) -> Timing:
    """A whole fit with the default settings."""
    fit = DROPO().fit(problem_of(sizes, threads), rng=0)
    return Timing(f"DROPO(), whole fit, {threads} threads", fit.wall_time_s, fit.simulator_steps)


def machine() -> str:
    """What it ran on."""
    return (
        f"{os.cpu_count()} cores, Python {platform.python_version()}, MuJoCo "
        f"{version('mujoco')}, NumPy {np.__version__}"
    )


def table(timings: list[Timing], reference: Timing) -> str:
    """A Markdown table; the last column is the rate as a multiple of the reference's."""
    rows = [
        "| what | seconds | physics steps | steps per second | times the loop's rate |",
        "|---|---|---|---|---|",
    ]
    rows += [
        (
            f"| {t.name} | {t.seconds:.3g} | {t.steps:,} | {t.rate:,.0f} | "
            f"{t.rate / reference.rate:.2f} |"
        )
        for t in timings
    ]
    return "\n".join(rows)


def report(sizes: Sizes) -> str:
    """Everything, in one run."""
    loop = published_loop(sizes)
    timings = [loop, monte_carlo(sizes, 1), monte_carlo(sizes, 2)]
    lines = []
    for threads in (1, 2):
        bare, predict, ratio = predict_beside_bare(sizes, threads)
        timings += [bare, predict]
        lines.append(
            f"predict makes {ratio:.2f} of the steps per second of bare rollout with "
            f"{threads} thread{'s' * (threads > 1)}."
        )
    fit = emulated_fit(sizes, 2)
    published = PUBLISHED_EVALUATIONS * PUBLISHED_DRAWS * sizes.transitions * FRAME_SKIP
    lines.append(
        f"The fit takes {fit.seconds:.1f} s and {fit.steps:,} steps: "
        f"{published / fit.steps:,.0f} times fewer than the "
        f"{published:,} of {PUBLISHED_EVALUATIONS} evaluations with K = {PUBLISHED_DRAWS}. "
        "In its time the loop makes "
        f"{fit.seconds / loop.seconds:.2g} evaluations with K = {sizes.draws}."
    )
    head = f"K = {sizes.draws}, {sizes.transitions} transitions of the hopper; {machine()}."
    note = (
        f"The loop ran K = {sizes.loop_draws} on {sizes.loop_transitions} transitions; time "
        "and steps are scaled up, both linear."
    )
    return "\n".join([head, note, "", table(timings, loop), "", *(f"- {line}" for line in lines)])


def main() -> None:
    """Prints the report."""
    parser = argparse.ArgumentParser(
        description="Prints seconds and steps of one objective evaluation, by several ways."
    )
    parser.add_argument("--tiny", action="store_true", help="small sizes, a few seconds")
    print(report(TINY if parser.parse_args().tiny else Sizes()))


if __name__ == "__main__":
    main()
