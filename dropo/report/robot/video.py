"""A video of the measured motion with the simulated one over it, translucent.

The model before is above, the model after below, so that both are as wide as a phone.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropo.core.records.predictions import Predictions
from dropo.core.services.files.atomic_write import atomic_write
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array
from dropo.report.robot.camera import camera_of
from dropo.report.robot.poses import MOST, poses_of
from dropo.report.robot.renderer import GHOSTS, RobotRenderer

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator

# Size of each half [pixels].
WIDTH = 480
HEIGHT = 320
FRAMES = 30
"""Frames in a second of a motion ..."""
PAGE_FRAMES = 20
"""... and of a page's video, which is smaller for it."""
SHORTEST = 6.0
"""A motion that is shorter is slowed down to last about so long [s]."""
SLOWED = (1, 2, 4, 10, 20, 50, 100)
"""How many times."""
LARGEST = 1_500_000
"""Size of a file [bytes], about, at most: what a page carries."""


@dataclass(frozen=True)
class Shown:
    """What a video shows, for its caption.

    Attributes
    ----------
    path : Path
        The file.
    factor : int
        By how much errors are enlarged.
    slowed : int
        By how much time is slowed down; 0 where the length of a control step is not known.
    seconds : float
        How much of the run is shown [s]; NaN where unknown.
    """

    path: Path
    factor: int
    slowed: int
    seconds: float


def write_video(
    found: Predictions, simulator: "RobotSimulator", path: Path, most: int = MOST
) -> Shown:
    """Write the motion of a run as a video in H.264 that every browser plays.

    Without a display it needs the environment variable MUJOCO_GL=egl before MuJoCo is imported.

    Parameters
    ----------
    found : Predictions
        Measured and simulated motion.
    simulator : RobotSimulator
        One of the run's model.
    path : Path
        The file to write.
    most : int
        Poses in it at most.

    Returns
    -------
    Shown

    Raises
    ------
    MissingPackage
        If imageio-ffmpeg is not installed (extra `video`).
    DropoError
        If MuJoCo cannot draw on this machine.
    """
    poses = poses_of(found, simulator, most)
    known = np.isfinite(found.seconds)
    whole = float(poses.times[-1]) if known else np.nan
    slowed = next((n for n in SLOWED if n * whole >= SHORTEST), SLOWED[-1]) if known else 0
    length = slowed * whole if known else len(poses.times) / PAGE_FRAMES * 3
    camera, lookat = camera_of(poses.places, poses.sizes, WIDTH / HEIGHT, poses.floating)
    count = max(2, round(length * PAGE_FRAMES))
    shown = np.linspace(0, len(poses.times) - 1, count).round().astype(int)
    renderer = RobotRenderer(simulator.model, WIDTH, HEIGHT)
    halves = ((poses.before, GHOSTS[0]), (poses.after, GHOSTS[1]))
    at = -1
    frame = np.zeros(0)
    try:
        with (
            atomic_write(path) as part,
            _Writer(part, (WIDTH, 2 * HEIGHT), PAGE_FRAMES, length) as writer,
        ):
            for k in shown:
                if k != at:
                    at = k
                    renderer.aim(camera, lookat[k])
                    images = [
                        renderer.frame(poses.measured[k], own[k], ghost) for own, ghost in halves
                    ]
                    frame = np.concatenate(images)
                writer.send(frame)
    finally:
        renderer.close()
    return Shown(path, poses.factor, slowed, whole)


def write_motion(qpos: Array, model: Any, step: float, path: Path) -> Path:
    """Write a motion as a video in H.264, in its own time.

    It needs what `write_video` needs.

    Parameters
    ----------
    qpos : (T, nq) array
        Joint positions.
    model : mujoco.MjModel
        The model.
    step : float
        Time between two positions [s].
    path : Path
        The file to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingPackage, DropoError
        As of `write_video`.
    """
    renderer = RobotRenderer(model, WIDTH, WIDTH)
    if model.ncam:
        renderer.camera.type = renderer.mujoco.mjtCamera.mjCAMERA_FIXED
        renderer.camera.fixedcamid = 0
    length = len(qpos) * step
    try:
        with atomic_write(path) as part, _Writer(part, (WIDTH, WIDTH), FRAMES) as writer:
            for time in np.arange(0, length, 1 / FRAMES):
                nearest = min(round(time / step), len(qpos) - 1)
                writer.send(renderer.frame(qpos[nearest]))
    finally:
        renderer.close()
    return path


class _Writer:
    """A file of H.264; bounded in size where its length [s] is given."""

    def __init__(self, path: Path, size: tuple[int, int], frames: int, length: float = 0.0):
        need("imageio_ffmpeg", extra="video", caller="A video")
        import imageio_ffmpeg

        bounded = []
        if length > 0:
            rate = int(0.8 * 8 * LARGEST / length)
            bounded = ["-maxrate", str(rate), "-bufsize", str(rate)]
        quick = ["-crf", "27", "-preset", "veryfast", "-movflags", "+faststart"]
        self.frames = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=frames,
            macro_block_size=16,
            quality=None,
            output_params=[*quick, *bounded],
        )

    def __enter__(self) -> "_Writer":
        self.frames.send(None)
        return self

    def __exit__(self, *error: object) -> None:
        self.frames.close()

    def send(self, frame: Array) -> None:
        """Append a frame (height, width, 3)."""
        self.frames.send(np.ascontiguousarray(frame))
