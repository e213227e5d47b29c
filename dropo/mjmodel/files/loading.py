"""Models from files, specifications or compiled ones, ready to be simulated."""

import copy
import hashlib
import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.validation import require
from dropo.mjmodel.fields import MOVES_FRAMES
from dropo.mjmodel.warnings import suppress_mujoco_warnings

NAN = "NaN"
"""What MuJoCo's warning of a number in a file says that is none."""
STEPS = (1e-9, 1e3)
"""Shortest and longest timestep [s]; others are mistakes in typing, and times overflow."""
_ATTRIBUTE = re.compile(r"(\w+)\s*=\s*[\"']([^\"']*)[\"']")


def gymnasium_spec(file: str) -> mujoco.MjSpec:
    """Read one of Gymnasium's models; Gymnasium itself is not imported.

    Parameters
    ----------
    file : str
        Name of the file among its assets, such as "hopper.xml".

    Returns
    -------
    MjSpec
        The model, not compiled yet.
    """
    package = find_spec("gymnasium")
    assert package is not None
    assert package.origin is not None
    path = Path(package.origin).parent / "envs" / "mujoco" / "assets" / file
    return mujoco.MjSpec.from_file(str(path))


NAMED = (
    *("bodies", "joints", "geoms", "sites", "actuators", "sensors", "tendons", "equalities"),
    *("cameras", "lights", "meshes", "materials", "textures", "keys"),
)
"""What an MjSpec has lists of, whose elements have names."""


def load_model(
    model: str | Path | mujoco.MjSpec | mujoco.MjModel, fields: Sequence[str] = ()
) -> mujoco.MjModel:
    """Load a model for fitting: without warm start and automatic reset, its fields editable.

    Parameters
    ----------
    model : str, Path, MjSpec or MjModel
        An MJCF file, a specification or a compiled model, which is copied.
    fields : sequence of str
        The fields that are going to be edited: some need bodies compiled with simple="false".

    Returns
    -------
    MjModel

    Raises
    ------
    BadArgument
        If a compiled model is given, and one of the fields needs bodies to be compiled anew.
    BadFile
        If there is no such file, the model does not compile, or its timestep is outside
        `STEPS`.

    Notes
    -----
    A single kinematic tree is one island of constraints or none. Not to search for islands saves
    8 % of a step of the hopper, and changes no bit.
    """
    if isinstance(model, mujoco.MjModel):
        frames = sorted(set(fields) & set(MOVES_FRAMES))
        require(
            not frames,
            "model",
            f"an MJCF file or an MjSpec where {frames} is fitted",
            "an MjModel",
            "MujocoSimulator",
        )
        compiled = copy.copy(model)
    else:
        compiled = _compile(model, fields)
    step = compiled.opt.timestep
    shortest, longest = STEPS
    if not shortest <= step <= longest:
        expected = f"{shortest:g} to {longest:g} s"
        raise BadFile(_source(model), "timestep", expected, f"{step:g}")
    compiled.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_WARMSTART | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    if compiled.ntree == 1:
        compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return compiled


def specification(model: str | Path | mujoco.MjSpec | mujoco.MjModel) -> mujoco.MjSpec:
    """Make an editable specification from where a model came.

    Parameters
    ----------
    model : str, Path, MjSpec or MjModel
        An MJCF file or a specification.

    Returns
    -------
    MjSpec
        A new one. The folders of a file's meshes and textures are absolute paths.

    Raises
    ------
    BadArgument
        If a compiled model is given, which has no MJCF.
    BadFile
        If there is no such file, MuJoCo refuses it, a number in it is NaN, or a name in it is no
        text.
    """
    if isinstance(model, mujoco.MjSpec):
        return model.copy()
    if isinstance(model, mujoco.MjModel):
        raise BadArgument(
            "A compiled MjModel has no MJCF. Make the simulator from an MJCF file or an MjSpec."
        )
    if not Path(model).is_file():
        raise BadFile(model, "", "an MJCF file", "no such file")
    with suppress_mujoco_warnings() as messages:
        try:
            spec = mujoco.MjSpec.from_file(str(model))
        except ValueError as error:
            raise _broken(model, error) from None
    if any(NAN in message for message in messages):
        raise _not_a_number(Path(model))
    _check_names(spec, Path(model))
    for name in ("meshdir", "texturedir"):
        folder = getattr(spec.compiler, name)
        if folder:
            setattr(spec.compiler, name, str((Path(model).parent / folder).resolve()))
    return spec


def model_sum(model: mujoco.MjModel) -> str:
    """Compute the SHA-256 of a compiled model, as MuJoCo writes it.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    str
        64 hexadecimal digits; equal only for models that are equal bit for bit.
    """
    buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def _compile(model: str | Path | mujoco.MjSpec, fields: Sequence[str]) -> mujoco.MjModel:
    """Compiles a file or specification so that the fields may be edited."""
    spec = model if isinstance(model, mujoco.MjSpec) else specification(model)
    try:
        if set(fields) & set(MOVES_FRAMES):
            for body in spec.bodies:
                body.simple = False
        with suppress_mujoco_warnings():
            return spec.compile()
    except (ValueError, RuntimeError) as error:
        raise _broken(model, error) from None


def _check_names(spec: mujoco.MjSpec, path: Path) -> None:
    """Refuse a file with a name that is not UTF-8, which MuJoCo reads and Python does not."""
    try:
        for kind in NAMED:
            for element in getattr(spec, kind):
                element.name  # noqa: B018 - decoded when it is read
    except UnicodeDecodeError as error:
        raise BadFile(path, "", f"names of {kind} in UTF-8", str(error)) from None


def _not_a_number(path: Path) -> BadFile:
    """The refusal of a file in which a number is NaN, with its line where it is in that file."""
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        for name, value in _ATTRIBUTE.findall(line):
            found = re.search(r"[-+]?\bnan\b", value, re.IGNORECASE)
            if found and name != "name":
                return BadFile(path, f"line {number}", "a number", found[0])
    return BadFile(path, "", "numbers alone", "NaN, perhaps in a file that it includes")


def _broken(model: str | Path | mujoco.MjSpec, error: Exception) -> BadFile:
    """The refusal of a model that MuJoCo does not compile."""
    got = str(error).strip().replace("\n", "; ")
    return BadFile(_source(model), "", "a model that compiles", got)


def _source(model: str | Path | mujoco.MjSpec | mujoco.MjModel) -> str | Path:
    """Where a model came from, for messages."""
    return model if isinstance(model, str | Path) else "the model"
