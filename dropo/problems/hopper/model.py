"""The hopper behind the published DROPO transitions: Gymnasium's model as MuJoCo 2 computed it.

Gymnasium's `hopper.xml` in today's MuJoCo is off by up to 0.5 rad/s in a single step. Two causes:
MuJoCo 2 took another volume and inertia for a capsule, and of two geoms' margins it took the larger
where MuJoCo now adds them.
Data and ground truth: G. Tiboni, DROPO (github.com/gabrieletiboni/dropo, MIT licence).
"""

import math

import mujoco

from dropo.mjmodel.files.loading import gymnasium_spec

BODIES = ("torso", "thigh", "leg", "foot")
FRAME_SKIP = 4
"""Physics steps (2 ms, RK4) under one action."""

DENSITY = 1000.0  # [kg/m^3]
MARGIN = 0.0005  # [m] of each geom; two of them add up to the 0.001 that MuJoCo 2 took
RADIUS = {"torso": 0.05, "thigh": 0.05, "leg": 0.04, "foot": 0.06}
"""Radius [m] of each body's capsule."""
LENGTH = {"torso": 0.4, "thigh": 0.45, "leg": 0.5, "foot": 0.39}
"""Length [m] of the cylinder between the caps of each body's capsule."""


def capsule_mass(radius: float, length: float) -> float:
    """Mass of a capsule as MuJoCo 2 computed it.

    Parameters
    ----------
    radius : float
        Radius of the caps and of the cylinder [m].
    length : float
        Length of the cylinder between the caps [m].

    Returns
    -------
    float
        Mass at the density of water [kg]. The two caps count as pi r^3 together, not 4/3 pi r^3.
    """
    return DENSITY * math.pi * radius**2 * (length + radius)


def capsule_inertia(mass: float, radius: float, length: float) -> list[float]:
    """Principal inertias of a capsule as MuJoCo 2 computed them.

    Parameters
    ----------
    mass : float
        Mass of the capsule [kg].
    radius : float
        Radius of the caps and of the cylinder [m].
    length : float
        Length of the cylinder between the caps [m].

    Returns
    -------
    list of 3 floats
        Inertias of a solid cylinder of that radius whose length is longer by one radius [kg m^2];
        the last is about the capsule's own axis.
    """
    across = mass * (3 * radius**2 + (length + radius) ** 2) / 12
    return [across, across, mass * radius**2 / 2]


TRUTH = {f"{body}_mass": capsule_mass(RADIUS[body], LENGTH[body]) for body in BODIES}
"""Masses [kg] behind the published data: 3.534, 3.927, 2.714 and 5.089."""


def hopper_spec() -> mujoco.MjSpec:
    """Gymnasium's hopper with explicit masses and inertias, halved margins and no warm start.

    Returns
    -------
    mujoco.MjSpec
        The model that replays the published clean transitions to rounding (1e-14). Compile it as it
        is: the XML that it can be written to keeps six digits.
    """
    spec = gymnasium_spec("hopper.xml")
    # With any other setting MuJoCo ignores the explicit inertias below.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    for geom in spec.geoms:
        geom.margin = MARGIN
    for body in BODIES:
        _set_inertial(spec.body(body), spec.geom(f"{body}_geom"), RADIUS[body], LENGTH[body])
    return spec


def _set_inertial(body: mujoco.MjsBody, geom: mujoco.MjsGeom, radius: float, length: float) -> None:
    """Gives a body the mass and inertia that MuJoCo 2 computed for its capsule."""
    body.explicitinertial = True
    body.ipos = geom.pos
    body.iquat = geom.quat
    body.mass = capsule_mass(radius, length)
    body.inertia = capsule_inertia(body.mass, radius, length)


def hopper_model() -> mujoco.MjModel:
    """Compile the model of `hopper_spec`.

    Returns
    -------
    MjModel
        nq = nv = 6, nu = 3.
    """
    return hopper_spec().compile()
