"""A video of the measured motion with what was simulated as a ghost over it: before on the left,
after on the right.
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

# [pixels] of each half
WIDTH = 480
HEIGHT = 480
# a second; and for each control step
FRAMES = 30
EACH = 3
GHOSTS = ((0.95, 0.42, 0.0, 0.6), (0.1, 0.55, 0.95, 0.6))  # before, after; as in the page's figures
MEASURED = (0.75, 0.75, 0.72, 1.0)


def write_video(found: Predictions, simulator: "RobotSimulator", path: Path) -> Path:
    """Every window, slowed down, as H.264; simulator: one of the run's model.

    Needs the extra `video`, and without a display the environment variable MUJOCO_GL=egl before
    MuJoCo is imported.

    What the data do not hold of the state, such as a hopper's place along the floor, stays where
    the model begins.
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
                frame = np.concatenate(
                    [
                        stage.frame(qpos, half[k], ghost)
                        for half, ghost in zip(halves, GHOSTS, strict=True)
                    ],
                    axis=1,
                )
                for _ in range(EACH):
                    writer.send(np.ascontiguousarray(frame))
        finally:
            writer.close()
            stage.close()
    return path


def write_motion(qpos: Array, model: Any, step: float, path: Path) -> Path:
    """Joint positions (T, nq) of a model, `step` seconds apart, as H.264 in their own time; needs
    what `write_video` needs.
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
                writer.send(
                    np.ascontiguousarray(stage.frame(qpos[min(round(time / step), len(qpos) - 1)]))
                )
        finally:
            writer.close()
            stage.close()
    return path


def _states(found: Predictions, simulator: "RobotSimulator", side: Side | None) -> Array:
    """(W L, nq) joint positions as measured, or as a side predicted them."""
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
            told = (
                "Set MUJOCO_GL to egl, osmesa or glfw before Python starts, or leave out --video."
            )
            raise DropoError(f"MuJoCo cannot draw here: {error}. {told}") from None
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.renderer.scene.flags[flag] = 0
        self.solid, self.ghost = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.camera = mujoco.MjvCamera()
        self.option = mujoco.MjvOption()
        mujoco.mjv_defaultFreeCamera(self.model, self.camera)
        if self.model.ncam:
            self.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.camera.fixedcamid = 0

    def frame(
        self, qpos: Array, ghost: Array | None = None, color: tuple[float, ...] = MEASURED
    ) -> Any:
        """(HEIGHT, WIDTH, 3) the measured robot, and the simulated one translucent in a colour,
        where there is one.
        """
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
        """Frees the renderer."""
        self.renderer.close()


def _plain(model: Any) -> Any:
    """A copy that is drawn at once: no multisampling, a picture as large as needed."""
    import copy

    out = copy.copy(model)
    out.vis.quality.offsamples = 0
    out.vis.global_.offwidth, out.vis.global_.offheight = (
        max(WIDTH, out.vis.global_.offwidth),
        max(HEIGHT, out.vis.global_.offheight),
    )
    return out
