"""A video of the measured motion with the simulated one over it, translucent.

The model before is on the left, the model after on the right.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropo.core.records.predictions import Predictions, Side
from dropo.core.services.atomic_write import atomic_write
from dropo.core.services.errors import DropoError
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array

if TYPE_CHECKING:
    from dropo.mjmodel.robot_simulator import RobotSimulator

# Size of each half [pixels].
WIDTH = 480
HEIGHT = 480
# Frames in a second, and frames for each control step.
FRAMES = 30
EACH = 3
# Colours of the models before and after, as in the page's figures.
GHOSTS = ((0.95, 0.42, 0.0, 0.6), (0.1, 0.55, 0.95, 0.6))
MEASURED = (0.75, 0.75, 0.72, 1.0)


def write_video(found: Predictions, simulator: "RobotSimulator", path: Path) -> Path:
    """Write all windows, slowed down, as a video in H.264.

    Without a display it needs the environment variable MUJOCO_GL=egl before MuJoCo is imported.
    Components of the state that the data do not hold, such as a hopper's position along the floor,
    stay where the model begins.

    Parameters
    ----------
    found : Predictions
        Measured and simulated motion.
    simulator : RobotSimulator
        One of the run's model.
    path : Path
        The file to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingPackage
        If imageio-ffmpeg is not installed (extra `video`).
    DropoError
        If MuJoCo cannot draw on this machine.
    """
    need("imageio_ffmpeg", extra="video", caller="A video")
    import imageio_ffmpeg

    measured = _states(found, simulator, None)
    halves = [_states(found, simulator, side) for side in (found.before, found.after)]
    stage = _Stage(simulator.model)
    with atomic_write(path) as part:
        writer = imageio_ffmpeg.write_frames(
            str(part), (2 * WIDTH, HEIGHT), fps=FRAMES, macro_block_size=16, quality=7
        )
        writer.send(None)
        try:
            for k, qpos in enumerate(measured):
                images = []
                for half, ghost in zip(halves, GHOSTS, strict=True):
                    images.append(stage.frame(qpos, half[k], ghost))
                frame = np.concatenate(images, axis=1)
                for _ in range(EACH):
                    writer.send(np.ascontiguousarray(frame))
        finally:
            writer.close()
            stage.close()
    return path


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
    need("imageio_ffmpeg", extra="video", caller="A video")
    import imageio_ffmpeg

    stage = _Stage(model)
    with atomic_write(path) as part:
        writer = imageio_ffmpeg.write_frames(
            str(part), (WIDTH, HEIGHT), fps=FRAMES, macro_block_size=16, quality=7
        )
        writer.send(None)
        try:
            for time in np.arange(0, len(qpos) * step, 1 / FRAMES):
                nearest = min(round(time / step), len(qpos) - 1)
                writer.send(np.ascontiguousarray(stage.frame(qpos[nearest])))
        finally:
            writer.close()
            stage.close()
    return path


def _states(found: Predictions, simulator: "RobotSimulator", side: Side | None) -> Array:
    """Joint positions (W L, nq) as measured, or as a side predicted them."""
    rows = found.rows.reshape(-1, found.rows.shape[2])
    layout = simulator.layout
    if side is not None:
        rows = layout.move(rows, (side.line - found.measured).reshape(len(rows), -1))
    states = layout.full_states(np.nan_to_num(rows), simulator.model)
    return states[:, 1 : 1 + simulator.model.nq]


class _Stage:
    """A renderer without shadows and reflections, which cost much and say nothing here."""

    def __init__(self, model: Any):
        import mujoco

        self.mujoco = mujoco
        self.model = _plain(model)
        try:
            self.renderer = mujoco.Renderer(self.model, HEIGHT, WIDTH)
        except Exception as error:  # whatever the graphics library says
            advice = (
                "Set MUJOCO_GL to egl, osmesa or glfw before Python starts, or leave out --video."
            )
            raise DropoError(f"MuJoCo cannot draw here: {error}. {advice}") from None
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.renderer.scene.flags[flag] = 0
        self.solid = mujoco.MjData(self.model)
        self.ghost = mujoco.MjData(self.model)
        self.camera = mujoco.MjvCamera()
        self.option = mujoco.MjvOption()
        mujoco.mjv_defaultFreeCamera(self.model, self.camera)
        if self.model.ncam:
            self.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.camera.fixedcamid = 0

    def frame(
        self, qpos: Array, ghost: Array | None = None, color: tuple[float, ...] = MEASURED
    ) -> Any:
        """The image (HEIGHT, WIDTH, 3) of the measured robot, and of the simulated one over it."""
        scene = self.renderer.scene
        for data, place in ((self.solid, qpos), (self.ghost, qpos if ghost is None else ghost)):
            data.qpos[:] = place
            self.mujoco.mj_forward(self.model, data)
        self.renderer.update_scene(self.solid, self.camera, self.option)
        first = scene.ngeom
        dynamic = self.mujoco.mjtCatBit.mjCAT_DYNAMIC
        if ghost is not None:
            self.mujoco.mjv_addGeoms(
                self.model, self.ghost, self.option, self.mujoco.MjvPerturb(), dynamic, scene
            )
        for i, geom in enumerate(scene.geoms[: scene.ngeom]):
            if geom.category == dynamic:
                geom.matid = -1
                geom.rgba[:] = color if i >= first else MEASURED
        return self.renderer.render()

    def close(self) -> None:
        """Free the renderer."""
        self.renderer.close()


def _plain(model: Any) -> Any:
    """A copy that is drawn at once: no multisampling, a picture as large as needed."""
    import copy

    out = copy.copy(model)
    out.vis.quality.offsamples = 0
    out.vis.global_.offwidth = max(WIDTH, out.vis.global_.offwidth)
    out.vis.global_.offheight = max(HEIGHT, out.vis.global_.offheight)
    return out
