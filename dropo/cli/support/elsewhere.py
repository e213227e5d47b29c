"""A whole command on a worker of an executor: `--executor` of fit, diagnose and train."""

import argparse
import io
import shlex
import sys
from collections.abc import Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

from dropo.cli.support.output import executor_option

OPTION = "--executor"


def elsewhere_option(parser: argparse.ArgumentParser) -> None:
    """Add --executor to the parser of a command that runs there as a whole.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    """
    executor_option(parser, "the whole command runs, on the same files")


def run_elsewhere(arguments: argparse.Namespace) -> int:
    """Run a command on a worker, and print what it prints.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command, with `executor`.

    Returns
    -------
    int
        Its exit status.

    Raises
    ------
    UnknownName, BadArgument, MissingPackage, DropoError
        If there is no such executor; see `executor_named`.
    """
    from dropo.executors.named import executor_named

    words = _without_option(shlex.split(arguments.command_line)[1:])
    with executor_named(arguments.executor) as executor:
        assert executor is not None
        status, output, errors = executor.submit(_command, words, str(Path.cwd())).result()
    print(errors, end="", file=sys.stderr, flush=True)
    print(output, end="", flush=True)
    return status


def _command(words: Sequence[str], folder: str) -> tuple[int, str, str]:
    """Run a command in a worker: its exit status, and what it prints on both outputs."""
    from dropo.cli.main import main

    output = io.StringIO()
    errors = io.StringIO()
    with chdir(folder), redirect_stdout(output), redirect_stderr(errors):
        status = main(words)
    return status, output.getvalue(), errors.getvalue()


def _without_option(words: Sequence[str]) -> list[str]:
    """A command without where it runs."""
    left = []
    rest = iter(words)
    for word in rest:
        if word == OPTION:
            next(rest)
        elif not word.startswith(f"{OPTION}="):
            left.append(word)
    return left
