"""A problem as files that `load` reads: problem.yaml, the model as MJCF, the data."""

import copy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.atomic_write import write_npz, write_text
from dropo.core.services.errors import Incompatible
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.file.effect_entries import effect_entry
from dropo.simulators.mujoco.simulator import MujocoSimulator


def write_problem(problem: Problem, folder: str | Path) -> Path:
    """Writes problem.yaml, model.xml and data.npz (held_out.npz) into a folder, and says where the
    first is.

    Effects that change the model's numbers stand in model.xml, which keeps about six digits; the
    others under `effects`.
    """
    simulator = problem.simulator
    folder = Path(folder)
    if not isinstance(simulator, MujocoSimulator):
        raise Incompatible(
            f"{type(simulator).__name__} cannot be written as a problem file, which "
            "describes a MuJoCo model."
        )
    write_text(folder / "model.xml", model_xml(simulator))
    content: dict[str, Any] = {
        "model": "model.xml",
        "frame_skip": simulator.frame_skip,
        "data": "data.npz",
        "observation": list(simulator.observation),
        "action": list(simulator.action),
        "parameters": {b.parameter.name: _parameter(b.parameter) for b in simulator.bindings},
        "lambda": problem.length,
    }
    if problem.epsilon is not None:
        content["epsilon"] = np.asarray(problem.epsilon, dtype=float).tolist()
    if problem.start_noise:
        content["start_noise"] = True
    beside = [effect_entry(instance) for instance in simulator.effects]
    beside += [
        effect_entry(instance, sizes)
        for instance, sizes in simulator.fixed
        if instance.model is None or instance.time_profile is not None
    ]
    if beside:
        content["effects"] = beside
    if problem.task is not None and problem.task.source is not None:
        content["task"] = problem.task.source
    write_data(problem.trajectories, folder / "data.npz")
    if problem.held_out is not None:
        write_data(problem.held_out, folder / "held_out.npz")
        content["held_out"] = "held_out.npz"
    write_text(folder / "problem.yaml", yaml.safe_dump(content, sort_keys=False, width=120))
    return folder / "problem.yaml"


def _parameter(p: FieldParameter) -> dict[str, Any]:
    entry: dict[str, Any] = {"field": p.field, "low": p.low, "high": p.high}
    if p.element is not None:
        entry["name"] = p.element
    if p.index is not None:
        entry["index"] = p.index
    if p.unit:
        entry["unit"] = p.unit
    return (
        entry
        | ({"target": "relative"} if p.relative else {})
        | ({} if p.derived else {"derived": "keep"})
    )


def write_data(data: Trajectories, path: Path) -> None:
    """Write trajectories as the data of a problem.

    Parameters
    ----------
    data : Trajectories
        The transitions; their groups and times are written where they have such.
    path : Path
        The .npz file.
    """
    arrays: dict[str, Any] = {
        "observations": data.observations,
        "actions": data.actions,
        "next_observations": data.next_observations,
        "terminals": data.terminals,
    }
    arrays |= {} if data.group is None else {"group": data.group}
    arrays |= {} if data.time is None else {"time": data.time}
    write_npz(path, arrays)


def model_xml(simulator: MujocoSimulator) -> str:
    """The MJCF of the simulator's model with its fixed effects written in, where they are numbers
    of the model.
    """
    spec = mujoco.MjSpec.from_string(simulator.spec().to_xml())  # angles are in radians then
    spec.compile()
    changed = copy.copy(simulator.model)
    for instance, sizes in simulator.fixed:
        if instance.model is not None and instance.time_profile is None:
            instance.model(changed, sizes)
    _write_bodies(spec, changed)
    _write_joints(spec, changed)
    _write_contacts(spec, changed)
    for actuator in spec.actuators:
        actuator.gainprm = _filled(actuator.gainprm, changed.actuator_gainprm[actuator.id])
        actuator.biasprm = _filled(actuator.biasprm, changed.actuator_biasprm[actuator.id])
    for name in ("gravity", "wind"):
        setattr(spec.option, name, getattr(changed.opt, name))
    spec.option.density = changed.opt.density
    spec.option.viscosity = changed.opt.viscosity
    spec.compile()
    return str(spec.to_xml())


def _filled(old: Any, new: Any) -> Any:
    out = np.array(old)
    out[: len(new)] = new
    return out


def _write_bodies(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
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
    for joint in spec.joints:
        dof = int(model.jnt_dofadr[joint.id])
        joint.armature = model.dof_armature[dof]
        joint.frictionloss = model.dof_frictionloss[dof]
        joint.damping = _filled(joint.damping, [model.dof_damping[dof]])
        joint.stiffness = _filled(joint.stiffness, [model.jnt_stiffness[joint.id]])
        if model.jnt_limited[joint.id]:
            joint.range = model.jnt_range[joint.id]


def _write_contacts(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    for geom in spec.geoms:
        geom.friction = model.geom_friction[geom.id]
        geom.solref = model.geom_solref[geom.id]
        geom.margin = model.geom_margin[geom.id]
