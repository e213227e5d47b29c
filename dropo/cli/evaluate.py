"""`dropo evaluate`: plays a policy on a target and says what it returns."""

import argparse
import os
from pathlib import Path
from typing import Any

from dropo.cli.fit import variance
from dropo.cli.support.output import (
    computing_options,
    printing_options,
    show,
    trusting_option,
    whole,
)

BESIDE = "beside the policy"


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
    parser = commands.add_parser(
        "evaluate", help="play a policy on a target", description=__doc__, allow_abbrev=False
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "policy",
        type=Path,
        metavar="POLICY",
        help="what `dropo train --out` wrote: the folder, or policy.json in it",
    )
    on = (
        "a problem by its file or name (with its true parameters, where known), or the id of a "
        "Gymnasium environment such as Hopper-v5"
    )
    parser.add_argument("--on", required=True, metavar="PROBLEM", help=on)
    parser.add_argument(
        "--fit", type=Path, metavar="DIR", help="draw the target's parameters from this fit"
    )
    parser.add_argument(
        "--episodes", type=whole(1, 10**6), default=100, metavar="N", help="100 by default"
    )
    parser.add_argument(
        "--steps",
        type=whole(1),
        metavar="N",
        help="control steps of an episode; by default those of the training",
    )
    parser.add_argument(
        "--noise",
        type=variance,
        metavar="X",
        help="variance of the measurement noise; by default none, or the fit's",
    )
    parser.add_argument(
        "--video",
        nargs="?",
        type=Path,
        const=Path(BESIDE),
        metavar="FILE",
        help="also an episode as an .mp4",
    )
    trusting_option(parser)
    computing_options(parser)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate a policy, print its returns, and make a video where asked.

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
    if arguments.video is not None and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    from dropo.core.records.fits.fit import Fit
    from dropo.training.environments import resolve
    from dropo.training.evaluate import evaluate, motion
    from dropo.training.policy import load_policy

    policy = load_policy(arguments.policy, trusted=arguments.trust)
    target = resolve(arguments.on, trusted=arguments.trust)
    distribution = None if arguments.fit is None else Fit.load(arguments.fit)
    found = evaluate(
        policy,
        target,
        distribution=distribution,
        episodes=arguments.episodes,
        steps=arguments.steps,
        noise=arguments.noise,
        rng=arguments.seed,
        threads=arguments.threads,
    )
    content = found.to_json()
    video = None
    if arguments.video is not None:
        from dropo.report.robot.video import write_motion

        place = arguments.policy if arguments.policy.is_dir() else arguments.policy.parent
        path = place / "policy.mp4" if arguments.video == Path(BESIDE) else arguments.video
        shown = motion(policy, target, steps=arguments.steps, rng=arguments.seed)
        video = str(write_motion(*shown, path))
        content["video"] = video
    show(arguments, found if video is None else f"{found}\n{video}", content)
    return 0
