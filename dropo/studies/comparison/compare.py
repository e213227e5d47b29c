"""`dropo.compare`: methods and their parts side by side on the same data sets."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Progress, silent
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import BadArgument, DropoError
from dropo.core.services.files.places import without_root
from dropo.core.services.validation import Array, require
from dropo.problems.record import problem_record
from dropo.studies.comparison.data_sets import data_set
from dropo.studies.comparison.summary import DEFAULT_TARGET, NAME, Fits, SolvedWithin, summarized
from dropo.studies.engine.recover import journal_of, keep_study
from dropo.studies.engine.study import Study
from dropo.studies.engine.variants import Variant, variant_of
from dropo.studies.engine.work import Work


def compare(
    estimators: Sequence[Any],
    problems: Sequence[str],
    seeds: int = 5,
    *,
    transitions: int | None = None,
    target: SolvedWithin = DEFAULT_TARGET,
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Study:
    """Compare methods or their parts on the same data sets, with all costs and paired tests.

    Parameters
    ----------
    estimators : sequence
        What is compared, the reference first: names of methods, dicts of settings with the name as
        "method", or estimators, such as ["dropo", {"optimizer": "nlopt-sbplx"}, DROID(budget=500)].
    problems : sequence of str
        Built-in problems, "table-6.2", "table-6.3" (and "-noisy"), or problem files. Simulated ones
        are recorded anew for each data set; of the others the first data set is the data, the rest
        pieces of them drawn with replacement.
    seeds : int
        Data sets of each problem.
    transitions : int or None
        Use the first ones of each data set alone; None for all.
    target : SolvedWithin
        When a data set counts as solved.
    out : str, Path or None
        Folder to write into, where an interrupted comparison is resumed; None to write nothing.
    executor : concurrent.futures.Executor or None
        Where fits run; None for threads. Results but for seconds do not depend on it.
    threads : int
        Number of threads without an executor; 0 for all cores.
    progress : callable
        Called with the finished fraction and a text.

    Returns
    -------
    Study
        For each problem errors, log-likelihoods and costs with paired tests; over all of them the
        share solved, expected running times, average ranks; performance and data profiles as its
        figure.

    Raises
    ------
    InvalidInput
        If there are fewer than two different variants, a problem, a part or a setting does not
        exist, or `out` is a file. A fit that fails later is counted, and its reason said.
    """
    finished = run_comparison(
        estimators,
        problems,
        seeds,
        transitions=transitions,
        target=target,
        out=out,
        executor=executor,
        threads=threads,
        progress=progress,
    )
    keep_study(finished, out)
    return finished


def run_comparison(
    estimators: Sequence[Any],
    problems: Sequence[str],
    seeds: int = 5,
    *,
    transitions: int | None = None,
    target: SolvedWithin = DEFAULT_TARGET,
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Study:
    """Compare methods or their parts like `compare`, without writing the study.

    Parameters
    ----------
    estimators : sequence
        What is compared, the reference first, as `compare` takes it.
    problems : sequence of str
        Built-in problems, tables of the thesis, or problem files.
    seeds : int
        Number of data sets of each problem.
    transitions : int or None
        Number of transitions of each data set that are used; None for all.
    target : SolvedWithin
        When a data set counts as solved.
    out : str, Path or None
        Folder in which answers of finished fits are kept, so that an interrupted comparison is
        resumed; None to keep none.
    executor : concurrent.futures.Executor or None
        Where fits run; None for threads.
    threads : int
        Number of threads without an executor; 0 for all cores.
    progress : callable
        Called with the finished fraction and a text.

    Returns
    -------
    Study
        As `compare` gives it.

    Raises
    ------
    BadArgument
        If there are fewer than two different variants, no problem, fewer than one data set or
        transition, or `out` is a file.
    UnknownName
        If a problem, a method or a part does not exist; the message gives the nearest name.
    InvalidInput
        If a problem file or a setting is refused.
    """
    variants = _distinct(estimators)
    problems = list(dict.fromkeys(str(problem) for problem in problems))
    require(len(problems) >= 1, "problems", "at least one", len(problems), "compare")
    require(seeds >= 1, "seeds", "at least 1", seeds, "compare")
    enough = transitions is None or transitions >= 1
    require(enough, "transitions", "at least 1", transitions, "compare")
    made = {name: _checked(name, variants, transitions) for name in problems}
    sums = {name: _sum(problem) for name, problem in made.items()}
    path = None if out is None else journal_of(out, NAME)
    work = Work(executor, threads=threads, progress=progress, path=path)
    items = []
    for problem in problems:
        for variant in variants:
            for seed in range(seeds):
                items.append(_item(problem, variant, seed, transitions, sums[problem]))
    with work.counted():
        answers = iter(work.map(fitted, items))
    fits: Fits = {}
    called = {problem: without_root(problem) for problem in problems}
    for problem in problems:
        fits[called[problem]] = {
            variant.label: [next(answers) for _ in range(seeds)] for variant in variants
        }
    units = np.repeat([len(made[problem].space) + 1 for problem in problems], seeds)
    used = "all transitions" if transitions is None else f"the first {transitions} transitions"
    title = (
        f"{len(variants)} variants on {len(problems)} problems, {seeds} data sets each, of {used};"
        f" {variants[0].label} is the reference"
    )
    settings = {
        "variants": [variant.to_json() for variant in variants],
        "problems": list(called.values()),
        "seeds": seeds,
        "transitions": transitions,
        "target": asdict(target),
    }
    found = summarized(title, fits, variants, units, seeds, target)
    return replace(found, settings=settings, release=work.release)


def fitted(item: Mapping[str, Any]) -> dict[str, Any]:
    """Fit one data set by one variant.

    Parameters
    ----------
    item : mapping
        problem, seed and transitions of the data set, and the variant; `content`, a sum of the
        problem, tells it from another of the same name.

    Returns
    -------
    dict
        mean, mean_se, sd and scale of the parameters, drawn_mean: the mean behind the data or None,
        log_likelihood, steps, evaluations, inner, seconds of the processor, status; or `failed`,
        why there is no fit.
    """
    problem, mean = data_set(item["problem"], item["seed"], item["transitions"])
    begun = time.thread_time()
    try:
        fit = Variant(**item["variant"]).estimator(problem).fit(problem, rng=item["seed"])
    except DropoError as error:
        return {"failed": str(error)}
    seconds = time.thread_time() - begun
    if not np.isfinite(fit.log_likelihood):
        return {"failed": f"its log-likelihood is not finite: {fit.log_likelihood}"}
    return _kept(fit, mean, seconds)


def _kept(fit: Fit, mean: Array | None, seconds: float) -> dict[str, Any]:
    """What is kept of a fit."""
    arrays = {name: getattr(fit, name).tolist() for name in ("mean", "mean_se", "sd", "scale")}
    return {
        **arrays,
        "drawn_mean": None if mean is None else mean.tolist(),
        "log_likelihood": fit.log_likelihood,
        "steps": fit.simulator_steps,
        "evaluations": fit.objective_evaluations,
        "inner": fit.inner_evaluations,
        "seconds": seconds,
        "status": fit.status.value,
    }


def _distinct(estimators: Sequence[Any]) -> list[Variant]:
    """The variants, each once; there must be two."""
    variants: list[Variant] = []
    for given in estimators:
        variant = variant_of(given)
        if variant not in variants:
            variants.append(variant)
    if len(variants) < 2:
        raise BadArgument(
            "compare: at least two different methods or parts are needed, such as --optimizer"
            f" nlopt-sbplx beside the default. Got {len(variants)}."
        )
    return variants


def _checked(problem: str, variants: Sequence[Variant], transitions: int | None) -> Problem:
    """Refuse what cannot be made before anything is fitted; the first data set."""
    made, _ = data_set(problem, 0, transitions)
    for variant in variants:
        variant.estimator(made)
    return made


def _sum(problem: Problem) -> str:
    """The SHA-256 of what a problem is: a file of the same name may hold another one later."""
    record = problem_record(problem)
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _item(
    problem: str, variant: Variant, seed: int, transitions: int | None, content: str
) -> dict[str, Any]:
    """The item of a fit; content: a sum of what the problem is."""
    return {
        "problem": problem,
        "seed": seed,
        "transitions": transitions,
        "variant": variant.to_json(),
        "content": content,
    }
