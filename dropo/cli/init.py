"""`dropo init`: a robot and its logs become a complete folder: mapping, data, problem, record."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dropo.cli.support.output import NOTHING, Progress, computing_options, printing_options, show


def add(commands: Any) -> None:
    """Add the command to the parser.

    Parameters
    ----------
    commands
        The parser's commands.
    """
    text = "from a robot and its logs to a folder that can be diagnosed, the mapping guessed"
    parser = commands.add_parser("init", help=text, description=__doc__, allow_abbrev=False)
    parser.set_defaults(run=run)
    parser.add_argument(
        "robot",
        metavar="ROBOT",
        help="an MJCF or URDF file, or the name of a description of robot_descriptions",
    )
    parser.add_argument(
        "logs", nargs="+", metavar="LOG", help="files or folders, of any kind that is read"
    )
    parser.add_argument(
        "--map",
        type=Path,
        metavar="FILE",
        help="a mapping file whose entries stand; what it does not say is guessed",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="the folder; one of the robot's name by default"
    )
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the folder, and print what was guessed.

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
    from dropo.logs.starting import init

    progress = Progress(silent=arguments.quiet)
    on_terminal = sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()
    try:
        found = init(
            arguments.robot,
            arguments.logs,
            arguments.out,
            mapping=arguments.map,
            ask=ask if on_terminal and not arguments.quiet else None,
            progress=progress,
        )
    finally:
        progress.close()
    show(arguments, found, found.to_json())
    return 0


def ask(question: str, options: Sequence[str]) -> str:
    """Ask a question on the terminal, until the answer is one of its options.

    Parameters
    ----------
    question : str
        The question.
    options : sequence of str
        Its answers.

    Returns
    -------
    str
        One of them.
    """
    shown = ", ".join(f"{i} {option}" for i, option in enumerate(options, 1))
    while True:
        print(f"{question} [{shown}]", file=sys.stderr, flush=True)
        answer = input().strip()
        if answer in options:
            return answer
        if answer.isdigit() and 1 <= int(answer) <= len(options):
            return options[int(answer) - 1]
