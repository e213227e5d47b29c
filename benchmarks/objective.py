"""Speed of one objective evaluation, of `predict` beside MuJoCo's own rollout, and of a whole fit: ratios from one run.

python benchmarks/objective.py            the table of the README; less than three minutes on two cores
python benchmarks/objective.py --tiny     a few seconds, for trying it out
"""

import argparse
import os
import platform
import sys
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the slow twin lies beside the tests, not in the package

from dropo.core.problem import Problem
from dropo.distributions.truncated_gaussian import TruncatedGaussian
from dropo.estimators.dropo import DROPO
from dropo.likelihoods.gaussian import Gaussian
from dropo.problems.hopper import hopper
from dropo.problems.hopper_model import BODIES
from dropo.simulators.mujoco import MujocoSimulator
from tests.reference.published_loop import log_likelihood

EPSILON = 1e-5
PUBLISHED_EVALUATIONS, PUBLISHED_DRAWS = 5000, 100


@dataclass(frozen=True)
class Sizes:
    """K draws, transitions, and how many of both the slow loop does; repeats of each timing, of which the median counts."""

    draws: int = 100
    transitions: int = 1000
    loop_draws: int = 10
    loop_transitions: int = 300
    repeats: int = 5


TINY = Sizes(draws=10, transitions=200, loop_draws=5, loop_transitions=20, repeats=3)


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


def timed(function) -> float:
    """Seconds of one call."""
    begun = time.perf_counter()
    function()
    return time.perf_counter() - begun


def interleaved(functions, repeats: int) -> list[list[float]]:
    """Seconds (repeats, functions): one call of each in turn, so that a busy machine slows all of them alike."""
    for function in functions:
        function()
    return [[timed(function) for function in functions] for _ in range(repeats)]


def problem_of(sizes: Sizes, threads: int) -> Problem:
    """The hopper with so many transitions."""
    return hopper(threads).using(transitions=sizes.transitions)


def draws_near_truth(problem: Problem, count: int) -> np.ndarray:
    """(K, 4) masses within 5 % of the truth."""
    truth = problem.space.vector(problem.truth)
    return truth * np.random.default_rng(0).uniform(0.95, 1.05, (count, len(truth)))


def published_loop(sizes: Sizes) -> Timing:
    """The published way, on fewer draws and transitions, its time scaled up to all of them: it is linear in both."""
    problem = problem_of(sizes, 1)
    model, data = problem.simulator.model, problem.trajectories.first(sizes.loop_transitions)
    masses = draws_near_truth(problem, sizes.loop_draws)
    begun = time.perf_counter()
    _, steps = log_likelihood(model, BODIES, masses, data, EPSILON, problem.simulator.frame_skip)
    seconds = time.perf_counter() - begun
    share = sizes.loop_draws * len(data) / (sizes.draws * sizes.transitions)
    return Timing("published loop, Python", seconds / share, round(steps / share))


def monte_carlo(sizes: Sizes, threads: int) -> Timing:
    """One evaluation of the `monte-carlo` likelihood: draws, predictions, moments and densities."""
    problem = problem_of(sizes, threads)
    family = TruncatedGaussian(problem.space)
    truth = problem.space.vector(problem.truth)
    phi = family.phi(truth, 0.02 * truth)
    objective = Gaussian(sizes.draws).bind(problem.simulator, problem.segments, family, EPSILON, np.random.default_rng(0))
    seconds = np.median(interleaved([lambda: objective(phi)], sizes.repeats))
    before = problem.simulator.steps
    objective(phi)
    return Timing(f"monte-carlo, {threads} thread{'s' * (threads > 1)}", float(seconds), problem.simulator.steps - before)


class Bare:
    """MuJoCo's own rollout on the same work: one call a draw, on its own threads, masses set as a user would."""

    def __init__(self, simulator: MujocoSimulator, segments, values: np.ndarray, threads: int):
        self.models = [mujoco.MjModel.__copy__(simulator.model) for _ in values]
        for model, draw in zip(self.models, values, strict=True):
            for body, mass in zip(BODIES, draw, strict=True):
                model.body(body).mass[0] = mass
        self.states = np.column_stack([np.zeros((len(segments), 2)), segments.starts])  # time and the distance travelled
        self.controls = np.repeat(segments.actions, simulator.frame_skip, axis=1)
        self.data = [mujoco.MjData(simulator.model) for _ in range(threads)]
        self.rollout = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def run(self) -> None:
        """All draws, all segments."""
        for model in self.models:
            self.rollout.rollout(model, self.data, self.states, self.controls)


def predict_beside_bare(sizes: Sizes, threads: int) -> tuple[Timing, Timing, float]:
    """Timings of bare rollout and of predict, and the median over repeats of their throughputs' ratio."""
    problem = problem_of(sizes, threads)
    values = draws_near_truth(problem, sizes.draws)
    bare = Bare(problem.simulator, problem.segments, values, threads)
    seconds = np.array(interleaved([bare.run, lambda: problem.simulator.predict(values, problem.segments)], sizes.repeats))
    steps = int(problem.segments.lengths.sum()) * len(values) * problem.simulator.frame_skip
    end = f", {threads} thread{'s' * (threads > 1)}"
    first, second = (Timing(name + end, float(s), steps) for name, s in zip(("bare rollout", "predict"), np.median(seconds, axis=0), strict=True))
    return first, second, float(np.median(seconds[:, 0] / seconds[:, 1]))


def emulated_fit(sizes: Sizes, threads: int) -> Timing:
    """A whole fit with the default settings."""
    fit = DROPO().fit(problem_of(sizes, threads), rng=0)
    return Timing(f"DROPO(), whole fit, {threads} threads", fit.wall_time_s, fit.simulator_steps)


def machine() -> str:
    """What it ran on."""
    return f"{os.cpu_count()} cores, Python {platform.python_version()}, MuJoCo {version('mujoco')}, NumPy {np.__version__}"


def table(timings: list[Timing], reference: Timing) -> str:
    """A Markdown table; the last column says how many times faster than the reference."""
    rows = ["| what | seconds | physics steps | steps per second | faster than the loop |", "|---|---|---|---|---|"]
    rows += [f"| {t.name} | {t.seconds:.3g} | {t.steps:,} | {t.rate:,.0f} | {reference.seconds / t.seconds:.1f} |" for t in timings]
    return "\n".join(rows)


def report(sizes: Sizes) -> str:
    """Everything, in one run."""
    loop = published_loop(sizes)
    timings, lines = [loop, monte_carlo(sizes, 1), monte_carlo(sizes, 2)], []
    for threads in (1, 2):
        bare, predict, ratio = predict_beside_bare(sizes, threads)
        timings += [bare, predict]
        lines.append(f"predict makes {ratio:.2f} of the steps per second of bare rollout with {threads} thread{'s' * (threads > 1)}.")
    fit = emulated_fit(sizes, 2)
    published = PUBLISHED_EVALUATIONS * PUBLISHED_DRAWS * sizes.transitions * 4
    lines.append(
        f"The fit takes {fit.seconds:.1f} s and {fit.steps:,} steps: {published / fit.steps:,.0f} times fewer than the "
        f"{published:,} of {PUBLISHED_EVALUATIONS} evaluations with K = {PUBLISHED_DRAWS}, and less time than "
        f"{max(1, np.ceil(fit.seconds / loop.seconds)):.0f} of those evaluations in the loop."
    )
    head = f"K = {sizes.draws}, {sizes.transitions} transitions of the hopper; {machine()}."
    note = f"The loop ran K = {sizes.loop_draws} on {sizes.loop_transitions} transitions; its time and steps are scaled up, as it is linear in both."
    return "\n".join([head, note, "", table(timings, loop), "", *(f"- {line}" for line in lines)])


def main() -> None:
    parser = argparse.ArgumentParser(description="Prints seconds and steps of one objective evaluation, by several ways.")
    parser.add_argument("--tiny", action="store_true", help="small sizes, a few seconds")
    print(report(TINY if parser.parse_args().tiny else Sizes()))


if __name__ == "__main__":
    main()
