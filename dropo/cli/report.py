"""`dropo report`: a single HTML page from the folder of a fit or a diagnosis."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.output import NOTHING, computing_options, printing_options, show

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator
    from dropo.report.folder import Result


def add(commands: Any) -> None:
    """Add the command to the parser `commands`."""
    parser = commands.add_parser(
        "report",
        help="make a page of a fit or a diagnosis",
        description=__doc__,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "folder",
        type=Path,
        metavar="DIR",
        help="what `dropo fit --out` or `dropo diagnose --out` wrote",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="DIR/report.html by default")
    parser.add_argument(
        "--video",
        action="store_true",
        help="also measured and simulated motion as an .mp4 beside it; needs the model",
    )
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the page, and the video where asked.

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
    from dropo.report.build import write_page
    from dropo.report.folder import read_result

    if arguments.video and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    result = read_result(arguments.folder)
    path = arguments.out or arguments.folder / "report.html"
    simulator = _simulator(result) if arguments.video else None
    written = {"report": str(write_page(result, path))}
    if simulator is not None and result.predictions is not None:
        from dropo.report.robot.video import write_video

        written["video"] = str(write_video(result.predictions, simulator, path.with_suffix(".mp4")))
    show(arguments, "\n".join(written.values()), written)
    return 0


def _simulator(result: "Result") -> "RobotSimulator":
    """The problem's simulator, if its model is still that of the run."""
    from dropo.core.services.errors import Incompatible
    from dropo.mjmodel.loading import model_sum
    from dropo.mjmodel.robot_simulator import RobotSimulator
    from dropo.problems.loading import load

    if result.predictions is None or "problem" not in result.made:
        raise Incompatible(
            f"{result.folder} keeps no motion to show. Run `dropo fit --out` or `dropo "
            "diagnose --out`, or leave out --video."
        )
    place = result.folder / result.made["problem"]
    named = place if place.is_file() else result.made["problem"]
    simulator = load(named, checked=False, trusted=False).simulator
    if not isinstance(simulator, RobotSimulator):
        raise Incompatible(f"{type(simulator).__name__} has no bodies to show. Leave out --video.")
    if model_sum(simulator.model) != result.record.get("model_sha256"):
        raise Incompatible(
            f"The model of {result.made['problem']} is not the one of this run. Put that "
            "one back, or leave out --video."
        )
    return simulator
