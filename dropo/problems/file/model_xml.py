"""The MJCF of a simulator's model, with those of its effects that MJCF has elements for."""

import copy

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.effect import EffectInstance
from dropo.simulators.mujoco.simulator import MujocoSimulator


def format_model(simulator: MujocoSimulator) -> str:
    """Write the model of a simulator as MJCF.

    Parameters
    ----------
    simulator : MujocoSimulator
        Its fixed effects are written in, where they are numbers of the model.

    Returns
    -------
    str
        The MJCF, in which numbers have about six digits.
    """
    spec = mujoco.MjSpec.from_string(simulator.spec().to_xml())  # angles are in radians then
    spec.compile()
    model = _apply_effects(simulator)
    _write_bodies(spec, model)
    _write_joints(spec, model)
    _write_contacts(spec, model)
    _write_actuators(spec, model)
    _write_option(spec, model)
    spec.compile()
    return str(spec.to_xml())


def is_in_model(instance: EffectInstance) -> bool:
    """Tell whether an effect is a number of the model that MJCF can hold.

    Parameters
    ----------
    instance : EffectInstance
        The effect at its place.

    Returns
    -------
    bool
        False for effects on commands or sensors, and for those that come with time.
    """
    return instance.model is not None and instance.time_profile is None


def _apply_effects(simulator: MujocoSimulator) -> mujoco.MjModel:
    """A copy of the model with the fixed effects that are numbers of it."""
    model = copy.copy(simulator.model)
    for instance, sizes in simulator.fixed:
        if instance.model is not None and is_in_model(instance):
            instance.model(model, sizes)
    return model


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
            body.inertia = model.body_inertia[body.id]
            body.ipos = model.body_ipos[body.id]
            body.iquat = model.body_iquat[body.id]
            body.fullinertia = [np.nan] * 6


def _write_joints(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Armature, friction, damping, stiffness and ranges."""
    for joint in spec.joints:
        dof = int(model.jnt_dofadr[joint.id])
        joint.armature = model.dof_armature[dof]
        joint.frictionloss = model.dof_frictionloss[dof]
        joint.damping = _fill(joint.damping, [model.dof_damping[dof]])
        joint.stiffness = _fill(joint.stiffness, [model.jnt_stiffness[joint.id]])
        if model.jnt_limited[joint.id]:
            joint.range = model.jnt_range[joint.id]


def _write_contacts(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Friction, contact time constants and margins."""
    for geom in spec.geoms:
        geom.friction = model.geom_friction[geom.id]
        geom.solref = model.geom_solref[geom.id]
        geom.margin = model.geom_margin[geom.id]


def _write_actuators(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Gains and biases."""
    for actuator in spec.actuators:
        actuator.gainprm = _fill(actuator.gainprm, model.actuator_gainprm[actuator.id])
        actuator.biasprm = _fill(actuator.biasprm, model.actuator_biasprm[actuator.id])


def _write_option(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Gravity and the medium."""
    spec.option.gravity = model.opt.gravity
    spec.option.wind = model.opt.wind
    spec.option.density = model.opt.density
    spec.option.viscosity = model.opt.viscosity
