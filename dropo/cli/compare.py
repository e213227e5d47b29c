"""`dropo compare`: parts side by side on the same data sets, all costs counted, with tests."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from dropo.cli.recover import named_variants, part_options, run_and_keep
from dropo.cli.support.output import (
    NOTHING,
    computing_options,
    executor_option,
    printing_options,
    whole,
)

PROBLEMS = ("slide", "hopper-noisy")
"""What is fitted where no problem is named."""
DATA_SETS = 5


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "compare",
        help="parts side by side on the same data",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    part_options(parser)
    parser.add_argument(
        "--problem",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help=(
            "built-in problems, table-6.2, table-6.3 (and -noisy), or problem files;"
            f" {' and '.join(PROBLEMS)} by default"
        ),
    )
    parser.add_argument(
        "--seeds",
        type=whole(1),
        default=DATA_SETS,
        metavar="N",
        help=f"data sets of each problem; {DATA_SETS} by default",
    )
    parser.add_argument(
        "--transitions",
        type=whole(1),
        metavar="N",
        help="use the first N transitions of each data set",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write comparison.md, .json and .svg here; the same command resumes",
    )
    computing_options(parser, seed=NOTHING)
    executor_option(parser, "the fits run")
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compare, save and print.

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
        If a name does not exist or nothing is named; nothing is written then.
    DropoError
        If it was interrupted.
    """
    from dropo.studies.comparison.compare import run_comparison
    from dropo.studies.engine.variants import Variant

    return run_and_keep(
        arguments,
        "comparison",
        partial(
            run_comparison,
            [Variant(), *named_variants(arguments)],
            arguments.problem or PROBLEMS,
            arguments.seeds,
            transitions=arguments.transitions,
        ),
    )
