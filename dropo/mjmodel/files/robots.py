"""Robots by a file or by the name of a description, and the drives that a URDF does not have."""

import importlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dropo.core.services.errors import BadFile, MissingPackage, UnknownName
from dropo.core.services.validation import nearest
from dropo.mjmodel.files.loading import specification

DESCRIPTIONS = "robot_descriptions"
"""The package that names descriptions of robots."""
_ROOT = re.compile(r"<\s*(robot|mujoco)\b")
_VERSIONS = ("{}", "{}_mj_description", "{}_description")
"""What a description may be called after, the one that MuJoCo's own form has first."""
LONGEST_STEP = 0.002
"""Physics steps of a model that is written are at most so long [s]."""


@dataclass(frozen=True)
class RobotFile:
    """Where a robot's model is.

    Attributes
    ----------
    name : str
        The robot's name.
    path : Path
        Its file.
    is_urdf : bool
        Whether that is URDF, which has no actuators.
    """

    name: str
    path: Path
    is_urdf: bool


@dataclass(frozen=True)
class DriveGuess:
    """What drives a joint that has no actuator in its model.

    Attributes
    ----------
    kind : str
        "position", "velocity" or "torque": what is commanded.
    stiffness, damping : float
        Gains of a position or velocity servo [N m/rad, N m s/rad, or N/m, N s/m].
    """

    kind: str
    stiffness: float = 0.0
    damping: float = 0.0

    def describe(self) -> str:
        """Say what it is.

        Returns
        -------
        str
            With its gains.
        """
        if self.kind == "position":
            return f"position servo with kp {self.stiffness:g}, kv {self.damping:g}"
        if self.kind == "velocity":
            return f"velocity servo with kv {self.damping:g}"
        return "motor"


def find_robot(robot: str | Path) -> RobotFile:
    """Find the model of a robot.

    Parameters
    ----------
    robot : str or Path
        An MJCF or URDF file, or the name of a description in the package robot_descriptions.

    Returns
    -------
    RobotFile

    Raises
    ------
    BadFile
        If the file is neither, or there is none.
    UnknownName
        If no description is called so; the message gives the nearest.
    MissingPackage
        If it is no file, and the package is not installed.
    """
    place = Path(robot)
    if place.is_file():
        return RobotFile(*_read_root(place))
    text = str(robot)
    if place.suffix in (".xml", ".urdf", ".mjcf") or os.sep in text or place.is_dir():
        got = "a folder" if place.is_dir() else "no such file"
        raise BadFile(robot, "", "an MJCF or URDF file", got)
    return _described(text)


def _read_root(place: Path) -> tuple[str, Path, bool]:
    """Name, path and form of a model's file."""
    text = place.read_bytes().decode("utf-8", errors="replace")
    root = _ROOT.search(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
    if root is None:
        raise BadFile(place, "", "an MJCF or URDF file, with <mujoco> or <robot>", "neither")
    kind = "model" if root[1] == "mujoco" else "name"
    named = re.search(rf"<\s*{root[1]}\b[^>]*\b{kind}\s*=\s*[\"']([^\"']+)", text)
    return named[1] if named else place.stem, place, root[1] == "robot"


def _described(name: str) -> RobotFile:
    """The description of that name, which its package may fetch."""
    try:
        listed: Any = importlib.import_module(f"{DESCRIPTIONS}._descriptions").DESCRIPTIONS
    except ImportError:
        raise MissingPackage(
            f"No file called {name!r}, and no package {DESCRIPTIONS!r} to look the name up in "
            f"(pip install 'dropo[robots]')."
        ) from None
    options = [form.format(name) for form in _VERSIONS]
    found = next((one for one in options if one in listed), None)
    if found is None:
        short = {re.sub(r"(_mj)?_description$", "", one) for one in listed}
        raise UnknownName(f"No robot description called {name!r}. {nearest(name, short)}")
    try:
        module = importlib.import_module(f"{DESCRIPTIONS}.{found}")
    except Exception as error:  # git's, the network's or the package's own
        raise BadFile(found, "", "a description that can be fetched", str(error)) from None
    for attribute, is_urdf in (("MJCF_PATH", False), ("URDF_PATH", True)):
        path = getattr(module, attribute, None)
        if path is not None:
            return RobotFile(name, Path(path), is_urdf)
    raise BadFile(found, "", "a description as MJCF or URDF", "another")


def load_spec(robot: RobotFile) -> tuple[mujoco.MjSpec, list[str]]:
    """Load a robot for editing; meshes of a URDF that are not there are left out.

    Parameters
    ----------
    robot : RobotFile
        Where its model is.

    Returns
    -------
    spec : MjSpec
        Which compiles.
    left_out : list of str
        Files of meshes that were not found.

    Raises
    ------
    BadFile
        If MuJoCo refuses it.
    """
    spec = specification(robot.path)
    left_out = []
    folder = Path(spec.compiler.meshdir or robot.path.parent)
    missing = {}
    for mesh in spec.meshes:
        if mesh.file and not (folder / mesh.file).exists():
            missing[mesh.name or Path(mesh.file).stem] = mesh
    if robot.is_urdf and missing:
        left_out = sorted(Path(mesh.file).name for mesh in missing.values())
        for geom in list(spec.geoms):
            if geom.meshname in missing:
                spec.delete(geom)
        for mesh in missing.values():
            spec.delete(mesh)
    try:
        spec.compile()
    except ValueError as error:
        raise BadFile(robot.path, "", "a model that compiles", str(error).strip()) from None
    return spec, left_out


def add_drives(spec: mujoco.MjSpec, drives: Mapping[str, DriveGuess]) -> None:
    """Give joints actuators of their names.

    Parameters
    ----------
    spec : MjSpec
        The robot, which is changed.
    drives : mapping
        By joint what drives it.
    """
    for joint, drive in drives.items():
        actuator = spec.add_actuator(name=joint, target=joint)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if drive.kind == "position":
            actuator.set_to_position(kp=drive.stiffness, kv=drive.damping)
        elif drive.kind == "velocity":
            actuator.set_to_velocity(kv=drive.damping)
        else:
            actuator.set_to_motor()


def fit_step(spec: mujoco.MjSpec, control_step: float) -> None:
    """Set a model's physics step to a whole part of a control step, and an integrator for servos.

    Parameters
    ----------
    spec : MjSpec
        The robot, which is changed.
    control_step : float
        [s]
    """
    spec.option.timestep = control_step / max(1, int(np.ceil(control_step / LONGEST_STEP - 1e-6)))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def write_spec(spec: mujoco.MjSpec, folder: Path, made_of: str) -> str:
    """Write a model as MJCF.

    Parameters
    ----------
    spec : MjSpec
        The robot.
    folder : Path
        Where the file will be; meshes are named by their path from there.
    made_of : str
        What the first line says of its origin.

    Returns
    -------
    str
        The MJCF.
    """
    spec.compile()
    for name in ("meshdir", "texturedir"):
        place = getattr(spec.compiler, name)
        if place:
            setattr(spec.compiler, name, os.path.relpath(place, folder))
    return f"<!-- {made_of} -->\n{spec.to_xml()}"
