"""What commands print: results on standard output, progress and warnings on standard error."""

import argparse
import io
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

SHOWN = 40
"""Characters of an argument that a message shows."""
MOST_THREADS = 1024
"""Threads that a computer may have cores for."""
EVERY = 10.0
"""Seconds from one line of progress to the next, where no bar can be drawn."""
AT_ONCE = ("stopping", "an iteration takes")
"""What texts begin with that do not wait: the answer to Ctrl-C, and what a long run will cost."""
STOPPING = "stopping after this iteration's simulations"
"""The answer to Ctrl-C, which cannot end what is simulated in C."""
SOON = 0.02
"""Fraction of the work before which the time left is a guess, and is not shown."""


class Progress:
    """Shows progress: as one line on a terminal, with a bar, elsewhere a line now and then.

    It is called with the fraction of the work that is done and a text. What is shown never runs
    backward.

    Parameters
    ----------
    silent : bool
        Whether to write nothing.
    stream : text file, optional
        Where to write; standard error by default.
    path : Path, optional
        A file that holds the last steps while the work goes on, silent or not.
    """

    def __init__(
        self, *, silent: bool = False, stream: TextIO | None = None, path: Path | None = None
    ):
        from dropo.core.services.files.progress_file import ProgressFile

        self._file = ProgressFile(path)
        self.stream = sys.stderr if stream is None else stream
        self.silent = silent
        self._draws = self.stream.isatty()
        self._begun = self._last_line = time.monotonic()
        self._done = 0.0
        self._bar: Any = None

    def __call__(self, fraction: float, text: str) -> None:
        """Show the `fraction` that is done, with a `text`."""
        self._done = max(self._done, min(fraction, 1.0))
        spent = time.monotonic() - self._begun
        left = time_left(self._done, spent)
        self._file(self._done, text, left)
        if self.silent:
            return
        if self._draws:
            self._draw(text, left)
            if text.startswith(AT_ONCE):
                self.say(text)
        elif text.startswith(AT_ONCE) or time.monotonic() - self._last_line >= EVERY:
            self._last_line = time.monotonic()
            times = ", ".join(part for part in (_clock(spent), left) if part)
            with suppress(OSError):  # a pipe that nobody reads ends no run
                print(f"dropo: {self._done:.0%}, {times}: {text}", file=self.stream, flush=True)

    def say(self, text: str) -> None:
        """Print a line of its own at once, on a terminal above the bar, unless this is silent.

        Parameters
        ----------
        text : str
            What to say.
        """
        if self.silent:
            return
        line = f"dropo: {text}"
        with suppress(OSError):
            if self._bar is None:
                print(line, file=self.stream, flush=True)
            else:
                self._bar.console.print(line, markup=False, highlight=False)

    @contextmanager
    def answering(self, text: str = STOPPING) -> Iterator[None]:
        """Answer Ctrl-C and SIGTERM inside a block at once, even where it is deep in C.

        Python itself hears them only when the call into C returns, which may be minutes later.

        Parameters
        ----------
        text : str
            What to say.
        """
        if self.silent or threading.current_thread() is not threading.main_thread():
            yield
            return
        heard, signalled = socket.socketpair()
        signalled.setblocking(False)

        def listen() -> None:
            """Say the text for the first of the signals."""
            said = False
            while number := heard.recv(1):
                if number[0] in (signal.SIGINT, signal.SIGTERM) and not said:
                    said = True
                    self.say(text)

        thread = threading.Thread(target=listen, name="answering", daemon=True)
        thread.start()
        before = signal.set_wakeup_fd(signalled.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)
            signalled.close()
            thread.join()
            heard.close()

    def close(self) -> None:
        """Remove the line from a terminal, and the file of the last steps."""
        self._file.close()
        if self._bar is not None:
            self._bar.stop()

    def _draw(self, text: str, left: str) -> None:
        """Draws the bar anew."""
        if self._bar is None:
            self._bar = _bar(self.stream)
            self._bar.start()
            self._bar.add_task(text, total=1.0, left="")
        self._bar.update(self._bar.task_ids[0], completed=self._done, description=text, left=left)


def time_left(fraction: float, spent: float) -> str:
    """Estimate the time left, if the rest goes on as before.

    Parameters
    ----------
    fraction : float
        Of the work that is done.
    spent : float
        Time for it [s].

    Returns
    -------
    str
        Such as "about 0:01:30 left"; empty at the beginning.
    """
    if fraction < SOON:
        return ""
    return f"about {_clock(spent * (1 - fraction) / fraction)} left"


def _clock(seconds: float) -> str:
    """A time as hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


def _bar(stream: TextIO) -> Any:
    """The line of rich."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.table import Column

    text = TextColumn(
        "{task.description}",
        markup=False,
        table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
    )
    columns = (
        BarColumn(24),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        text,
    )
    return Bar(*columns, console=Console(file=stream), transient=True, expand=True)


def open_standard_streams() -> None:
    """Make both streams take any character, and open those that were closed on nothing.

    Without this a table with a Greek letter fails where the locale is C, and a file that is opened
    takes the place of a closed stream.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def close_standard_output() -> None:
    """Send what is left for standard output nowhere, since it cannot be written any more."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), sys.stdout.fileno())


def show_and_save(
    arguments: argparse.Namespace, result: object, content: Any, save: Callable[[], None]
) -> None:
    """Print a result, then save it: what cannot be saved was printed, what cannot be printed is
    saved.

    Parameters
    ----------
    arguments, result, content
        As `show` has them.
    save : callable
        Writes the result, where it is to be written.
    """
    try:
        show(arguments, result, content)
    finally:
        save()


def show(arguments: argparse.Namespace, result: object, content: Any) -> None:
    """Print a result: as JSON with --json, nothing with --quiet, else as text.

    Parameters
    ----------
    arguments : argparse.Namespace
        With `json` and `quiet`.
    result : object
        What is printed as text; the tables of a `Report` are drawn on a terminal.
    content : Any
        What is printed as JSON.
    """
    from dropo.core.services.files.atomic_write import naming

    with naming("standard output"):
        if arguments.json:
            print(json.dumps(content, indent=1, allow_nan=False))
        elif not arguments.quiet:
            if sys.stdout.isatty():
                _draw(result)
            else:
                print(result)
        sys.stdout.flush()


def _draw(result: object) -> None:
    """Print the parts of a result on a terminal: tables drawn, warnings in colour."""
    from rich.console import Console

    from dropo.core.services.tables import Report, Table

    console = Console(file=sys.stdout)
    parts = result.parts() if isinstance(result, Report) else str(result).splitlines()
    for part in parts:
        if isinstance(part, Table):
            console.print(_rich(part))
        else:
            style = "yellow" if part.startswith(("warning", "error")) else None
            console.print(part, style=style, markup=False, highlight=False)


def _rich(table: Any) -> Any:
    """A table of rich."""
    from rich import box
    from rich.table import Table as Drawn
    from rich.text import Text

    drawn = Drawn(title=table.title or None, title_justify="left", box=box.SIMPLE_HEAD)
    for i, name in enumerate(table.header):
        drawn.add_column(Text(name), justify="left" if i == 0 else "right", overflow="fold")
    for row in table.rows:
        drawn.add_row(*map(Text, row))
    return drawn


def printing_options(parser: argparse.ArgumentParser) -> None:
    """Add --json and --quiet to a parser; every command has them.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    """
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print neither progress nor the table")


def computing_options(
    parser: argparse.ArgumentParser, *, seed: str = "0 by default", threads: str = ""
) -> None:
    """Add --seed, --threads and --plugin to a parser; every command has them.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    seed, threads : str
        Help texts, where the options do not do the usual.
    """
    usual = "0, the default: all cores; results do not depend on it"
    parser.add_argument("--seed", type=whole(0, 2**64), default=0, metavar="S", help=seed)
    parser.add_argument(
        "--threads", type=whole(0, MOST_THREADS), default=0, metavar="N", help=threads or usual
    )
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="run this Python file first, which registers parts of your own; may be repeated",
    )


def transitions_option(parser: argparse.ArgumentParser) -> None:
    """Add --transitions to a parser; every command that takes a problem's data has it.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    """
    parser.add_argument(
        "--transitions", type=whole(1), metavar="N", help="use the first N transitions alone"
    )


def executor_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --executor to a parser.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    what : str
        What runs there, for the help: a clause such as "the fits run".
    """
    parser.add_argument(
        "--executor",
        metavar="NAME[:PLACE]",
        help=f"where {what}: processes:4, dask://host:8786, slurm:cpu,time=60; see `dropo list"
        " executors`; results do not depend on it",
    )


TASK = (
    "run Python code that a problem file names under `task` and `plugins`, and read networks, which"
    " may hold code"
)
"""What --trust allows the commands that know tasks and policies."""
PARTS = "run the Python code that a problem file names under `plugins` and `task`"
"""What --trust allows the commands that read problem files."""


def trusting_option(parser: argparse.ArgumentParser, allowed: str = TASK) -> None:
    """Add --trust to a parser, for commands that may run code of others.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        The command's parser.
    allowed : str
        What it allows, for the help.
    """
    parser.add_argument("--trust", action="store_true", help=allowed)


NOTHING = "taken by every command; without effect here"
"""What an option does where there is nothing to decide."""


MOST = 10**9
"""The largest whole number that makes sense as an option."""


def whole(minimum: int, most: int = MOST) -> Callable[[str], int]:
    """Make a type for argparse: a whole number between two others.

    Parameters
    ----------
    minimum, most : int
        The smallest and the largest that is taken.

    Returns
    -------
    callable
        From the text of an option to the number.

    Raises
    ------
    argparse.ArgumentTypeError
        By what is returned, where a text is no such number; argparse makes a refusal of it.
    """

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = minimum - 1
        if not minimum <= value <= most:
            beyond = f" and at most {most}" if value > most else ""
            shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
            raise argparse.ArgumentTypeError(
                f"expected a whole number of at least {minimum}{beyond}, got {shown!r}"
            )
        return value

    return convert
