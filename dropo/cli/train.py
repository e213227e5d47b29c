"""`dropo train`: trains a policy under a fitted distribution of the simulator's parameters."""

import argparse
import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.fit import variance
from dropo.cli.support.elsewhere import elsewhere_option, run_elsewhere
from dropo.cli.support.folder import RunFolder, run_folder
from dropo.cli.support.output import (
    Progress,
    computing_options,
    printing_options,
    show,
    trusting_option,
    whole,
)

if TYPE_CHECKING:
    from dropo.training.distributions import ParameterDistribution
    from dropo.training.train import Algorithm

ALGORITHMS = {
    "ars": ("dropo.training.ars:ARS", "updates"),
    "ppo": ("dropo.training.networks:PPO", "steps"),
    "sac": ("dropo.training.networks:SAC", "steps"),
}
"""By name: where it is, and which of its settings is the budget."""


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "train",
        help="train a policy under a fitted distribution",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "problem",
        metavar="PROBLEM",
        help="a problem with a task, by its file or name, or the id of a Gymnasium environment",
    )
    parser.add_argument(
        "--fit",
        type=Path,
        metavar="DIR",
        help="what `dropo fit --out` wrote; left out: the model as it is",
    )
    parser.add_argument(
        "--algorithm",
        choices=tuple(ALGORITHMS),
        default="ars",
        help="ars (default): linear; ppo, sac: networks, extra rl",
    )
    parser.add_argument(
        "--budget",
        type=whole(1),
        metavar="N",
        help="updates of ars (200), steps of ppo (1,000,000) and sac (300,000)",
    )
    parser.add_argument(
        "--steps",
        type=whole(1),
        metavar="N",
        help="control steps of an episode; by default the task's",
    )
    parser.add_argument(
        "--noise",
        type=variance,
        metavar="X",
        help="variance of the measurement noise; by default what the fit learned",
    )
    parser.add_argument(
        "--widen",
        type=whole(1),
        metavar="N",
        help="let the spread grow from none over the first N control steps",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=(
            "write policy.json here; the same command resumes after any interruption, that of a"
            " network only with --trust"
        ),
    )
    trusting_option(parser)
    elsewhere_option(parser)
    computing_options(parser)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Train a policy, evaluate it under the distribution and on the target, save and print.

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
    DropoError
        If training was interrupted.
    """
    if arguments.executor is not None:
        return run_elsewhere(arguments)
    with run_folder(arguments.out) as folder:
        return _run(arguments, folder)


def _run(arguments: argparse.Namespace, folder: RunFolder) -> int:
    """Train, save, evaluate and print; the exit status."""
    from dropo.core.services.errors import DropoError
    from dropo.training.environments import resolve
    from dropo.training.evaluate import Compared, broken, evaluate
    from dropo.training.train import train

    target = resolve(arguments.problem, trusted=arguments.trust)
    algorithm = _algorithm(arguments)
    distribution = _distribution(arguments, target)
    folder.claim(_record(arguments, target, algorithm))
    options: dict[str, Any] = {
        "noise": arguments.noise,
        "steps": arguments.steps,
        "threads": arguments.threads,
    }
    progress = Progress(silent=arguments.quiet)
    try:
        policy = train(
            target,
            distribution,
            algorithm,
            rng=arguments.seed,
            out=arguments.out,
            progress=progress,
            trusted=arguments.trust,
            **options,
        )
    except KeyboardInterrupt:
        kept = "with --out, training can be resumed"
        if arguments.out:
            trusted = arguments.trust or arguments.algorithm == "ars"
            kept = f"the same command{'' if trusted else ' with --trust'} goes on from here"
        raise DropoError(f"Interrupted: {kept}.") from None
    finally:
        progress.close()
    path = None if arguments.out is None else policy.save(arguments.out)
    found = {}
    try:
        if distribution is not None:
            found["under the fit"] = evaluate(
                policy, target, distribution=distribution, rng=arguments.seed, **options
            )
        exact = options | {"noise": 0.0}
        found["as it is"] = evaluate(policy, target, rng=arguments.seed, **exact)
    except KeyboardInterrupt:
        if path is None:
            raise
        raise DropoError(f"Interrupted: {path} has the policy, not yet evaluated.") from None
    content = {
        "policy": path and str(path),
        "about": policy.about,
        "returns": {name: value.to_json() for name, value in found.items()},
    }
    failures = policy.about["failed_simulations"]
    remarks = (f"training: {broken(failures)}",) if failures else ()
    show(arguments, Compared(found, remarks), content)
    return 0


def _algorithm(arguments: argparse.Namespace) -> "Algorithm":
    """The algorithm that the command names, with its budget."""
    from importlib import import_module

    from dropo.core.services.optional_dependencies import need

    if arguments.algorithm != "ars":
        need("torch", "stable_baselines3", extra="rl", caller=f"--algorithm {arguments.algorithm}")
    place, budget = ALGORITHMS[arguments.algorithm]
    module, name = place.split(":")
    given = {} if arguments.budget is None else {budget: arguments.budget}
    algorithm: Algorithm = getattr(import_module(module), name)(**given)
    return algorithm


def _distribution(arguments: argparse.Namespace, target: Any) -> "ParameterDistribution | None":
    """The fitted distribution, if it is one of the target's model."""
    from dropo.core.records.fits.fit import Fit
    from dropo.core.services.errors import BadArgument
    from dropo.training.distributions import Curriculum, predictive

    if arguments.fit is None:
        if arguments.widen is not None:
            raise BadArgument("--widen lets the spread of a fit grow, and no --fit was given.")
        return None
    fit = Fit.load(arguments.fit)
    _refuse_other_model(arguments.fit, target)
    distribution = predictive(fit)
    return distribution if arguments.widen is None else Curriculum(distribution, arguments.widen)


def _refuse_other_model(folder: Path, target: Any) -> None:
    """Refuse a fit of another model: it says little about this one."""
    from dropo.core.contracts.problem import Problem
    from dropo.core.records.saved_schema import SavedRun
    from dropo.core.services.errors import Incompatible
    from dropo.core.services.files.file_schema import read_saved
    from dropo.mjmodel.files.loading import model_sum
    from dropo.mjmodel.robot_simulator import RobotSimulator

    if not isinstance(target, Problem) or not isinstance(target.simulator, RobotSimulator):
        return
    path = folder / "run.json"
    if not path.is_file():
        return
    before = read_saved(path, SavedRun, "what a run of dropo decided")
    if before.get("model_sha256") not in (None, model_sum(target.simulator.model)):
        raise Incompatible(
            f"The fit in {folder} is of another model, that of {before.get('problem')!r}: "
            f"not that of {target.name!r}. Train on the problem that was fitted, or fit this one."
        )


def _record(arguments: argparse.Namespace, target: Any, algorithm: "Algorithm") -> dict[str, Any]:
    """Everything that decides the policy."""
    from dropo._version import __version__
    from dropo.core.contracts.problem import Problem
    from dropo.problems.record import problem_record
    from dropo.training.train import settings

    fit = None if arguments.fit is None else _sum_of_fit(arguments.fit)
    of_target = {"problem": arguments.problem}
    if isinstance(target, Problem):
        of_target = problem_record(target)
    return {
        "command": "train",
        "algorithm": algorithm.name,
        "settings": settings(algorithm),
        "fit_sha256": fit,
        "noise": arguments.noise,
        "widen": arguments.widen,
        "episode": arguments.steps,
        "seed": arguments.seed,
        "version": __version__,
        **of_target,
    }


def _sum_of_fit(folder: Path) -> str:
    """The checksum of a fit, but for how long it took: run again it is the same fit."""
    content = json.loads((folder / "fit.json").read_bytes())
    content.pop("wall_time_s", None)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
