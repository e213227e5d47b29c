"""`dropo recover`: runs a study and prints its tables."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.support.folder import run_folder
from dropo.cli.support.output import (
    Progress,
    computing_options,
    executor_option,
    printing_options,
    show_and_save,
    whole,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from dropo.studies.engine.study import Study
    from dropo.studies.engine.variants import Variant

PARTS = {
    "method": "methods",
    "likelihood": "likelihoods",
    "optimizer": "optimizers",
    "family": "families",
}
"""Options that name parts, and their kinds."""


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "recover", help="run a recovery study", description=__doc__, allow_abbrev=False
    )
    parser.set_defaults(run=run)
    parser.add_argument("study", metavar="STUDY", help="see `dropo list studies`")
    parser.add_argument(
        "--seeds",
        type=whole(1),
        metavar="N",
        help="data sets or repetitions; each study has a number of its own",
    )
    parser.add_argument(
        "--published",
        nargs="?",
        const=True,
        default=False,
        choices=("full",),
        help=(
            "also the method as published, where a study has it: at a reduced size, minutes more;"
            " full: at the thesis' size, hours for each data set"
        ),
    )
    parser.add_argument(
        "--problems",
        nargs="+",
        default=(),
        metavar="NAME",
        help="these alone, in a study of several problems",
    )
    part_options(parser)
    parser.add_argument(
        "--first-seed",
        type=whole(0),
        metavar="N",
        help="seed of the first data set, in studies that let it be chosen",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write <study>.md, .json and .svg here; the same command resumes",
    )
    computing_options(
        parser, seed="without effect: the data sets of a study have seeds of their own"
    )
    executor_option(parser, "the tasks of the study run")
    printing_options(parser)


def part_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name parts to exchange; each takes several names.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    """
    for name, kind in PARTS.items():
        parser.add_argument(
            f"--{name}",
            nargs="+",
            action="extend",
            default=[],
            metavar="NAME",
            help=f"with each of these too, see `dropo list {kind}`; may be repeated",
        )
    parser.add_argument(
        "--budget",
        type=whole(1),
        metavar="N",
        help="evaluations of these at most, inside an emulator too",
    )


def named_variants(arguments: argparse.Namespace) -> "list[Variant]":
    """Make the variants that the options of `part_options` name.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    list of Variant

    Raises
    ------
    UnknownName
        If there is no such part; the message gives the nearest name.
    Incompatible
        If none of the methods takes a part that is named.
    """
    from dropo.studies.engine.variants import variants_of

    return variants_of(
        arguments.method,
        arguments.budget,
        likelihood=arguments.likelihood,
        optimizer=arguments.optimizer,
        family=arguments.family,
    )


def run(arguments: argparse.Namespace) -> int:
    """Run a study, save and print it.

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
    DropoError
        If the study was interrupted.
    """
    from dropo.studies.engine.recover import run_study

    return run_and_keep(
        arguments,
        "study",
        partial(
            run_study,
            arguments.study,
            seeds=arguments.seeds,
            published=arguments.published,
            problems=arguments.problems,
            variants=named_variants(arguments),
            first_seed=arguments.first_seed,
        ),
    )


def run_and_keep(arguments: argparse.Namespace, noun: str, study_of: "Callable[..., Study]") -> int:
    """Run what makes a study, save and print it.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command, with the folder `out`.
    noun : str
        What it is called in messages.
    study_of : callable
        Takes `out`, `executor`, `threads` and `progress`.

    Returns
    -------
    int
        0.

    Raises
    ------
    InvalidInput
        If the input is refused; nothing is written then.
    DropoError
        If it was interrupted.
    """
    from dropo.core.services.errors import DropoError
    from dropo.executors.named import executor_named
    from dropo.studies.engine.recover import keep_study

    out = arguments.out
    progress = Progress(silent=arguments.quiet)
    try:
        with run_folder(out), executor_named(arguments.executor) as executor:
            study = study_of(
                out=out, executor=executor, threads=arguments.threads, progress=progress
            )
            show_and_save(arguments, study, study.to_json(), partial(keep_study, study, out))
    except KeyboardInterrupt as stop:
        kept = f"Interrupted: with --out, a {noun} can be resumed."
        if out:
            number = getattr(stop, "kept", 0)
            count = f"{number} finished task{'' if number == 1 else 's'}"
            kept = f"Interrupted, stopping: {count} kept, the same command goes on from here."
        raise DropoError(kept) from None
    finally:
        progress.close()
    return 0
