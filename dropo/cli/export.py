"""`dropo export`: a fit or an extended model in the form of another tool."""

import argparse
from pathlib import Path
from typing import Any

from dropo.cli.support.output import NOTHING, computing_options, printing_options, show


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "export",
        help="write a fit or an extended model in the form of another tool",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "folder",
        type=Path,
        metavar="DIR",
        help="what `dropo fit --out` or `dropo diagnose --out` wrote",
    )
    parser.add_argument(
        "--to", required=True, metavar="TARGET", help="a name that `dropo list exports` prints"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="the main file, or the folder; DIR/TARGET by default",
    )
    parser.add_argument(
        "--problem", metavar="PROBLEM", help="what was fitted, where DIR does not say it"
    )
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print their paths, with what is left out.

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
    from dropo.exports.export import export

    found = export(arguments.folder, arguments.to, arguments.out, problem=arguments.problem)
    show(arguments, found, found.to_json())
    return 0
