"""`dropo fit`: fits the distribution of a problem's parameters."""

import argparse
import json
import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.output import Progress, computing_options, printing_options, show, whole

if TYPE_CHECKING:
    from dropo.core.contracts.estimator import Estimator
    from dropo.core.contracts.problem import Problem
    from dropo.core.records.fit import Fit
    from dropo.core.services.evaluation_log import EvaluationLog
    from dropo.data.outliers.disturbances import Span

NAMED = {"likelihood": "likelihoods", "optimizer": "optimizers", "family": "families"}
SETTINGS = (*NAMED, "epsilon", "start_noise", "degrees", "budget", "draws", "start", "starts")
"""Options that are settings of the method; those of them that were given are handed to it."""
AUTO = "auto"


def add(commands: Any) -> None:
    """Add the command to the parser `commands`."""
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
        "--budget", type=whole(1), metavar="N", help="evaluations of the likelihood at most"
    )
    parser.add_argument(
        "--draws",
        type=whole(2),
        metavar="K",
        help="simulations for each transition in one evaluation",
    )
    parser.add_argument(
        "--start", choices=("middle", "least-squares", "random"), help="where the search begins"
    )
    parser.add_argument(
        "--transitions", type=whole(1), metavar="N", help="use the first N transitions alone"
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
    computing_options(parser)
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
    from dropo.cli.record import keep_for_report, run_record
    from dropo.core.contracts.fit_by_name import estimator_for
    from dropo.core.records.fit import Status
    from dropo.core.records.fit_choices import ExcludedSpan, ExcludedSpans
    from dropo.core.services.evaluation_log import EvaluationLog
    from dropo.estimators.support.segment_length import ChooseHorizon
    from dropo.evaluation.predictions import predict

    problem, spans = _without_disturbances(arguments, _problem(arguments))
    options = {name: getattr(arguments, name) for name in SETTINGS}
    given = {name: value for name, value in options.items() if value is not None}
    estimator = estimator_for(problem, arguments.method, given)
    record = run_record("fit", arguments.method, estimator, problem, arguments.seed)
    if arguments.length == AUTO:
        estimator = ChooseHorizon(estimator)
        record = {**record, "lambda": AUTO}
    check_folder(arguments.out, record)
    path = arguments.out / "evaluations.jsonl" if arguments.out else None
    evaluation_log = EvaluationLog(path, record)
    fit = _fit(arguments, estimator, problem, evaluation_log)
    if spans:
        excluded = tuple(ExcludedSpan.from_json(span.to_json()) for span in spans)
        fit = replace(fit, excluded=ExcludedSpans(excluded))
    if arguments.out:
        _save(arguments.out, fit, record)
        keep_for_report(arguments, predict(problem, fit))
    show(arguments, fit, fit.to_json())
    return 1 if fit.status is Status.INTERRUPTED else 0


def _fit(
    arguments: argparse.Namespace,
    estimator: "Estimator",
    problem: "Problem",
    evaluation_log: "EvaluationLog",
) -> "Fit":
    """The fit, with progress; a refused run leaves nothing behind."""
    from dropo.core.services.errors import InvalidInput

    folder_is_new = arguments.out is not None and not arguments.out.exists()
    progress = Progress(silent=arguments.quiet)
    try:
        with terminable():
            return estimator.fit(
                problem, rng=arguments.seed, evaluation_log=evaluation_log, progress=progress
            )
    except InvalidInput:
        if evaluation_log.path is not None and evaluation_log.replayed == 0:
            _remove(evaluation_log.path, folder_is_new)
        raise
    finally:
        progress.close()


def _remove(evaluation_log: Path, folder_too: bool) -> None:
    """Remove the evaluation log of a refused run, and its folder if that is new and empty."""
    evaluation_log.unlink(missing_ok=True)
    if folder_too and evaluation_log.parent.is_dir() and not any(evaluation_log.parent.iterdir()):
        evaluation_log.parent.rmdir()


@contextmanager
def terminable() -> Iterator[None]:
    """Let SIGTERM end the work inside a block like Ctrl-C, with the best result so far."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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

    problem = load(arguments.problem, threads=arguments.threads, checked=not arguments.unchecked)
    if len(problem.space) == 0:
        raise BadFile(arguments.problem, "parameters", "at least one parameter to fit", "none")
    if arguments.length is not None and problem.reset == "start":
        raise Incompatible(
            "--lambda has no meaning with `reset: start`, where a segment is a whole "
            "trajectory. Leave it out."
        )
    horizon = None if arguments.length == AUTO else arguments.length
    problem = problem.using(transitions=arguments.transitions, horizon=horizon)
    too_short = [finding.sentence for finding in shorter_than_lambda(problem)]
    return replace(problem, warnings=(*problem.warnings, *too_short))


def check_folder(folder: Path | None, record: dict[str, Any]) -> None:
    """Refuse a folder that holds another run's result.

    Parameters
    ----------
    folder : Path or None
        Where the result is to be written; None: nowhere.
    record : dict
        What this run is.

    Raises
    ------
    BadFile
        If the path is no folder, or holds the record of another run.
    """
    from dropo.core.services.errors import BadFile

    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise BadFile(folder, "--out", "a folder", "a file")
    path = folder / "run.json"
    if not path.is_file():
        return
    try:
        before = json.loads(path.read_text())
    except ValueError:
        raise BadFile(path, "", "what `dropo fit` wrote", "a file that is not JSON") from None
    differ = sorted(key for key in {*record, *before} if record.get(key) != before.get(key))
    if differ:
        got = "those of another run (use another --out, or the settings of that run)"
        raise BadFile(path, ", ".join(differ), "the settings of this run", got)


def _save(folder: Path, fit: "Fit", record: dict[str, Any]) -> None:
    """Write run.json, then fit.json and fit.npz; each appears whole or not at all."""
    from dropo.core.services.atomic_write import write_json

    write_json(folder / "run.json", record)
    fit.save(folder)


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


def _length(text: str) -> int | str:
    """A type for argparse: a number of control steps, or "auto"."""
    return text if text == AUTO else whole(1)(text)
