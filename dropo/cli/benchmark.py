"""`dropo benchmark`: data sets in which one effect is hidden, and the score of anyone's answers."""

import argparse
from pathlib import Path
from typing import Any

from dropo.cli.support.output import (
    NOTHING,
    Progress,
    computing_options,
    printing_options,
    show,
    whole,
)


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "benchmark",
        help="hidden effects to be named, and the score of anyone's answers",
        description=__doc__,
        allow_abbrev=False,
    )
    below = parser.add_subparsers(metavar="ACTION", required=True)
    write = _action(
        below, "write", run_write, "write the data sets, checksums, and the truth apart"
    )
    write.add_argument("--out", type=Path, required=True, metavar="DIR", help="the folder")
    write.add_argument(
        "--machines", nargs="+", metavar="NAME", help="these alone; all of the benchmark by default"
    )
    write.add_argument(
        "--sets", type=whole(1), metavar="N", help="the first N of each machine; all by default"
    )
    answer = _action(
        below, "answer", run_answer, "answer by `dropo diagnose`, with the files alone"
    )
    answer.add_argument("folder", type=Path, metavar="DIR", help="what `write` wrote")
    answer.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the file of answers, .json; the same command goes on after an interruption",
    )
    score = _action(below, "score", run_score, "hold a file of answers against the truth")
    score.add_argument("folder", type=Path, metavar="DIR", help="what `write` wrote")
    score.add_argument("answers", type=Path, metavar="FILE", help="the answers, .json")
    score.add_argument(
        "--truth", type=Path, metavar="FILE", help="the truth, where it is not in DIR"
    )


def _action(below: Any, name: str, function: Any, text: str) -> argparse.ArgumentParser:
    """Add an action that a function runs, with the options that all have."""
    parser: argparse.ArgumentParser = below.add_parser(
        name, help=text, description=text, allow_abbrev=False
    )
    parser.set_defaults(run=function)
    computing_options(parser, seed=NOTHING)
    printing_options(parser)
    return parser


def run_write(arguments: argparse.Namespace) -> int:
    """Write the data sets.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0.

    Raises
    ------
    InvalidInput
        If the input is refused; nothing is written then.
    """
    from dropo.studies.benchmark.sets import COUNT, MACHINES, write_sets
    from dropo.studies.benchmark.study import describe_sets
    from dropo.studies.engine.work import Work

    progress = Progress(silent=arguments.quiet)
    try:
        work = Work(threads=arguments.threads, progress=progress)
        machines = arguments.machines or MACHINES
        protocol = write_sets(work, arguments.out, machines, arguments.sets or COUNT)
    finally:
        progress.close()
    found = describe_sets(protocol)
    show(arguments, found, found.to_json())
    return 0


def run_answer(arguments: argparse.Namespace) -> int:
    """Diagnose every data set, and write the answers.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0.

    Raises
    ------
    InvalidInput
        If the input is refused; nothing is written then.
    """
    from dropo.core.services.files.atomic_write import write_json
    from dropo.studies.benchmark.answers import answer_all
    from dropo.studies.engine.work import Work

    journal = arguments.out.with_name(f".{arguments.out.name}.jsonl")
    progress = Progress(silent=arguments.quiet)
    try:
        work = Work(threads=arguments.threads, progress=progress, path=journal)
        answers = answer_all(work, arguments.folder)
    finally:
        progress.close()
    write_json(arguments.out, answers)
    work.release()
    return 0


def run_score(arguments: argparse.Namespace) -> int:
    """Print the score of a file of answers.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0.

    Raises
    ------
    InvalidInput
        If the input is refused.
    """
    from dropo.studies.benchmark.answers import read_answers, read_protocol
    from dropo.studies.benchmark.score import read_truth
    from dropo.studies.benchmark.study import scored

    protocol = read_protocol(arguments.folder)
    name, answers = read_answers(arguments.answers, protocol)
    found = scored(name, read_truth(arguments.folder, arguments.truth), answers)
    show(arguments, found, found.to_json())
    return 0
