"""`dropo list`: the names of methods, optimizers, problems and other plug-ins, each with the first
sentence about it.
"""

import argparse
import inspect
import re
from typing import Any

from dropo.cli.support.output import NOTHING, computing_options, printing_options, show

KINDS = (
    "methods",
    "optimizers",
    "families",
    "likelihoods",
    "samplers",
    "simulators",
    "problems",
    "studies",
    "effects",
    "readers",
    "exports",
    "executors",
)


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "list", help="what can be named", description=__doc__, allow_abbrev=False
    )
    parser.set_defaults(run=run)
    parser.add_argument("kind", metavar="KIND", help=", ".join(KINDS))
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the names of one kind, each with a sentence.

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
    UnknownName
        If there is no such kind.
    """
    from dropo.core.services.validation import known

    entries = sentences(known("kind", arguments.kind, KINDS))
    width = max(map(len, entries), default=0)
    lines = [f"{name:<{width}}  {sentence}" for name, sentence in entries.items()]
    show(arguments, "\n".join(lines), entries)
    return 0


def sentences(kind: str) -> dict[str, str]:
    """Find the first sentence of the docstring of each plug-in of a kind, which imports them all.

    Parameters
    ----------
    kind : str
        Such as "methods".

    Returns
    -------
    dict of str to str
        The sentences by name.
    """
    from dropo.core.services.registry import find, names

    return {name: _sentence(kind, name, find) for name in names(kind)}


def _sentence(kind: str, name: str, find: Any) -> str:
    """The first sentence of a plug-in's docstring."""
    try:
        text = inspect.getdoc(find(kind, name)) or ""
    except (ImportError, AttributeError) as error:
        return f"(cannot be imported: {error})"
    paragraph = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]
