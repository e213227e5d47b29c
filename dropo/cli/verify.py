"""`dropo verify`: rolls the extended model of a diagnosis out in plain MuJoCo and prints its errors
again.
"""

import argparse
from pathlib import Path
from typing import Any

from dropo.cli.support.output import (
    NOTHING,
    computing_options,
    printing_options,
    show,
    trusting_option,
)


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "verify",
        help="roll an extended model out in plain MuJoCo",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="what `dropo diagnose --out` wrote"
    )
    trusting_option(parser, "run extended/model.py even if it is not what dropo writes")
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Roll out and print.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0 where the errors are those announced, else 1.

    Raises
    ------
    InvalidInput
        If the input is refused.
    """
    from dropo.problems.file.verification import verify

    found = verify(arguments.folder, trusted=arguments.trust)
    show(arguments, found, found.to_json())
    return 0 if found.holds else 1
