"""The numbers of a compiled model, written into a specification of the same elements."""

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.services.validation import Array

SLACK = 1e-5
"""Fraction of an inertia that is lost where it is written with six digits."""


def write_model(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write what parameters and effects may change.

    Parameters
    ----------
    spec : MjSpec
        Compiled, with the elements of the model; is changed in place.
    model : MjModel
        Whose numbers are written.
    """
    _write_bodies(spec, model)
    _write_joints(spec, model)
    _write_contacts(spec, model)
    _write_actuators(spec, model)
    _write_tendons(spec, model)
    _write_option(spec, model)


def _fill(old: ArrayLike, new: ArrayLike) -> NDArray[np.float64]:
    """The old numbers with the new ones in the first places."""
    filled = np.array(old)
    values = np.asarray(new)
    filled[: len(values)] = values
    return filled


def _write_bodies(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Masses, inertias and their frames."""
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies:
        if body.id > 0 and model.body_mass[body.id] > 0:
            body.explicitinertial = True
            body.mass = model.body_mass[body.id]
            body.inertia = _possible(model.body_inertia[body.id])
            body.ipos = model.body_ipos[body.id]
            body.iquat = model.body_iquat[body.id]
            body.fullinertia = [np.nan] * 6


def _possible(inertia: Array) -> Array:
    """Principal moments (3,) of which none is larger than the sum of the others, as MuJoCo demands.

    Where one was fitted alone, about the axis of a joint, the others are raised.
    """
    largest = int(np.argmax(inertia))
    missing = (1 + SLACK) * inertia[largest] - np.delete(inertia, largest).sum()
    others = np.arange(3) != largest
    return np.where(others, inertia + max(missing, 0.0) / 2, inertia)


def _write_joints(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Armature, friction, damping, springs and ranges."""
    for joint in spec.joints:
        dof = int(model.jnt_dofadr[joint.id])
        joint.armature = model.dof_armature[dof]
        joint.frictionloss = model.dof_frictionloss[dof]
        joint.solimp_friction = model.dof_solimp[dof]
        joint.solref_friction = model.dof_solref[dof]
        joint.damping = _fill(joint.damping, [model.dof_damping[dof]])
        joint.stiffness = _fill(joint.stiffness, [model.jnt_stiffness[joint.id]])
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            joint.springref = model.qpos_spring[model.jnt_qposadr[joint.id]]
        if model.jnt_limited[joint.id]:
            joint.range = model.jnt_range[joint.id]


def _write_contacts(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Friction, contact time constants and margins."""
    for geom in spec.geoms:
        geom.friction = model.geom_friction[geom.id]
        geom.solref = model.geom_solref[geom.id]
        geom.solimp = model.geom_solimp[geom.id]
        geom.margin = model.geom_margin[geom.id]


def _write_actuators(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Gains and biases."""
    for actuator in spec.actuators:
        actuator.gainprm = _fill(actuator.gainprm, model.actuator_gainprm[actuator.id])
        actuator.biasprm = _fill(actuator.biasprm, model.actuator_biasprm[actuator.id])


def _write_tendons(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Armature, friction, damping and stiffness."""
    for tendon in spec.tendons:
        tendon.armature = model.tendon_armature[tendon.id]
        tendon.frictionloss = model.tendon_frictionloss[tendon.id]
        tendon.solimp_friction = model.tendon_solimp_fri[tendon.id]
        tendon.solref_friction = model.tendon_solref_fri[tendon.id]
        tendon.damping = _fill(tendon.damping, [model.tendon_damping[tendon.id]])
        tendon.stiffness = _fill(tendon.stiffness, [model.tendon_stiffness[tendon.id]])


def _write_option(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """The physics step, gravity and the medium."""
    spec.option.timestep = model.opt.timestep
    spec.option.integrator = model.opt.integrator
    spec.option.gravity = model.opt.gravity
    spec.option.wind = model.opt.wind
    spec.option.density = model.opt.density
    spec.option.viscosity = model.opt.viscosity
