"""Simulator steps of every row of tables 6.1 to 6.3, beside the Monte-Carlo reference measured in
the same run.

python benchmarks/tables.py            the table, into the README too; some minutes
python benchmarks/tables.py --tiny     small data, for trying it out
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.cost import timed_predictions
from benchmarks.readme import write_block
from dropo.core.contracts.problem import Problem
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.studies.tiboni_2021.hopper_sets import EPSILON, SPREAD, data_set

# of the published method
EVALUATIONS = 5000
DRAWS = 100


@dataclass(frozen=True)
class Row:
    """A fit of one row's data, and one evaluation of the published objective on them.

    fit_seconds, of which simulation seconds in the simulator; reference_*: of the one evaluation.
    """

    name: str
    fit_steps: int
    fit_seconds: float
    simulation: float
    reference_steps: int
    reference_seconds: float

    @property
    def fewer(self) -> float:
        """How many times fewer steps than 5000 evaluations."""
        return EVALUATIONS * self.reference_steps / self.fit_steps

    @property
    def fitting(self) -> float:
        """The share of the fit's time that is not simulation."""
        return 1 - self.simulation / self.fit_seconds


def reference(problem: Problem) -> tuple[int, float]:
    """Steps and seconds of one Monte-Carlo evaluation with K = 100, measured."""
    family = TruncatedGaussian(problem.space)
    truth = problem.space.vector(problem.truth or {})
    assert problem.epsilon is not None
    objective = MonteCarlo(DRAWS).bind(
        problem.simulator, problem.segments, family, problem.epsilon, np.random.default_rng(0)
    )
    before = problem.simulator.steps
    begun = time.perf_counter()
    objective(family.phi(truth, 0.05 * truth))
    return problem.simulator.steps - before, time.perf_counter() - begun


def row(table: str, kind: str, transitions: int) -> Row:
    """The default fit of a table's data set 0, and the reference on the same data."""
    problem, _ = data_set(table, kind, 0, transitions)
    steps, seconds = reference(problem)
    simulation = [0.0]
    with timed_predictions(problem.simulator, simulation):
        fit = DROPO().fit(problem, rng=0)
    return Row(
        f"table {table}, {kind}",
        fit.simulator_steps,
        fit.wall_time_s,
        simulation[0],
        steps,
        seconds,
    )


def report(transitions: int = 1000) -> tuple[str, list[Row]]:
    """All rows, as a Markdown table."""
    rows = [row(table, kind, transitions) for table in SPREAD for kind in EPSILON]
    lines = [
        (
            "| row | steps | s | fitting, share | 5000 evaluations, steps | s, from one "
            "measured | fewer steps | less time |"
        ),
        "|---" * 8 + "|",
    ]
    for r in rows:
        whole = EVALUATIONS * r.reference_seconds
        cost = (
            f"{r.fit_steps:,} | {r.fit_seconds:.1f} | {r.fitting:.0%} | "
            f"{EVALUATIONS * r.reference_steps:,} | {whole:,.0f}"
        )
        lines.append(f"| {r.name} | {cost} | {r.fewer:,.0f} | {whole / r.fit_seconds:,.0f} |")
    return "\n".join(lines), rows


def main() -> None:
    """Prints the table, and puts it into the README where it is of full size."""
    parser = argparse.ArgumentParser(
        description="Prints the cost of each row of tables 6.1 to 6.3 beside those published."
    )
    parser.add_argument("--tiny", action="store_true", help="100 transitions")
    tiny = parser.parse_args().tiny
    text, _ = report(100 if tiny else 1000)
    if not tiny:
        write_block("tables", text)
    print(text)


if __name__ == "__main__":
    main()
