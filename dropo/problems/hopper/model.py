"""The hopper that gave the published DROPO transitions: Gymnasium's model, with what MuJoCo 2
computed differently.

Gymnasium's `hopper.xml` in today's MuJoCo is off by up to 0.5 rad/s in a single step. Two causes:
MuJoCo 2 took another volume and inertia for a capsule, and of two geoms' margins it took the larger
where MuJoCo now adds them.
Data and ground truth: G. Tiboni, DROPO (github.com/gabrieletiboni/dropo, MIT licence).
"""

import math
from importlib.resources import as_file, files

import mujoco

BODIES = ("torso", "thigh", "leg", "foot")
PARAMETERS = tuple(f"{body}_mass" for body in BODIES)
FRAME_SKIP = 4
"""Physics steps (2 ms, RK4) under one action."""

DENSITY = 1000.0  # [kg/m^3]
MARGIN = 0.0005  # [m] of each geom; two of them add up to the 0.001 that MuJoCo 2 took
RADIUS = dict(zip(BODIES, (0.05, 0.05, 0.04, 0.06), strict=True))  # [m]
LENGTH = dict(
    zip(BODIES, (0.4, 0.45, 0.5, 0.39), strict=True)
)  # [m] of the cylinder between a capsule's caps


def capsule_mass(radius: float, length: float) -> float:
    """[kg] as MuJoCo 2 counted it: the two caps together as pi r^3, not 4/3 pi r^3."""
    return DENSITY * math.pi * radius**2 * (length + radius)


def capsule_inertia(mass: float, radius: float, length: float) -> list[float]:
    """[kg m^2], the last about the capsule's own axis: a solid cylinder of the length with one
    radius added.
    """
    across = mass * (3 * radius**2 + (length + radius) ** 2) / 12
    return [across, across, mass * radius**2 / 2]


TRUTH = {f"{body}_mass": capsule_mass(RADIUS[body], LENGTH[body]) for body in BODIES}
"""[kg] the masses behind the published data: 3.534, 3.927, 2.714 and 5.089."""


def hopper_spec() -> mujoco.MjSpec:
    """Gymnasium's hopper with explicit masses and inertias, halved margins and no warm start.

    Replays the published clean transitions to rounding (1e-14). Compile it as it is: the XML that
    it can be written to keeps six digits.
    """
    with as_file(files("gymnasium") / "envs" / "mujoco" / "assets" / "hopper.xml") as path:
        spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.inertiafromgeom = (
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    )  # else the inertias below are ignored
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    for geom in spec.geoms:
        geom.margin = MARGIN
    for body in BODIES:
        _set_inertial(spec.body(body), spec.geom(f"{body}_geom"), RADIUS[body], LENGTH[body])
    return spec


def _set_inertial(body: mujoco.MjsBody, geom: mujoco.MjsGeom, radius: float, length: float) -> None:
    body.explicitinertial = True
    body.ipos = geom.pos
    body.iquat = geom.quat
    body.mass = capsule_mass(radius, length)
    body.inertia = capsule_inertia(body.mass, radius, length)


def hopper_model() -> mujoco.MjModel:
    """`hopper_spec()`, compiled: nq = nv = 6, nu = 3."""
    return hopper_spec().compile()
