"""The MJCF of a simulator's model, with those of its effects that MJCF has elements for."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.problems.file.model_assets import with_absolute_assets
from dropo.simulators.mujoco.simulator import MujocoSimulator

SLACK = 1e-5
"""Fraction of an inertia that is lost where it is written with six digits."""


def format_model(
    simulator: MujocoSimulator, values: Array | None = None, active: ActiveEffects | None = None
) -> str:
    """Write the model of a simulator as MJCF.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model.
    values : (d,) array, optional
        Its declared parameters, which are written in; by default the model's own numbers.
    active : sequence of (EffectInstance, (q,) array), optional
        Effects, which are written in where they are numbers of the model; by default the
        simulator's fixed ones.

    Returns
    -------
    str
        The MJCF, in which numbers have about six digits, and paths of files are absolute.

    Raises
    ------
    Incompatible
        If MuJoCo refuses the model with these numbers.
    """
    # Read anew, angles are in radians.
    source = simulator.spec()
    text = with_absolute_assets(source.to_xml(), Path(source.modelfiledir).absolute())
    spec = mujoco.MjSpec.from_string(text)
    spec.compile()
    every = simulator.fixed if active is None else active
    in_model = [pair for pair in every if is_in_model(pair[0])]
    model = simulator.model_of(simulator.nominal if values is None else values, in_model)
    _write_bodies(spec, model)
    _write_joints(spec, model)
    _write_contacts(spec, model)
    _write_actuators(spec, model)
    _write_tendons(spec, model)
    _write_option(spec, model)
    try:
        spec.compile()
    except ValueError as error:
        raise Incompatible(f"MuJoCo refuses the model with what was found: {error}") from None
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
