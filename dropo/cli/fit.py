"""`dropo fit`: fits the distribution of a problem's parameters."""

import argparse
import math
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
    from dropo.data.outliers.disturbances import Span

NAMED = {"likelihood": "likelihoods", "optimizer": "optimizers", "family": "families"}
OTHERS = (
    *("epsilon", "noise", "start_noise", "degrees", "budget", "draws", "redraw"),
    *("start", "starts"),
)
SETTINGS = (*NAMED, *OTHERS)
"""Options that are settings of the method; those of them that were given are handed to it."""
AUTO = "auto"
EVALUATIONS = "evaluations.jsonl"
"""What a search has evaluated, from which an interrupted fit goes on."""


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "fit",
        help="fit the distribution of the parameters",
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
        "--method",
        default="dropo",
        metavar="NAME",
        help="see `dropo list methods`; dropo by default",
    )
    for name, kind in NAMED.items():
        parser.add_argument(f"--{name}", metavar="NAME", help=f"see `dropo list {kind}`")
    parser.add_argument(
        "--epsilon", type=_epsilon, metavar="X|tune|learn", help="variance of the measurement noise"
    )
    parser.add_argument(
        "--noise",
        choices=("auto", "gaussian"),
        help="what learned noise may be; auto: long tails and outliers are noticed",
    )
    parser.add_argument(
        "--start-noise",
        action="store_true",
        default=None,
        help="the measured start states carry the noise too",
    )
    parser.add_argument(
        "--student-t",
        dest="degrees",
        type=_degrees,
        metavar="NU",
        help="noise with long tails: degrees of freedom",
    )
    parser.add_argument("--starts", choices=("measured", "filtered"), help="where segments start")
    parser.add_argument(
        "--lambda", dest="length", type=_length, metavar="N|auto", help="control steps in a segment"
    )
    parser.add_argument(
        "--budget",
        type=whole(1),
        metavar="N",
        help="evaluations of the likelihood at most; a round that has begun is ended",
    )
    parser.add_argument(
        "--draws",
        type=whole(2, 10**6),
        metavar="K",
        help="simulations for each transition in one evaluation",
    )
    parser.add_argument(
        "--redraw",
        action="store_true",
        default=None,
        help="draws of their own for every evaluation, as published; by default all share them",
    )
    parser.add_argument(
        "--start",
        type=_start,
        metavar="NAME|DIR|PARAMETER=X,...",
        help=(
            "where the search begins: middle, least-squares, random, at the mean of another fit's"
            " folder, or at values"
        ),
    )
    transitions_option(parser)
    parser.add_argument(
        "--simulator",
        metavar="NAME",
        help="what simulates the model in MuJoCo's place: warp, on a GPU",
    )
    parser.add_argument(
        "--unchecked",
        action="store_true",
        help="fit the data even where `dropo data check` finds an error",
    )
    parser.add_argument(
        "--disturbances",
        choices=("auto", "off"),
        default="auto",
        help=(
            "auto: in logs, which have time stamps, spans in which something pushes are found, "
            "listed and left out"
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write fit.json here; the same command resumes after any interruption",
    )
    elsewhere_option(parser)
    computing_options(parser)
    trusting_option(parser, PARTS)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fit, save and print.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Returns
    -------
    int
        0, or 1 if the fit was interrupted.

    Raises
    ------
    InvalidInput
        If the problem, a setting or the folder is refused; nothing is written then.
    """
    if arguments.executor is not None:
        return run_elsewhere(arguments)
    with run_folder(arguments.out) as folder:
        return _run(arguments, folder)


def _run(arguments: argparse.Namespace, folder: RunFolder) -> int:
    """Fit, print and save; the exit status."""
    from dropo.cli.support.record import keep_for_report, run_record
    from dropo.core.contracts.support.fit_by_name import estimator_for
    from dropo.core.records.fits.fit import Fit, Status
    from dropo.core.records.fits.fit_choices import ExcludedSpan, ExcludedSpans
    from dropo.core.services.errors import DropoError
    from dropo.core.services.files.evaluation_log import EvaluationLog
    from dropo.core.services.files.progress_file import PROGRESS
    from dropo.estimators.support.segment_length import ChooseHorizon
    from dropo.evaluation.predictions import predict

    problem, spans = _without_disturbances(arguments, _problem(arguments))
    if arguments.simulator is not None:
        problem = problem.using(simulator=arguments.simulator)
    options = {name: getattr(arguments, name) for name in SETTINGS}
    given = {name: value for name, value in options.items() if value is not None}
    if isinstance(arguments.start, Path):
        given["start"] = Fit.load(arguments.start)
    if arguments.length is not None and arguments.method == "dropo":
        # Who says how long a segment is wants segments, from measured states.
        given.setdefault("likelihood", problem.settings.get("likelihood", "emulated"))
    estimator = estimator_for(problem, arguments.method, given)
    record = run_record("fit", arguments.method, estimator, problem, arguments.seed)
    if arguments.length == AUTO:
        estimator = ChooseHorizon(estimator)
        record = {**record, "lambda": AUTO}
    folder.claim(record)
    evaluation_log = EvaluationLog(folder.file(EVALUATIONS), record)
    progress = Progress(silent=arguments.quiet, path=folder.file(PROGRESS))
    try:
        with progress.answering(), folder.going_on_from(EVALUATIONS):
            fit = estimator.fit(
                problem, rng=arguments.seed, evaluation_log=evaluation_log, progress=progress
            )
    finally:
        progress.close()
    if spans:
        excluded = tuple(ExcludedSpan.from_json(span.to_json()) for span in spans)
        fit = replace(fit, excluded=ExcludedSpans(excluded))

    def save() -> None:
        if arguments.out is None:
            return
        fit.save(arguments.out)
        try:
            keep_for_report(arguments, predict(problem, fit))
        except KeyboardInterrupt:
            kept = f"{arguments.out} has the fit, but not all that its report shows"
            raise DropoError(f"Interrupted at the end: {kept}.") from None

    show_and_save(arguments, fit, fit.to_json(), save)
    return 1 if fit.status is Status.INTERRUPTED else 0


def _without_disturbances(
    arguments: argparse.Namespace, problem: "Problem"
) -> "tuple[Problem, tuple[Span, ...]]":
    """A log's problem without its disturbed spans, of which it warns, and these spans."""
    from dropo.data.outliers.without_disturbances import remove_disturbances

    searched = arguments.disturbances == AUTO and problem.trajectories.time is not None
    found = remove_disturbances(problem) if searched else None
    if found is None:
        return problem, ()
    sentences = [f"left out, since no command explains it: {span}" for span in found.spans]
    return replace(found.problem, warnings=(*problem.warnings, *sentences)), found.spans


def _problem(arguments: argparse.Namespace) -> "Problem":
    """The problem that the command names, with its options."""
    from dropo.core.services.errors import BadFile, Incompatible
    from dropo.data.checks.check import shorter_than_lambda
    from dropo.problems.loading import load

    problem = load(
        arguments.problem,
        threads=arguments.threads,
        checked=not arguments.unchecked,
        trusted=arguments.trust,
    )
    if len(problem.space) == 0:
        beside = Path(arguments.problem).with_name("fit.yaml")
        advice = "none (`dropo init` and `dropo data import` list some as comments)"
        if beside.exists():
            advice = f"none; {beside} has what was found as parameters"
        raise BadFile(arguments.problem, "parameters", "at least one parameter to fit", advice)
    if arguments.length is not None and problem.reset == "start":
        raise Incompatible(
            "--lambda has no meaning with `reset: start`, where a segment is a whole "
            "trajectory. Leave it out."
        )
    horizon = None if arguments.length == AUTO else arguments.length
    problem = problem.using(transitions=arguments.transitions, horizon=horizon)
    too_short = [finding.sentence for finding in shorter_than_lambda(problem)]
    return replace(problem, warnings=(*problem.warnings, *too_short))


def _epsilon(text: str) -> float | str:
    """A type for argparse: a variance, "tune" or "learn"."""
    return text if text in ("tune", "learn") else variance(text, ", 'tune' or 'learn'")


def variance(text: str, words: str = "") -> float:
    """Read a variance, as a type for argparse.

    Parameters
    ----------
    text : str
        What the command line has.
    words : str
        What else could stand there, for the message.

    Returns
    -------
    float

    Raises
    ------
    argparse.ArgumentTypeError
        If it is no number of 0 or more.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected a variance of 0 or more{words}, got {text!r}")
    return value


def _degrees(text: str) -> float:
    """A type for argparse: degrees of freedom above 2."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 2):
        raise argparse.ArgumentTypeError(
            f"expected degrees of freedom, a number above 2, got {text!r}"
        )
    return value


def _start(text: str) -> Any:
    """A type for argparse: a name, the folder of a fit, or values by parameter."""
    if "=" not in text:
        return Path(text) if Path(text).is_dir() else text
    values = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"expected values such as mass=1.5,friction=0.2, got {part!r}"
            ) from None
    return values


def _length(text: str) -> int | str:
    """A type for argparse: a number of control steps, or "auto"."""
    return text if text == AUTO else whole(1)(text)
