"""The command line: `dropo COMMAND ...`.

A command imports what it needs when it runs, so that `--help` is quick.
"""

import argparse
import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import dropo
from dropo._version import __version__
from dropo.cli import (
    benchmark,
    compare,
    data,
    diagnose,
    evaluate,
    export,
    fit,
    init,
    recover,
    report,
    schema,
    train,
    verify,
)
from dropo.cli import list as list_
from dropo.cli.support.output import close_standard_output, open_standard_streams
from dropo.core.services.errors import BadArgument, DropoError, InvalidInput
from dropo.core.services.run_warning import DropoWarning

DONE = 0
FAILED = 1
REFUSED = 2
LONGEST = 1200
"""Characters of a message, whatever stands in a file."""


class _Parser(argparse.ArgumentParser):
    """Refuses like everything else: one line, status 2, no usage."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.register("type", Path, _named_path)

    def error(self, message: str, hint: str = "") -> NoReturn:
        rule = f"{message[:1].upper()}{message[1:]}."
        raise BadArgument(f"{rule}{hint} See `{self.prog} --help`.")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Refuse what is left where it is left, so that the message names the command's help."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}", self._suggestion(unknown))
        return found, unknown

    def _print_message(self, message: str, file: Any = None) -> None:
        """Write help, and let errors of that be told, which argparse swallows."""
        try:
            print(message, end="", file=file or sys.stderr, flush=True)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise OSError(error.errno, error.strerror, "standard output") from None

    def _suggestion(self, unknown: Sequence[str]) -> str:
        """The option that is nearest to the first unknown one, as a sentence; empty for none."""
        import difflib

        options = [name for name in self._option_string_actions if name.startswith("--")]
        for text in unknown:
            near = difflib.get_close_matches(text.partition("=")[0], options, n=1)
            if near:
                return f" Did you mean {near[0]!r}?"
        return ""


def _named_path(text: str) -> Path:
    """A path; an empty one, as of a variable that is not set, would be the present folder."""
    if not text:
        raise argparse.ArgumentTypeError("expected a path, got nothing; the present folder is '.'")
    return Path(text)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments; those of the process by default, which ends here if an interrupted study has
        left simulations at work: nothing waits for them.

    Returns
    -------
    int
        The exit status: 0 done, 1 failed, 2 refused with nothing written.
    """
    status = _status(argv)
    if argv is None:
        _end_with_what_runs(status)
    return status


def _end_with_what_runs(status: int) -> None:
    """End the process at once where simulations go on that nobody waits for.

    All files are closed by now. Daemon threads alone would not do: they come back from C while the
    interpreter takes itself apart.
    """
    from dropo.core.services.daemon_threads import calls_are_running

    if calls_are_running():
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)


def _status(argv: Sequence[str] | None) -> int:
    """The exit status of one command, whatever it ends in."""
    open_standard_streams()
    try:
        return _run(argv)
    except BrokenPipeError:  # whoever reads the output has read enough
        close_standard_output()
        return DONE
    except InvalidInput as error:
        return _fail(str(error), REFUSED)
    except DropoError as error:
        return _fail(str(error), FAILED)
    except OSError as error:
        close_standard_output()
        return _fail(_describe(error), FAILED)
    except MemoryError as error:
        return _fail(f"Out of memory. {error}".strip(), FAILED)
    except KeyboardInterrupt:
        return _fail("Interrupted before there was a result.", FAILED)


def _run(argv: Sequence[str] | None) -> int:
    """The exit status of one command."""
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as stop:  # --help and --version
        return int(stop.code or DONE)
    arguments.command_line = shlex.join(["dropo", *(sys.argv[1:] if argv is None else argv)])
    with _terminable(), _warning_in_a_line():
        _load_plugins(arguments.plugin)
        return int(arguments.run(arguments))


def _load_plugins(files: Sequence[str]) -> None:
    """Import the files of `--plugin`."""
    if files:
        from dropo.core.services.plugin_files import load_plugins

        for file in files:
            load_plugins(file)


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end the work inside a block like Ctrl-C, with the best result so far."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _warning_in_a_line() -> Iterator[None]:
    """Print warnings of a run that goes on like refusals; those of libraries as they are."""
    usual = warnings.showwarning

    def show(message: Any, category: type[Warning], *place: Any, **further: Any) -> None:
        if issubclass(category, DropoWarning):
            _say(f"warning: {message}")
        else:
            usual(message, category, *place, **further)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def _parser() -> argparse.ArgumentParser:
    """The parser with all commands."""
    about = (dropo.__doc__ or "").partition("\n\n")[0]
    parser = _Parser(prog="dropo", description=about, allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"dropo {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (
        init,
        fit,
        diagnose,
        verify,
        export,
        train,
        evaluate,
        report,
        recover,
        compare,
        benchmark,
        data,
        list_,
        schema,
    ):
        command.add(commands)
    return parser


def _describe(error: OSError) -> str:
    """What the system refused, and of which file."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"{error.filename}: {reason}." if error.filename else f"{reason}."


def _fail(message: str, status: int) -> int:
    """Print a message on standard error, in one line."""
    _say(message)
    return status


def _say(message: str) -> None:
    """Print a line on standard error."""
    line = " ".join(message.split())
    if len(line) > LONGEST:
        line = f"{line[:LONGEST]}..."
    with suppress(OSError):  # where standard error is full, the status alone tells
        print(f"dropo: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
