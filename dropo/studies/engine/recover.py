"""Runs a study by its name: `dropo recover` in Python."""

import inspect
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Literal

from dropo.core.contracts.estimator import Progress, silent
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import require
from dropo.studies.engine.pages import write
from dropo.studies.engine.study import Study
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work

LACKS = {
    "published": "has no runs of the published method",
    "full": "has no runs of the published method at full size",
    "problems": "is not one of several problems",
    "first_seed": "has seeds of its own",
    "variants": "has parts of its own",
}
"""Option -> what a study says that does not take it."""
NAMES = {
    "full": "--published full",
    "first_seed": "--first-seed",
    "variants": "--method, --likelihood, --optimizer, --family and --budget",
}
"""Option -> its name on the command line, where that is another."""


def recover(
    name: str,
    *,
    seeds: int | None = None,
    published: bool | Literal["full"] = False,
    problems: Sequence[str] = (),
    variants: Sequence[Variant] = (),
    first_seed: int | None = None,
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Study:
    """Run the study of that name; `dropo list studies` lists them.

    Parameters
    ----------
    name : str
        Name of the study.
    seeds : int or None
        Number of data sets or repetitions; None for the study's own number.
    published : bool or "full"
        Whether the method is also run as published, in studies that have it: at a reduced size, or
        at full size, which takes many hours and goes on where it was interrupted.
    problems : sequence of str
        In studies of several problems, the names of those to run; all if empty.
    variants : sequence of Variant
        Methods with parts exchanged, whose rows stand beside the others; `variants_of` makes them
        of names.
    first_seed : int or None
        Seed of the first data set, in studies that have one to choose; None for the study's own.
    out : str, Path or None
        Folder to write the study into, where an interrupted study is resumed; None to write
        nothing.
    executor : concurrent.futures.Executor or None
        Where tasks run; None for threads. Results do not depend on it.
    threads : int
        Number of threads without an executor; 0 for all cores. Results do not depend on it.
    progress : callable
        Called with the finished fraction and a text.

    Returns
    -------
    Study
        The finished study.

    Raises
    ------
    UnknownName
        If there is no such study; the message gives the nearest name.
    BadArgument
        If `seeds` is below 1, or `out` is a file.
    Incompatible
        If the study does not take `published`, `problems`, `variants` or `first_seed`.
    BadFile
        If the study's block of the folder's README.md has no end.
    """
    finished = run_study(
        name,
        seeds=seeds,
        published=published,
        problems=problems,
        variants=variants,
        first_seed=first_seed,
        out=out,
        executor=executor,
        threads=threads,
        progress=progress,
    )
    keep_study(finished, out)
    return finished


def run_study(
    name: str,
    *,
    seeds: int | None = None,
    published: bool | Literal["full"] = False,
    problems: Sequence[str] = (),
    variants: Sequence[Variant] = (),
    first_seed: int | None = None,
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Study:
    """Run a study without writing it.

    Parameters
    ----------
    name : str
        The study's name.
    seeds : int or None
        Number of data sets; None for the study's own.
    published : bool or "full"
        Whether the published method is run too, at a reduced size or at its full one.
    problems : sequence of str
        Problems in place of the study's own.
    variants : sequence of Variant
        Methods with parts exchanged, beside the study's own.
    out : str, Path or None
        Folder in which answers of finished tasks are kept, so that an interrupted study is resumed;
        None to keep none.
    executor : concurrent.futures.Executor or None
        Where tasks run; None for threads.
    threads : int
        Number of threads without an executor; 0 for all cores.
    progress : callable
        Called with the finished fraction and a text.

    Returns
    -------
    Study
        The finished study.

    Raises
    ------
    UnknownName
        If there is no such study; the message gives the nearest name.
    BadArgument
        If `seeds` is less than 1, or `out` is a file.
    Incompatible
        If the study does not take one of the options that are given.
    Interrupted
        In place of a KeyboardInterrupt; it says how many answers are kept.
    """
    study = find("studies", name)
    require(seeds is None or seeds >= 1, "seeds", "at least 1", seeds, "recover")
    options: dict[str, object] = {}
    if published == "full":
        options["full"] = True
    elif published:
        options["published"] = True
    if problems:
        options["problems"] = tuple(problems)
    if variants:
        options["variants"] = tuple(variants)
    if first_seed is not None:
        options["first_seed"] = first_seed
    for option in sorted(options.keys() - inspect.signature(study).parameters.keys()):
        options_of = NAMES.get(option, f"--{option}")
        raise Incompatible(f"The study {name!r} {LACKS[option]}. Leave {options_of} out.")
    path = None if out is None else journal_of(out, name)
    work = Work(executor, threads=threads, progress=progress, path=path)
    with work.counted():
        finished: Study = study(work, seeds, **options)
    settings = {
        "seeds": seeds,
        "published": published,
        "problems": list(problems),
        "variants": [variant.to_json() for variant in variants],
    }
    return replace(finished, settings=settings, release=work.release)


def keep_study(study: Study, out: str | Path | None) -> None:
    """Write a finished study, and remove the journal of its tasks unless it holds others' too.

    Parameters
    ----------
    study : Study
        The study.
    out : str, Path or None
        Its folder; None to write nothing.

    Raises
    ------
    BadFile
        If the study's block of the folder's README.md has no end.
    """
    if out is None:
        return
    folder = Path(out)
    write(study, folder)
    if study.release is not None:
        study.release()


def journal_of(out: str | Path, name: str) -> Path:
    """Where the answers of finished tasks are kept until the study is written.

    Parameters
    ----------
    out : str or Path
        The study's folder.
    name : str
        Its name.

    Raises
    ------
    BadArgument
        If `out` is a file.

    Returns
    -------
    Path
        A hidden file in the folder.
    """
    folder = Path(out)
    is_free = folder.is_dir() or not folder.exists()
    require(is_free, "out", "a folder", str(folder), "recover")
    return folder / f".{name}.jsonl"
