"""The benchmark of hidden effects, answered by `diagnose` as it comes."""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dropo.core.services.validation import known
from dropo.problems.file.writer import write_problem
from dropo.problems.loading import load
from dropo.studies.benchmark.answers import Answers, answer_of
from dropo.studies.benchmark.score import evaluate_answer, score
from dropo.studies.benchmark.sets import COUNT, MACHINES, SEED, VERSION, make_set, set_names
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

EVERY = set_names(MACHINES, COUNT)
RULES = (
    "Strength: about the log-likelihood that the hidden effect gains on every other trajectory,"
    " had the model the recording's own integrator and step.",
    "Named: the effect, or one that no data tell from it, is a cause, at its place. Alone: and"
    " nothing else is. Or in the set: named, or among what a cause is said to be confused with.",
    "Recorded with another integrator (Runge-Kutta's, or implicitfast where the model has that) and"
    " a step four times finer than the model's: the last column of the sets is what this difference"
    " alone is worth.",
)


def benchmark(
    work: Work,
    seeds: int | None = None,
    *,
    problems: Sequence[str] = MACHINES,
) -> Study:
    """How often a hidden effect is named in data of another integrator, by its strength.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    seeds : int or None
        The first so many data sets of each machine; None for all.
    problems : sequence of str
        Machines, or single data sets such as "hopper-003".

    Returns
    -------
    Study
        The score of `diagnose`, and every set with what was said of it.
    """
    count = seeds or COUNT
    chosen = chosen_sets(problems, count)
    runs = work.map(answered, [list(one) for one in chosen])
    truths = {run["name"]: run["truth"] for run in runs}
    answers = {run["name"]: run["answer"]["causes"] for run in runs}
    tables = (*score(truths, answers), _sets_table(runs))
    return Study(
        "benchmark",
        f"Benchmark {VERSION}: {len(chosen)} of its {COUNT * len(MACHINES)} data sets, seed {SEED}",
        tables,
        RULES,
        {"runs": runs},
    )


def chosen_sets(names: Sequence[str], count: int) -> list[tuple[str, int]]:
    """List machine and number of the data sets that are named.

    Parameters
    ----------
    names : sequence of str
        Machines, or single data sets.
    count : int
        Of a machine, the first so many.

    Returns
    -------
    list of (str, int)

    Raises
    ------
    UnknownName
        If there is no such machine or set; with the nearest name.
    BadArgument
        If there are more sets asked for than the benchmark has.
    """
    single = {f"{machine}-{number:03d}": (machine, number) for machine, number in EVERY}
    chosen: list[tuple[str, int]] = []
    for name in names:
        known("machine or data set", name, [*MACHINES, *single])
        chosen += set_names([name], count) if name in MACHINES else [single[name]]
    return list(dict.fromkeys(chosen))


def describe_sets(protocol: dict[str, Any]) -> Study:
    """Say which data sets were written.

    Parameters
    ----------
    protocol : dict
        As `write_sets` gives it.

    Returns
    -------
    Study
    """
    machines = list(protocol["sets"].values())
    rows = tuple((name, str(machines.count(name))) for name in dict.fromkeys(machines))
    table = Table("", ("machine", "data sets"), rows)
    title = f"Benchmark {VERSION}: {len(machines)} data sets, seed {SEED}"
    return Study("benchmark", title, (table,), data={"sets": protocol["sets"]})


def scored(name: str, truths: dict[str, dict[str, Any]], answers: Answers) -> Study:
    """Hold answers against the truth.

    Parameters
    ----------
    name : str
        Who answers.
    truths : dict
        By data set.
    answers : dict
        By data set.

    Returns
    -------
    Study
        With every set evaluated in its data.
    """
    data = {own: asdict(evaluate_answer(truth, answers.get(own))) for own, truth in truths.items()}
    title = f"Benchmark {VERSION}: {name}, {len(answers)} of {len(truths)} data sets answered"
    return Study("benchmark", title, score(truths, answers), RULES[:2], {"sets": data})


def answered(item: list[Any]) -> dict[str, Any]:
    """Diagnose a data set by its files.

    Parameters
    ----------
    item : list
        Machine and number.

    Returns
    -------
    dict
        name, truth, answer.
    """
    made = make_set(*item)
    with tempfile.TemporaryDirectory() as folder:
        path = write_problem(made.problem, Path(folder))
        answer = answer_of(load(path, threads=1))
    return {"name": made.name, "truth": made.truth, "answer": answer}


def _sets_table(runs: Sequence[dict[str, Any]]) -> Table:
    """Every set, with what was said of it."""
    rows = []
    for run in runs:
        truth = run["truth"]
        causes = run["answer"]["causes"]
        rows.append(
            (
                run["name"],
                _label(truth) if truth["effect"] else "-",
                f"{truth['nats']:.3g}",
                "; ".join(map(_label, causes)) or "-",
                run["answer"]["verdict"],
                f"{run['answer']['steps']:,}",
                f"{truth['integrator_nats']:.3g}",
            )
        )
    header = ("set", "hidden", "nats", "said", "verdict", "simulator steps", "integrator [nats]")
    return Table("Sets", header, tuple(rows))


def _label(cause: dict[str, Any]) -> str:
    """An effect with its place and first size."""
    sizes = [f"{value:.3g}" for value in cause["sizes"].values()]
    return f"{cause['effect']}:{cause['target'] or ''}={','.join(sizes)}"
