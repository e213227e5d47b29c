"""`dropo diagnose`: shows what the simulation gets wrong, names the cause, extends the model,
measures the gain.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.support.elsewhere import elsewhere_option, run_elsewhere
from dropo.cli.support.folder import RunFolder, run_folder
from dropo.cli.support.output import (
    PARTS,
    Progress,
    computing_options,
    printing_options,
    show_and_save,
    transitions_option,
    trusting_option,
    whole,
)

if TYPE_CHECKING:
    from dropo.core.contracts.problem import Problem
    from dropo.core.services.files.evaluation_log import EvaluationLog
    from dropo.diagnosis.regression.result import QuickDiagnosis
    from dropo.diagnosis.result import Diagnosis

SEARCH = "search.jsonl"
"""What a search has fitted, while it lives: from it an interrupted diagnosis goes on."""


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "diagnose",
        help="show what the simulation gets wrong",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "problem",
        metavar="PROBLEM",
        help="a problem file or a built-in name (see `dropo list problems`)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="by regression over inverse dynamics alone, in a second or a few",
    )
    parser.add_argument(
        "--effects",
        nargs="+",
        metavar="NAME",
        help="look for these alone, or EFFECT:PLACE (see `dropo list effects`)",
    )
    parser.add_argument(
        "--hide",
        action="append",
        default=[],
        metavar="EFFECT:TARGET=VALUE",
        help="hide an effect in a built-in problem's simulated data",
    )
    parser.add_argument(
        "--reference",
        nargs="+",
        metavar="RUN",
        help=(
            "say what differs in each run from these normal ones, by name, pattern or number; by"
            " default those that the problem marks, if any"
        ),
    )
    parser.add_argument(
        "--steps",
        type=whole(1),
        metavar="N",
        help="control steps in a window; by default what the problem or its noise asks for",
    )
    transitions_option(parser)
    parser.add_argument(
        "--unchecked",
        action="store_true",
        help="take the data even where `dropo data check` finds an error",
    )
    parser.add_argument(
        "--disturbances",
        choices=("auto", "off"),
        default="auto",
        help=(
            "auto: spans of time in which something pushes, which no cause explains, are "
            "found, listed and left out"
        ),
    )
    parser.add_argument(
        "--wiring",
        choices=("auto", "off"),
        default="auto",
        help=(
            "auto: signs, units and places of columns are checked first, and where one is wrong "
            "that is the finding; off: they are taken to be right"
        ),
    )
    parser.add_argument(
        "--learned",
        action="store_true",
        help=(
            "put forces that are learned from what nothing explains into the extended model, "
            "however little of that they explain"
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=(
            "write diagnosis.json here, and the extended problem; the same command resumes after"
            " any interruption"
        ),
    )
    elsewhere_option(parser)
    computing_options(parser)
    trusting_option(parser, PARTS)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Diagnose, save and print.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0, or 1 if the diagnosis was interrupted.

    Raises
    ------
    InvalidInput
        If the input is refused; nothing is written then.
    DropoError
        If the diagnosis was interrupted before there was a result.
    """
    if arguments.executor is not None:
        return run_elsewhere(arguments)
    _refuse_with_quick(arguments)
    with run_folder(arguments.out) as folder:
        return _run(arguments, folder)


def _run(arguments: argparse.Namespace, folder: RunFolder) -> int:
    """Diagnose, print and save; the exit status."""
    from dropo.cli.support.record import diagnosis_record, keep_for_report
    from dropo.core.services.files.evaluation_log import EvaluationLog
    from dropo.diagnosis.findings.fittable import fittable
    from dropo.problems.file.plain_model import write_extended

    problem = _problem(arguments)
    record = diagnosis_record(arguments, problem)
    if arguments.reference or (problem.reference and not arguments.quick):
        return _compare(arguments, problem, record, folder)
    folder.claim(record)
    log = EvaluationLog(folder.file(SEARCH), record)
    with folder.going_on_from(SEARCH):
        found = _diagnosis(arguments, problem, log, folder)

    def save() -> None:
        if arguments.out is not None:
            found.save(arguments.out)
            to_fit = fittable(found.problem, found.causes)
            write_extended(found.problem, found.parameters, arguments.out / "extended", to_fit)
            keep_for_report(arguments, None)
            if not found.interrupted:
                (arguments.out / SEARCH).unlink(missing_ok=True)

    show_and_save(arguments, found, found.to_json(), save)
    return 1 if found.interrupted else 0


def _compare(
    arguments: argparse.Namespace, problem: "Problem", record: dict[str, Any], folder: RunFolder
) -> int:
    """Compare every run with the reference runs, print and save; the exit status."""
    from dropo.cli.support.record import keep_for_report
    from dropo.diagnosis.reference.compare import check_comparison, compare_with_reference

    check_comparison(problem, arguments.reference, arguments.effects)
    folder.claim(record)
    found = compare_with_reference(problem, arguments.reference, arguments.effects)

    def save() -> None:
        if arguments.out is not None:
            found.save(arguments.out)
            keep_for_report(arguments, None)

    show_and_save(arguments, found, found.to_json(), save)
    return 0


def _diagnosis(
    arguments: argparse.Namespace, problem: "Problem", log: "EvaluationLog", folder: RunFolder
) -> "Diagnosis | QuickDiagnosis":
    """What a search by simulation finds, or with --quick a regression alone."""
    if arguments.quick:
        from dropo.diagnosis.regression.quick import QuickDiagnose

        return QuickDiagnose().run(problem)
    from dropo.core.services.files.progress_file import PROGRESS
    from dropo.diagnosis.diagnose import Diagnose
    from dropo.diagnosis.settings import DiagnosisSettings

    progress = Progress(silent=arguments.quiet, path=folder.file(PROGRESS))
    try:
        settings = DiagnosisSettings()
        if arguments.wiring == "off":
            settings = replace(settings, wiring=None)
        diagnose = Diagnose(
            arguments.effects,
            length=arguments.steps,
            disturbances=arguments.disturbances == "auto",
            learned=arguments.learned,
            settings=settings,
        )
        return diagnose.run(problem, rng=arguments.seed, evaluation_log=log, progress=progress)
    finally:
        progress.close()


def _refuse_with_quick(arguments: argparse.Namespace) -> None:
    """Refuse options of the search by simulation where none is made."""
    from dropo.core.services.errors import BadArgument

    given = {
        "--effects": arguments.effects,
        "--steps": arguments.steps,
        "--reference": arguments.reference,
        "--learned": arguments.learned or None,
    }
    for option, value in given.items():
        if arguments.quick and value is not None:
            raise BadArgument(
                f"{option} belongs to the search by simulation, which --quick leaves out. Leave "
                f"out one of the two. Got {option}{'' if value is True else f' {value}'}."
            )


def _problem(arguments: argparse.Namespace) -> "Problem":
    """The problem that the command names, with effects hidden where it says so."""
    from dropo.problems.loading import load
    from dropo.problems.simulated.hidden import hide

    if arguments.hide:
        problem = hide(
            arguments.problem, arguments.hide, seed=arguments.seed, threads=arguments.threads
        )
    else:
        problem = load(
            arguments.problem,
            threads=arguments.threads,
            checked=not arguments.unchecked,
            trusted=arguments.trust,
        )
    return problem.using(transitions=arguments.transitions)
