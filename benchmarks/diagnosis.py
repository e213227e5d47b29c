"""Where the simulator steps of a diagnosis go: a table of stages for each problem.

python benchmarks/diagnosis.py                        the hopper, half-cheetah, walker and an arm
python benchmarks/diagnosis.py hopper one 3100 3101   one machine, one case, some seeds
python benchmarks/diagnosis.py --kept                 what `diagnosis.json` has

Runs that `diagnosis.json` has are not made again; the tables are of all that it has by then.

Cases are those of the study of hidden effects. Steps count as the diagnosis counts them, and as
evaluations of the equations of motion, of which Runge and Kutta take four a step. Repeats are
simulations of a window that were made before, with the same numbers from the same start. With one
thread, all seconds are processor time.
"""

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import numbers, read_kept
from dropo import Diagnose
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Segments
from dropo.core.services.files.atomic_write import write_json
from dropo.core.services.validation import Array
from dropo.mjmodel.options import integrator
from dropo.studies.hidden_effects import study

KEPT = Path(__file__).with_name("diagnosis.json")
MACHINES = ("hopper", "half-cheetah", "walker2d", "position-arm")
CASES = ("nothing", "one")
SEEDS = (3100, 3101, 3102)
STAGES = {
    ("wiring", "wiring_of"): "wiring",
    ("quick", "*"): "regression",
    ("search", "FarOffSearch"): "whole motions",
    ("window_length", "*"): "length of windows",
    ("arithmetic", "*"): "more exact steps",
    ("selection", "begin"): "the model as it is",
    ("screening", "*"): "screening",
    ("selection", "only_by_feedback"): "single steps",
    ("selection", "try_candidates"): "trials",
    ("selection", "polish"): "fits to the end",
    ("review", "*"): "review",
    ("discovery", "*"): "laws",
    ("stability", "*"): "stability",
    ("experiment", "*"): "what to record",
    ("numerics", "*"): "arithmetic",
    ("detectable", "*"): "what would have shown",
    ("horizons", "*"): "horizons",
    ("remaining", "*"): "what remains",
    ("figures", "*"): "figures",
    ("motion", "*"): "motion",
    ("without_disturbances", "*"): "disturbances",
    ("outlier_runs", "*"): "outlier runs",
    ("invariance", "*"): "regimes",
}
"""By module and function: the outermost on the way from the diagnosis to the simulator."""
OPERATIONS = {
    ("linearization", "linearize"): "starts, either way",
    ("linearization", "shift_linearization"): "other numbers",
    ("linearization", "jacobian"): "Jacobians",
    ("refit", "_best"): "steps of fits",
    ("screening", "_first_choice"): "responses, some windows",
    ("screening", "_predictions"): "responses, all windows",
}
"""The same of what is simulated."""
PER_STEP = {"RK4": 4}
"""Evaluations of the equations of motion in a step, where these are not one."""


COUNTS = ("steps", "operations", "evaluations", "repeats", "seconds")


class Stages:
    """Steps, evaluations, repeats and seconds by stage."""

    def __init__(self) -> None:
        self.steps: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.evaluations: Counter[str] = Counter()
        self.repeats: Counter[str] = Counter()
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.seen: set[Any] = set()

    def kept(self) -> dict[str, dict[str, float]]:
        """All counts, as JSON has them; `of` reads them."""
        return {name: dict(getattr(self, name)) for name in COUNTS}

    @staticmethod
    def of(kept: dict[str, dict[str, float]]) -> "Stages":
        """The counts that `kept` gave."""
        out = Stages()
        for name in COUNTS:
            getattr(out, name).update(kept[name])
        return out

    def add(self, other: "Stages") -> None:
        """Add what another run counted."""
        self.steps.update(other.steps)
        self.operations.update(other.operations)
        self.evaluations.update(other.evaluations)
        self.repeats.update(other.repeats)
        for stage, seconds in other.seconds.items():
            self.seconds[stage] += seconds

    def note(
        self,
        simulator: Simulator,
        values: Array,
        segments: Segments,
        offsets: Array | None,
        steps: int,
        seconds: float,
    ) -> None:
        """Count one call of a simulator."""
        stage = outermost(STAGES, sys._getframe(2))
        self.steps[stage] += steps
        self.operations[outermost(OPERATIONS, sys._getframe(2))] += steps
        self.seconds[stage] += seconds
        model = simulator.model
        times = 1
        marks: tuple[Any, ...] = (id(type(simulator)),)
        if model is not None:
            times = PER_STEP.get(integrator(model), 1)
            effects = tuple(one.label for one in getattr(simulator, "effects", ()))
            marks = (float(model.opt.timestep), times, hash(effects))
        self.evaluations[stage] += times * steps
        self.repeats[stage] += round(steps * self._repeated(marks, values, segments, offsets))

    def _repeated(
        self, marks: tuple[Any, ...], values: Array, segments: Segments, offsets: Array | None
    ) -> float:
        """The fraction of the simulations that were made before."""
        rows = segments.steps
        again = 0
        for k, value in enumerate(values):
            numbers = value.tobytes()
            for i, row in enumerate(rows):
                start = b"" if offsets is None else offsets[k, i].tobytes()
                key = hash((marks, numbers, row.tobytes(), start))
                again += key in self.seen
                self.seen.add(key)
        return again / (len(values) * len(rows))


def outermost(named: Mapping[tuple[str, str], str], frame: FrameType | None) -> str:
    """The outermost of some functions on the way to a call."""
    found = "other"
    while frame is not None:
        module = str(frame.f_globals.get("__name__", "")).rpartition(".")[2]
        owner, _, function = frame.f_code.co_qualname.rpartition(".")
        for name in (function, owner, "*"):
            if (module, name) in named:
                found = named[module, name]
        frame = frame.f_back
    return found


@contextmanager
def counted() -> Iterator[Stages]:
    """Count what simulators do in the meantime."""
    found = Stages()
    bare: Callable[..., Array] = Simulator.predict

    def predict(self: Simulator, values: Any, segments: Segments, *, offsets: Any = None) -> Array:
        steps = self.steps
        begun = time.process_time()
        predicted = bare(self, values, segments, offsets=offsets)
        seconds = time.process_time() - begun
        if np.ndim(values) == 2:
            numbers = np.asarray(values, dtype=float)
            found.note(self, numbers, segments, offsets, self.steps - steps, seconds)
        return predicted

    Simulator.predict = predict  # type: ignore[method-assign]
    try:
        yield found
    finally:
        Simulator.predict = bare  # type: ignore[method-assign]


def measured(machine: str, case: str, seed: int) -> tuple[Stages, dict[str, Any]]:
    """A run of the study: where its steps went, and what was said."""
    bare = Diagnose.run
    kept: list[Stages] = []
    spent: list[float] = []

    def run(self: Any, problem: Any, **named: Any) -> Any:
        with counted() as stages:
            begun = time.process_time()
            answer = bare(self, problem, **named)
            spent.append(time.process_time() - begun)
        kept.append(stages)
        return answer

    Diagnose.run = run  # type: ignore[method-assign]
    try:
        said = study.run([machine, case, seed])
    finally:
        Diagnose.run = bare  # type: ignore[method-assign]
    return kept[0], {**said, "seconds": spent[0]}


def table(title: str, stages: Stages, runs: list[dict[str, Any]]) -> str:
    """The stages of some runs, the largest first, on average."""
    count = len(runs)
    total = sum(stages.steps.values())
    steps = np.median([run["steps"] for run in runs])
    seconds = np.median([run["seconds"] for run in runs])
    lines = [
        f"{title}: {count} run{'s' * (count > 1)}, median {steps:,.0f} steps, {seconds:.1f} s of"
        " processor time",
        "",
        "| stage | steps | share | evaluations | repeats | s in the simulator |",
        "|---|---|---|---|---|---|",
    ]
    for stage, steps in stages.steps.most_common():
        lines.append(
            f"| {stage} | {steps / count:,.0f} | {steps / total:.0%} | "
            f"{stages.evaluations[stage] / count:,.0f} | {stages.repeats[stage] / steps:.0%} | "
            f"{stages.seconds[stage] / count:.2f} |"
        )
    evaluations = sum(stages.evaluations.values())
    repeats = sum(stages.repeats.values())
    seconds = sum(stages.seconds.values())
    lines.append(
        f"| all | {total / count:,.0f} | 100% | {evaluations / count:,.0f} | "
        f"{repeats / total:.0%} | {seconds / count:.2f} |"
    )
    lines += ["", "| what is simulated | steps | share |", "|---|---|---|"]
    for what, steps in stages.operations.most_common():
        lines.append(f"| {what} | {steps / count:,.0f} | {steps / total:.0%} |")
    return "\n".join(lines)


def in_numbers(stages: Stages, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """What some runs took, for the goals: medians of steps and of seconds of processor time, mean
    seconds inside of the simulator, and the shares of stages.
    """
    total = sum(stages.steps.values())
    return {
        "steps": float(np.median([run["steps"] for run in runs])),
        "seconds": float(np.median([run["seconds"] for run in runs])),
        "simulator": sum(stages.seconds.values()) / len(runs),
        "stages": {stage: steps / total for stage, steps in stages.steps.most_common()},
    }


def main() -> None:
    """Measure what is missing of what is asked for, and print a table for each machine and case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("machine", nargs="?")
    parser.add_argument("case", nargs="?")
    parser.add_argument("seeds", nargs="*", type=int)
    parser.add_argument("--kept", action="store_true", help="measure nothing")
    options = parser.parse_args()
    machines = MACHINES if options.machine is None else (options.machine,)
    cases = CASES if options.case is None else (options.case,)
    wanted = [(m, c, s) for m in machines for c in cases for s in options.seeds or SEEDS]
    found = read_kept(KEPT)
    for machine, case, seed in () if options.kept else wanted:
        key = f"{machine}, {case}, {seed}"
        if key in found:
            continue
        with threadpool_limits(1, user_api="blas"):
            stages, said = measured(machine, case, seed)
        print(f"{key}: {said['hidden']} -> {said['said']}", file=sys.stderr, flush=True)
        whole = {name: said[name] for name in ("hidden", "said", "steps", "seconds")}
        found[key] = {**whole, "stages": stages.kept()}
        write_json(KEPT, found)
    print(report(found))


def report(found: dict[str, Any]) -> str:
    """The tables of all runs, with their numbers."""
    groups: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
    for key, run in found.items():
        groups[key.rpartition(", ")[0]].append(run)
    tables, summary = [], {}
    for title, runs in groups.items():
        whole = Stages()
        for run in runs:
            whole.add(Stages.of(run["stages"]))
        tables.append(table(title, whole, runs))
        summary[title] = in_numbers(whole, runs)
    return "\n\n".join([*tables, numbers(summary)])


if __name__ == "__main__":
    main()
