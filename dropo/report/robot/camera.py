"""A camera that sees a whole motion, for rendered and for drawn pictures alike."""

from dataclasses import dataclass

import numpy as np

from dropo.core.services.validation import Array

FOVY = 45.0
"""Vertical field of view [degrees], MuJoCo's own."""
ROOM = 1.05
"""Size of the picture by that of what is to be seen."""
FOLLOWED = 2.5
"""A robot goes away that moves over more than so many of its sizes."""
FLAT = 0.02
"""A motion is level where its variance upward is below this fraction of that sideward."""
DOWN = -15.0
FROM_ABOVE = -55.0
"""How the camera looks down [degrees]: usually, and at level motions."""
SIDE = 90.0
"""Where the camera looks if nothing tells a direction [degrees]: along y."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A free camera, by the numbers of MuJoCo's.

    Attributes
    ----------
    lookat : (3,) array
        What is in the middle of the picture [m].
    distance : float
        From there [m].
    azimuth, elevation : float
        The direction in which it looks [degrees].
    fovy : float
        Its vertical field of view [degrees].
    """

    lookat: Array
    distance: float
    azimuth: float
    elevation: float
    fovy: float = FOVY

    def project(self, points: Array, width: float, height: float) -> tuple[Array, Array]:
        """Find where points are in the picture.

        Parameters
        ----------
        points : (n, 3) array
            In the world [m].
        width, height : float
            Of the picture.

        Returns
        -------
        places : (n, 2) array
            From the upper left corner, in the unit of the size.
        scale : (n,) array
            That unit for each metre there; larger is nearer.
        """
        right, up, forward = _axes(self.azimuth, self.elevation)
        relative = np.atleast_2d(points) - (self.lookat - self.distance * forward)
        depth = np.maximum(relative @ forward, 1e-3 * self.distance)
        scale = 0.5 * height / np.tan(np.deg2rad(self.fovy) / 2) / depth
        across = width / 2 + scale * (relative @ right)
        return np.stack([across, height / 2 - scale * (relative @ up)], axis=1), scale


def camera_of(
    places: Array, sizes: Array, aspect: float, floating: bool = False
) -> tuple[Camera, Array]:
    """Choose a camera that looks across the plane in which a robot moves most.

    Parameters
    ----------
    places : (N, g, 3) array
        Centres of the robot's parts in N poses [m].
    sizes : (g,) array
        Radii around them [m].
    aspect : float
        Width of the picture by its height.
    floating : bool
        Whether the robot is followed where it goes away.

    Returns
    -------
    camera : Camera
        Of the first pose.
    path : (N, 3) array
        What the camera looks at in each pose: one place, unless the robot is followed.
    """
    low = (places - sizes[:, None]).min(axis=1)
    high = (places + sizes[:, None]).max(axis=1)
    own = float(np.linalg.norm(high - low, axis=1).max())
    path = np.repeat((low.min(axis=0) + high.max(axis=0))[None] / 2, len(places), axis=0)
    away = np.linalg.norm(high.max(axis=0) - low.min(axis=0)) > FOLLOWED * own
    if floating and away:
        path = _smooth((low + high) / 2)
    azimuth, elevation = _direction(places)
    axes = _axes(azimuth, elevation)
    seen = (places - path[:, None]) @ axes.T
    first = (seen - sizes[:, None]).min(axis=(0, 1))
    last = (seen + sizes[:, None]).max(axis=(0, 1))
    middle, half = (first + last) / 2, (last - first) / 2
    wanted = ROOM * max(float(half[1]), float(half[0]) / aspect, 1e-3)
    distance = wanted / np.tan(np.deg2rad(FOVY) / 2) + float(half[2])
    path = path + middle @ axes
    return Camera(path[0], distance, azimuth, elevation), path


def _axes(azimuth: float, elevation: float) -> Array:
    """(3, 3) the directions to the right, up and forward of a camera [degrees], in rows."""
    turn, lift = np.deg2rad([azimuth, elevation])
    level = np.array([np.cos(turn), np.sin(turn), 0.0])
    forward = np.cos(lift) * level + [0.0, 0.0, np.sin(lift)]
    up = -np.sin(lift) * level + [0.0, 0.0, np.cos(lift)]
    return np.stack([np.cross(forward, up), up, forward])


def _direction(places: Array) -> tuple[float, float]:
    """Azimuth and elevation across what moves most; across the robot where nothing moves."""
    moved = (places - places.mean(axis=0)).reshape(-1, 3)
    if np.ptp(moved, axis=0).max() < 1e-6:
        moved = (places - places.mean(axis=1, keepdims=True)).reshape(-1, 3)
    covariance = moved.T @ moved / len(moved)
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    if values[1] < 1e-12:
        return SIDE, DOWN
    across = vectors[:, 0]
    azimuth = float(np.rad2deg(np.arctan2(across[1], across[0])))
    # Of the two sides, the one that is nearer to the usual one.
    if np.cos(np.deg2rad(azimuth - SIDE)) < 0:
        azimuth += 180.0
    level = covariance[2, 2] < FLAT * values[1]
    return azimuth, FROM_ABOVE if level else DOWN


def _smooth(path: Array) -> Array:
    """A path without its quick parts: the mean over a tenth of it."""
    width = max(1, len(path) // 10) | 1
    padded = np.pad(path, ((width // 2, width // 2), (0, 0)), mode="edge")
    kernel = np.full(width, 1 / width)
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)
