"""`dropo data`: describes measured data and checks it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.output import printing_options, show

if TYPE_CHECKING:
    from dropo.core.data import Trajectories
    from dropo.core.problem import Problem


def add(commands: Any) -> None:
    """Adds the command and its own commands to the parser."""
    parser = commands.add_parser("data", help="describe and check data", description=__doc__, allow_abbrev=False)
    below = parser.add_subparsers(metavar="ACTION", required=True)
    for name, function, text in (
        ("describe", run_describe, "transitions, trajectories, and the range of every signal"),
        ("check", run_check, "what looks odd; status 2 where the data cannot be used"),
    ):
        action = below.add_parser(name, help=text, description=text, allow_abbrev=False)
        action.set_defaults(run=function)
        action.add_argument("target", metavar="PROBLEM_OR_DATA", help="a problem, an .npz file, a folder of .npy files or minari:NAME")
        printing_options(action)


def run_describe(arguments: argparse.Namespace) -> int:
    """Prints the table of the data."""
    from dropo.data.check import columns, controls, describe

    trajectories, problem = _target(arguments.target)
    p, q = trajectories.observations.shape[1], trajectories.actions.shape[1]
    description = describe(trajectories, columns(problem, p), controls(problem, q))
    show(arguments, str(description), description.to_json())
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Prints what looks odd; 2 where a finding is an error."""
    from dataclasses import asdict

    from dropo.data.check import check

    trajectories, problem = _target(arguments.target)
    findings = check(trajectories, problem)
    content = {"findings": [asdict(finding) for finding in findings]}
    show(arguments, "\n".join(map(str, findings)) or "Nothing looks odd.", content)
    return 2 if any(finding.level == "error" for finding in findings) else 0


def _target(target: str) -> tuple["Trajectories", "Problem | None"]:
    """A problem with its data, or data alone."""
    from dropo.core.catalogue import names
    from dropo.core.checks import nearest
    from dropo.core.errors import UnknownName
    from dropo.data.reader import MINARI, read

    if target in names("problems") or target.endswith((".yaml", ".yml")):
        from dropo.problems.reader import load

        problem = load(target, checked=False)
        return problem.trajectories, problem
    if not (Path(target).exists() or target.startswith(MINARI) or target.endswith(".npz")):
        raise UnknownName(f"No data and no problem called {target!r}. {nearest(target, names('problems'))}")
    return read(target), None
