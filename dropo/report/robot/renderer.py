"""Images of a robot by MuJoCo's renderer, off screen."""

import copy
from typing import Any

import numpy as np

from dropo.core.services.errors import DropoError
from dropo.core.services.validation import Array
from dropo.mjmodel.appearance import move, posed, skeleton
from dropo.report.robot.camera import Camera

# Colours of the models before and after, as in the page's figures, and of what was measured.
GHOSTS = ((0.95, 0.42, 0.0, 0.6), (0.1, 0.55, 0.95, 0.6))
MEASURED = (0.75, 0.75, 0.72, 1.0)
INSIDE = 0.97
"""Thickness of a ghost's lines by that of the robot's: where both agree, the robot is seen."""
LIGHT = 0.5
"""Of the lamp on the camera: half from everywhere, half from there."""
EMPTY = (240, 240, 236)
"""What is behind a robot whose model has no sky [8 bits a colour]."""


class RobotRenderer:
    """A renderer without shadows and reflections, which cost much and say nothing here.

    Parameters
    ----------
    model : mujoco.MjModel
        The model.
    width, height : int
        Of an image [pixels].

    Raises
    ------
    DropoError
        If MuJoCo cannot draw on this machine.
    """

    def __init__(self, model: Any, width: int, height: int):
        import mujoco

        self.mujoco = mujoco
        self.model = _plain(model, width, height)
        try:
            self.renderer = mujoco.Renderer(self.model, height, width)
        except Exception as error:  # whatever the graphics library says
            advice = (
                "Set MUJOCO_GL to egl, osmesa or glfw before Python starts, or leave out --video."
            )
            raise DropoError(f"MuJoCo cannot draw here: {error}. {advice}") from None
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.renderer.scene.flags[flag] = 0
        self.solid = posed(self.model)
        self.ghost = posed(self.model)
        self.camera = mujoco.MjvCamera()
        self.option = mujoco.MjvOption()
        mujoco.mjv_defaultFreeCamera(self.model, self.camera)

    def aim(self, camera: Camera, lookat: Array) -> None:
        """Turn the camera as another one is, to a place.

        Parameters
        ----------
        camera : Camera
            What distance, angles and field of view are taken from.
        lookat : (3,) array
            What is in the middle of the image [m].
        """
        self.model.vis.global_.fovy = camera.fovy
        self.camera.type = self.mujoco.mjtCamera.mjCAMERA_FREE
        self.camera.lookat[:] = lookat
        self.camera.distance = camera.distance
        self.camera.azimuth = camera.azimuth
        self.camera.elevation = camera.elevation

    def frame(
        self,
        qpos: Array,
        ghost: Array | None = None,
        color: tuple[float, ...] = MEASURED,
        *,
        plain: bool = True,
    ) -> Array:
        """Draw the robot, and another pose of it as a ghost over it.

        Parameters
        ----------
        qpos : (nq,) array
            Joint positions.
        ghost : (nq,) array, optional
            Of the ghost.
        color : tuple of four float
            Of the ghost.
        plain : bool
            Whether the robot is grey in place of its own colours.

        Returns
        -------
        (height, width, 3) array of uint8
        """
        scene = self.renderer.scene
        for data, place in ((self.solid, qpos), (self.ghost, qpos if ghost is None else ghost)):
            move(self.model, data, place)
        self.renderer.update_scene(self.solid, self.camera, self.option)
        first = scene.ngeom
        dynamic = self.mujoco.mjtCatBit.mjCAT_DYNAMIC
        self._add_skeleton(self.solid, MEASURED, 1.0)
        if ghost is not None:
            self.mujoco.mjv_addGeoms(
                self.model, self.ghost, self.option, self.mujoco.MjvPerturb(), dynamic, scene
            )
            self._add_skeleton(self.ghost, color, INSIDE)
        for i, geom in enumerate(scene.geoms[: scene.ngeom]):
            if geom.category == dynamic and (plain or i >= first):
                geom.matid = -1
                geom.rgba[:] = color if i >= first else MEASURED
        image = self.renderer.render()
        image[(image == 0).all(axis=2)] = EMPTY
        return np.asarray(image)

    def _add_skeleton(self, data: Any, color: tuple[float, ...], share: float) -> None:
        """Draw lines where a model has no geoms to be seen."""
        scene = self.renderer.scene
        kind = self.mujoco.mjtGeom.mjGEOM_CAPSULE
        for line in skeleton(self.model, data):
            if scene.ngeom >= scene.maxgeom:
                return
            geom = scene.geoms[scene.ngeom]
            shade = np.array(color, dtype=np.float32)
            self.mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), shade)
            self.mujoco.mjv_connector(geom, kind, share * line.radius, *line.points)
            scene.ngeom += 1

    def close(self) -> None:
        """Free the renderer."""
        self.renderer.close()


def _plain(model: Any, width: int, height: int) -> Any:
    """A copy that is drawn at once: no multisampling, a picture as large as needed."""
    out = copy.copy(model)
    out.vis.quality.offsamples = 0
    out.vis.headlight.ambient[:] = LIGHT
    out.vis.headlight.diffuse[:] = LIGHT
    out.vis.global_.offwidth = max(width, out.vis.global_.offwidth)
    out.vis.global_.offheight = max(height, out.vis.global_.offheight)
    return out
