"""`dropo report`: a single HTML page from the folder of a fit or a diagnosis."""

import argparse
import os
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropo.cli.support.output import NOTHING, computing_options, printing_options, show, whole

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator
    from dropo.report.folder import Media, Result

PORT = 8000
"""Where --serve listens by default ..."""
HERE = "127.0.0.1"
"""... and at which address: this machine's alone."""


def add(commands: Any) -> None:
    """Add the command to the parser `commands`.

    Parameters
    ----------
    commands
        The subparsers of `dropo`, to which it is added.
    """
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
        help="with measured and simulated motion as a video, also as an .mp4; needs the model",
    )
    parser.add_argument(
        "--serve",
        nargs="?",
        type=whole(0, most=65535),
        const=PORT,
        metavar="PORT",
        help=f"serve the page, renewed while the run is at work, until Ctrl-C; port {PORT} by "
        "default, 0 for any that is free",
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help=f"the address at which --serve listens, {HERE} by default; 0.0.0.0 for others in the "
        "network, such as a phone",
    )
    computing_options(parser, seed=NOTHING, threads=NOTHING)
    printing_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the page, and the video where asked; or serve it.

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
    from dropo.core.services.errors import BadArgument
    from dropo.core.services.files.atomic_write import write_bytes
    from dropo.report.build import write_page
    from dropo.report.folder import read_result

    if arguments.serve is not None:
        return _serve(arguments)
    if arguments.host is not None:
        raise BadArgument(f"--host belongs to --serve. Got --host {arguments.host} alone.")
    if arguments.video and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    result = read_result(arguments.folder)
    path = arguments.out or arguments.folder / "report.html"
    if arguments.video:
        result = replace(result, media=_rendered(result))
    written = {"report": str(write_page(result, path))}
    if result.media is not None:
        video = path.with_suffix(".mp4")
        write_bytes(video, result.media.video)
        written["video"] = str(video)
    show(arguments, "\n".join(written.values()), written)
    return 0


def _serve(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; 0."""
    from dropo.core.services.errors import BadArgument
    from dropo.report.live import live_server

    for option, given in (("--out", arguments.out), ("--video", arguments.video)):
        if given:
            raise BadArgument(f"--serve writes nothing. Leave out {option}, or --serve.")
    host = arguments.host or HERE
    with live_server(arguments.folder, host, arguments.serve) as server:
        port = server.server_address[1]
        address = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        text = f"{address} shows {arguments.folder}; Ctrl-C ends it."
        show(arguments, text, {"address": address})
        with suppress(KeyboardInterrupt):
            server.serve_forever(poll_interval=0.2)
    return 0


def _rendered(result: "Result") -> "Media":
    """The video of a run, and a still of the robot where causes are marked on it."""
    from dropo.plots.motion import changed
    from dropo.report.folder import Media
    from dropo.report.robot.picture import scene_of, still
    from dropo.report.robot.video import write_video
    from dropo.report.robot.video_part import told
    from dropo.report.run_viewer import said

    simulator = _simulator(result)
    found = result.predictions
    assert found is not None
    with tempfile.TemporaryDirectory() as folder:
        shown = write_video(found, simulator, Path(folder) / "report.mp4")
        video = shown.path.read_bytes()
    again = "" if found.run is None else said(found, found.run)
    text = told(shown, again, changed(found))
    scene = scene_of(result) if result.content.get("causes") else None
    return Media(video, text, b"" if scene is None else still(scene))


def _simulator(result: "Result") -> "RobotSimulator":
    """The problem's simulator, if its model is still that of the run."""
    from dropo.core.services.errors import Incompatible
    from dropo.mjmodel.files.loading import model_sum
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
