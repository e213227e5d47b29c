"""`dropo recover`: runs a study and prints its tables."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from dropo.cli.folder import run_folder
from dropo.cli.output import Progress, computing_options, printing_options, show_and_save, whole


def add(commands: Any) -> None:
    """Add the command to the parser `commands`."""
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
        action="store_true",
        help="also the method as published, where a study has it: minutes more",
    )
    parser.add_argument(
        "--problems",
        nargs="+",
        default=(),
        metavar="NAME",
        help="these alone, in a study of several problems",
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
    printing_options(parser)


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
    from dropo.core.services.errors import DropoError
    from dropo.studies.engine.recover import keep_study, run_study

    progress = Progress(silent=arguments.quiet)
    try:
        with run_folder(arguments.out):
            study = run_study(
                arguments.study,
                seeds=arguments.seeds,
                published=arguments.published,
                problems=arguments.problems,
                out=arguments.out,
                threads=arguments.threads,
                progress=progress,
            )
            show_and_save(
                arguments, study, study.to_json(), partial(keep_study, study, arguments.out)
            )
    except KeyboardInterrupt:
        kept = "Interrupted: with --out, a study can be resumed."
        if arguments.out:
            kept = "Interrupted: the same command goes on from here."
        raise DropoError(kept) from None
    finally:
        progress.close()
    return 0
