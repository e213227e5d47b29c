"""What commands print: results on standard output, progress and warnings on standard error."""

import argparse
import json
import sys
import time
from collections.abc import Callable
from typing import Any, TextIO

WIDTH = 24  # of the bar, in characters
EVERY = 0.1  # [s] between two drawings


class Progress:
    """progress(share, text) draws one line on a terminal, and nothing into a pipe or where it is `silent`."""

    def __init__(self, *, silent: bool = False, stream: TextIO | None = None):
        self.stream = sys.stderr if stream is None else stream
        self.silent = silent or not self.stream.isatty()
        self._drawn = -EVERY

    def __call__(self, share: float, text: str) -> None:
        now = time.monotonic()
        if self.silent or now - self._drawn < EVERY:
            return
        self._drawn = now
        share = min(max(share, 0.0), 1.0)
        bar = "#" * round(share * WIDTH)
        self.stream.write(f"\r\033[K[{bar:<{WIDTH}}] {share:4.0%}  {text}"[:200])
        self.stream.flush()

    def close(self) -> None:
        """Takes the line away."""
        if not self.silent and self._drawn >= 0:
            self.stream.write("\r\033[K")
            self.stream.flush()


def show(arguments: argparse.Namespace, text: str, content: Any) -> None:
    """The result on standard output: as JSON with --json, else as text, and nothing with --quiet."""
    if arguments.json:
        print(json.dumps(content, indent=1, allow_nan=False))
    elif not getattr(arguments, "quiet", False):
        print(text)


def printing_options(parser: argparse.ArgumentParser) -> None:
    """--json and --quiet."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print neither progress nor the table")


def whole(least: int) -> Callable[[str], int]:
    """An argparse type: a whole number of at least so much."""

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, got {text!r}")
        return value

    return convert
