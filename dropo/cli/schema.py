"""`dropo schema`: the JSON Schema of problem files or mapping files, for editors."""

import argparse
import json
from typing import Any

from dropo.cli.support.output import NOTHING, computing_options, printing_options, show

SCHEMAS = {
    "problem": ("dropo.problems.file.schema", "ProblemFile"),
    "mapping": ("dropo.logs.mapping_schema", "MappingFile"),
}
"""Kinds of files, with the module and the class of their schema."""


def add(commands: Any) -> None:
    """Add the command to the parser.

    Parameters
    ----------
    commands
        The parser's commands.
    """
    text = "the JSON Schema of problem files, for editors"
    parser = commands.add_parser("schema", help=text, description=__doc__, allow_abbrev=False)
    parser.set_defaults(run=run)
    kinds = "problem, the default, or mapping"
    parser.add_argument("--of", default="problem", metavar="KIND", help=kinds)
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the schema of one kind of file.

    Parameters
    ----------
    arguments
        `of`, the kind, and `quiet`.

    Returns
    -------
    int
        The exit status, 0.

    Raises
    ------
    UnknownName
        If there is no such kind of file.
    """
    from importlib import import_module

    from dropo.core.services.files.file_schema import json_schema
    from dropo.core.services.validation import known

    module, name = SCHEMAS[known("kind of file", arguments.of, SCHEMAS)]
    schema = json_schema(getattr(import_module(module), name))
    show(arguments, json.dumps(schema, indent=1), schema)
    return 0
