"""What commands print: results on standard output, progress and warnings on standard error."""

import argparse
import json
import sys
import time
from collections.abc import Callable
from typing import Any, TextIO

SOON = 0.02  # of the work: before that, the time left is a guess


class Progress:
    """progress(share, text) draws one line on a terminal: a bar, the time spent and left, and the
    text, which tells the cost.

    Nothing into a pipe, or where it is `silent`.
    """

    def __init__(self, *, silent: bool = False, stream: TextIO | None = None):
        self.stream = sys.stderr if stream is None else stream
        self.silent = silent or not self.stream.isatty()
        self._begun = time.monotonic()
        self._bar: Any = None

    def __call__(self, share: float, text: str) -> None:
        if self.silent:
            return
        if self._bar is None:
            self._bar = _bar(self.stream)
            self._bar.start()
            self._bar.add_task(text, total=1.0, left="")
        share = min(max(share, 0.0), 1.0)
        left = time_left(share, time.monotonic() - self._begun)
        self._bar.update(self._bar.task_ids[0], completed=share, description=text, left=left)

    def close(self) -> None:
        """Takes the line away."""
        if self._bar is not None:
            self._bar.stop()


def time_left(share: float, spent: float) -> str:
    """ "about 0:01:30 left", where the rest goes on as what was done so far in `spent` seconds."""
    if share < SOON:
        return ""
    minutes, seconds = divmod(round(spent * (1 - share) / share), 60)
    return f"about {minutes // 60}:{minutes % 60:02}:{seconds:02} left"


def _bar(stream: TextIO) -> Any:
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


def show(arguments: argparse.Namespace, result: object, content: Any) -> None:
    """The result on standard output: as JSON with --json, else as text, with drawn tables on a
    terminal; nothing with --quiet.
    """
    if arguments.json:
        print(json.dumps(content, indent=1, allow_nan=False))
    elif not arguments.quiet:
        if sys.stdout.isatty():
            _draw(result)
        else:
            print(result)


def _draw(result: object) -> None:
    """The parts of a result on a terminal: tables drawn, warnings in colour, the other text as it
    is.
    """
    from rich.console import Console

    from dropo.core.services.tables import Report, Table

    console = Console(file=sys.stdout)
    for part in result.parts() if isinstance(result, Report) else str(result).splitlines():
        if isinstance(part, Table):
            console.print(_rich(part))
        else:
            style = "yellow" if part.startswith(("warning", "error")) else None
            console.print(part, style=style, markup=False, highlight=False)


def _rich(table: Any) -> Any:
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
    """--json and --quiet, which every command has."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print neither progress nor the table")


def computing_options(
    parser: argparse.ArgumentParser, *, seed: str = "0 by default", threads: str = ""
) -> None:
    """--seed and --threads, which every command has too; the texts say what they do where that is
    not the usual.
    """
    usual = "0, the default: all cores; results do not depend on it"
    parser.add_argument("--seed", type=whole(0), default=0, metavar="S", help=seed)
    parser.add_argument("--threads", type=whole(0), default=0, metavar="N", help=threads or usual)


NOTHING = "taken by every command; without effect here"
"""What an option does where there is nothing to decide."""


def whole(least: int) -> Callable[[str], int]:
    """An argparse type: a whole number of at least so much."""

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(
                f"expected a whole number of at least {least}, got {text!r}"
            )
        return value

    return convert
