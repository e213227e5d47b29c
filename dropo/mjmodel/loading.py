"""Models from files, specifications or compiled ones, ready to be simulated."""

import copy
from collections.abc import Sequence
from pathlib import Path

import mujoco

from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.validation import require
from dropo.mjmodel.fields import MOVES_FRAMES


def load_model(
    model: str | Path | mujoco.MjSpec | mujoco.MjModel, fields: Sequence[str] = ()
) -> mujoco.MjModel:
    """A model ready for fitting: warm start and automatic reset off, bodies compiled so that the
    fields may be edited.

    A single kinematic tree is one island of constraints or none: not to look for islands saves 8 %
    of a hopper's step and changes no bit.
    """
    if isinstance(model, mujoco.MjModel):
        moved = sorted(set(fields) & set(MOVES_FRAMES))
        require(
            not moved,
            "model",
            f"an MJCF file or an MjSpec where {moved} is fitted",
            "an MjModel",
            "MujocoSimulator",
        )
        compiled = copy.copy(model)
    else:
        compiled = _compile(model, fields)
    compiled.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_WARMSTART | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    if compiled.ntree == 1:
        compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return compiled


def specification(model: str | Path | mujoco.MjSpec | mujoco.MjModel) -> mujoco.MjSpec:
    """An MjSpec of its own from where a model came; the paths of its files are absolute."""
    if isinstance(model, mujoco.MjSpec):
        return model.copy()
    if isinstance(model, mujoco.MjModel):
        raise BadArgument(
            "A compiled MjModel has no MJCF. Make the simulator from an MJCF file or an MjSpec."
        )
    if not Path(model).is_file():
        raise BadFile(model, "", "an MJCF file", "no such file")
    try:
        spec = mujoco.MjSpec.from_file(str(model))
    except ValueError as error:
        raise _broken(model, error) from None
    for name in ("meshdir", "texturedir"):
        if getattr(spec.compiler, name):
            setattr(
                spec.compiler,
                name,
                str((Path(model).parent / getattr(spec.compiler, name)).resolve()),
            )
    return spec


def _compile(model: str | Path | mujoco.MjSpec, fields: Sequence[str]) -> mujoco.MjModel:
    spec = model if isinstance(model, mujoco.MjSpec) else specification(model)
    try:
        if set(fields) & set(MOVES_FRAMES):
            for body in spec.bodies:
                body.simple = False
        return spec.compile()
    except (ValueError, RuntimeError) as error:
        raise _broken(model, error) from None


def _broken(model: str | Path | mujoco.MjSpec, error: Exception) -> BadFile:
    source = "the model" if isinstance(model, mujoco.MjSpec) else model
    return BadFile(source, "", "a model that compiles", str(error).strip().replace("\n", "; "))
