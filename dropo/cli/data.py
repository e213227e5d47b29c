"""`dropo data`: imports raw logs, describes and checks measured data, compares inputs, estimates
states and infers actions.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.support.output import (
    NOTHING,
    PARTS,
    Progress,
    computing_options,
    printing_options,
    show,
    transitions_option,
    trusting_option,
)

if TYPE_CHECKING:
    from dropo.core.contracts.problem import Problem
    from dropo.core.records.trajectories import Trajectories
    from dropo.data.checks.findings import Finding


def add(commands: Any) -> None:
    """Add the command with its own commands to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "data", help="import, describe and check data", description=__doc__, allow_abbrev=False
    )
    below = parser.add_subparsers(metavar="ACTION", required=True)
    target = "a problem, an .npz file, a folder of .npy files or minari:NAME"
    _add_import(below)
    describe = _action(
        below, "describe", run_describe, "transitions, trajectories, and the range of every signal"
    )
    describe.add_argument("target", metavar="PROBLEM_OR_DATA", help=target)
    transitions_option(describe)
    check = _action(
        below, "check", run_check, "what looks odd; status 2 where the data cannot be used"
    )
    check.add_argument(
        "target", nargs="+", metavar="PROBLEM_OR_DATA", help=f"{target}; with --map, raw logs"
    )
    check.add_argument("--map", type=Path, metavar="FILE", help="the mapping file, for raw logs")
    check.add_argument("--model", type=Path, metavar="MJCF", help="the model, for raw logs")
    transitions_option(check)
    inputs = _action(
        below,
        "inputs",
        run_inputs,
        "which of several logged commands to trust, by data that no fit saw",
        threads="",
    )
    inputs.add_argument(
        "problem",
        metavar="PROBLEM",
        help="a problem, or a problem file whose data hold several commands",
    )
    transitions_option(inputs)
    states = _action(
        below,
        "states",
        run_states,
        "states estimated with the model in place of the measured ones, as a problem",
        threads="",
    )
    states.add_argument("problem", metavar="PROBLEM", help="a problem file or a built-in name")
    states.add_argument(
        "--unmeasured",
        nargs="+",
        default=[],
        metavar="SIGNAL",
        help="signals whose data are a guess, such as qvel.elbow",
    )
    states.add_argument(
        "--causal",
        action="store_true",
        help="a filter: each state by the measurements up to it alone",
    )
    states.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="the folder of the new problem"
    )
    transitions_option(states)
    _add_actions(below)


def _add_import(below: Any) -> None:
    """Add `dropo data import`."""
    text = "turn raw logs into data and a problem file: CSV, Parquet, NPZ, MCAP, ROS bags, episodes"
    parser = _action(below, "import", run_import, text)
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help="a file or folder; each is a recording, or holds several runs",
    )
    parser.add_argument(
        "--map",
        type=Path,
        required=True,
        metavar="FILE",
        help="which column is which joint or actuator (YAML)",
    )
    parser.add_argument(
        "--model", type=Path, required=True, metavar="MJCF", help="the model, an MJCF file"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the data file, .npz; problem.yaml and import.json beside it",
    )


def _add_actions(below: Any) -> None:
    """Add `dropo data actions`."""
    text = "the actions that explain a motion whose commands were not recorded, as data"
    parser = _action(below, "actions", run_actions, text, threads="")
    parser.add_argument(
        "problem",
        metavar="PROBLEM",
        help="a problem file, whose data need no actions, or a built-in name",
    )
    parser.add_argument(
        "--controllers",
        choices=("modelled", "ideal"),
        default="modelled",
        help=(
            "modelled, the default: by inverse dynamics; ideal: position and velocity "
            "controllers reach their set point"
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="the new data file, .npz"
    )


def _action(
    below: Any, name: str, function: Any, text: str, threads: str = NOTHING
) -> argparse.ArgumentParser:
    """Add an action that a function runs, with the options that all have."""
    parser: argparse.ArgumentParser = below.add_parser(
        name, help=text, description=text, allow_abbrev=False
    )
    parser.set_defaults(run=function)
    computing_options(parser, seed=NOTHING, threads=threads)
    trusting_option(parser, PARTS)
    printing_options(parser)
    return parser


def run_import(arguments: argparse.Namespace) -> int:
    """Import logs, and print what was made of them.

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
    from dropo.logs.importing import import_logs

    progress = Progress(silent=arguments.quiet)
    try:
        found = import_logs(
            arguments.logs, arguments.map, arguments.model, arguments.out, progress=progress
        )
    finally:
        progress.close()
    show(arguments, found, found.to_json())
    return 0


def run_describe(arguments: argparse.Namespace) -> int:
    """Print the table of the data.

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
    from dropo.data.describe import columns, controls, describe

    trajectories, problem = _target(arguments.target, arguments)
    p = trajectories.observations.shape[1]
    q = trajectories.actions.shape[1]
    description = describe(trajectories, columns(problem, p), controls(problem, q))
    show(arguments, description, description.to_json())
    return 0


def run_inputs(arguments: argparse.Namespace) -> int:
    """Print the inputs of a problem, the best first.

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
    from dropo.core.services.errors import Incompatible
    from dropo.diagnosis.findings.premises.input_choice import choose_problem_input
    from dropo.problems.loading import inputs_of, load

    names = inputs_of(arguments.problem)
    if len(names) < 2:
        raise Incompatible(
            f"{arguments.problem} knows one command alone. An import keeps several: map "
            "them under `inputs`."
        )
    problems = {
        name: load(
            arguments.problem, threads=arguments.threads, input=name, trusted=arguments.trust
        ).using(transitions=arguments.transitions)
        for name in names
    }
    found = choose_problem_input(problems)
    show(arguments, found, found.to_json())
    return 0


def run_states(arguments: argparse.Namespace) -> int:
    """Estimate states under the nominal parameters, and write the problem with them.

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
    from dropo.logs.signals.states import with_states
    from dropo.problems.file.writer import write_problem
    from dropo.problems.loading import load

    measured = load(arguments.problem, threads=arguments.threads, trusted=arguments.trust)
    measured = measured.using(transitions=arguments.transitions)
    problem, found = with_states(measured, arguments.unmeasured, causal=arguments.causal)
    write_problem(problem, arguments.out)
    show(arguments, found, found.to_json())
    return 0


def run_actions(arguments: argparse.Namespace) -> int:
    """Infer the actions, write the data with them, and print how well they replay.

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
    from dropo.problems.actions import check_place, infer_actions

    check_place(arguments.out, arguments.problem)
    found = infer_actions(
        arguments.problem,
        arguments.controllers,
        threads=arguments.threads,
        trusted=arguments.trust,
    )
    found.save(arguments.out)
    show(arguments, found, found.to_json())
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Print what is suspicious in the data.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0, or 2 if a finding is an error.

    Raises
    ------
    InvalidInput
        If the input is refused; nothing is written then.
    """
    from dataclasses import asdict

    findings = _findings(arguments)
    content = {"findings": [asdict(finding) for finding in findings]}
    show(arguments, "\n".join(map(str, findings)) or "Nothing looks odd.", content)
    return 2 if any(finding.level == "error" for finding in findings) else 0


def _findings(arguments: argparse.Namespace) -> "list[Finding]":
    """The findings in a problem's data, a data set or raw logs, errors first."""
    from dataclasses import replace

    from dropo.core.services.errors import BadArgument
    from dropo.data.checks.check import check
    from dropo.data.checks.findings import errors_first

    if (arguments.map is None) != (arguments.model is None):
        raise BadArgument(
            "Raw logs are checked with both --map and --model. Got one of them alone."
        )
    if arguments.map is not None:
        if arguments.transitions is not None:
            raise BadArgument("--transitions is of problems and data; raw logs have rows.")
        return _raw_findings(arguments)
    if len(arguments.target) > 1:
        raise BadArgument(
            "One problem or data set is checked at a time; several raw logs need --map and --model."
        )
    trajectories, problem = _target(arguments.target[0], arguments)
    found = check(trajectories, problem)
    if problem is not None and problem.held_out is not None:
        for finding in check(problem.held_out, problem.simulator):
            found.append(replace(finding, run="held out"))
    return errors_first(found)


def _raw_findings(arguments: argparse.Namespace) -> "list[Finding]":
    """The findings in raw logs."""
    from dropo.logs.guessing.check import check_logs
    from dropo.logs.mapping import read_mapping
    from dropo.logs.recordings import read_runs
    from dropo.mjmodel.joints import load_model_joints

    joints = load_model_joints(arguments.model)
    progress = Progress(silent=arguments.quiet)
    try:
        mapping = read_mapping(arguments.map, joints)
        runs = read_runs(arguments.target, mapping, progress)
        return check_logs(arguments.target, runs, mapping, joints)
    finally:
        progress.close()


def _target(target: str, arguments: argparse.Namespace) -> tuple["Trajectories", "Problem | None"]:
    """A problem with its data, or data alone; the first transitions where these are asked for."""
    from dropo.core.services.errors import UnknownName
    from dropo.core.services.registry import names
    from dropo.core.services.validation import nearest
    from dropo.data.reading import MINARI, read
    from dropo.problems.loading import load, refuse_folder

    if target in names("problems") or target.endswith((".yaml", ".yml")):
        problem = load(target, checked=False, trusted=arguments.trust)
        problem = problem.using(transitions=arguments.transitions)
        return problem.trajectories, problem
    refuse_folder(target)
    if not (Path(target).exists() or target.startswith(MINARI) or target.endswith(".npz")):
        raise UnknownName(
            f"No data and no problem called {target!r}. {nearest(target, names('problems'))}"
        )
    data = read(target)
    return (data if arguments.transitions is None else data.head(arguments.transitions)), None
