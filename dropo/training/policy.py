"""Policies and their files: JSON, and for a network stable-baselines3's zip beside it."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from dropo._version import __version__
from dropo.core.services.errors import Incompatible
from dropo.core.services.files.atomic_write import write_text
from dropo.core.services.files.saved_files import read_json, refusing_faults
from dropo.core.services.validation import Array, float_array

FILE = "policy.json"
"""Name of a policy's file in a folder."""
EXPECTED = "a policy written by `dropo train --out`"


class Policy(ABC):
    """A function from observations to actions.

    Attributes
    ----------
    limits : (2, q) array
        Lowest and highest actions, infinite where there are none.
    about : dict
        How the policy was trained, as JSON.
    """

    limits: Array
    about: dict[str, Any]

    @property
    @abstractmethod
    def observations(self) -> int:
        """The number o of observations."""

    @property
    def actions(self) -> int:
        """The number q of actions."""
        return self.limits.shape[1]

    @abstractmethod
    def __call__(self, observations: Array) -> Array:
        """Returns actions (m, q), without exploration, for observations (m, o)."""

    @abstractmethod
    def save(self, path: str | Path) -> Path:
        """Write the policy into a file.

        Parameters
        ----------
        path : str or Path
            A file whose name ends with ".json", or a folder, for its file policy.json.

        Returns
        -------
        Path
            The file.
        """

    def check(self, observations: int, limits: Array, target: str) -> None:
        """Check that the policy fits a target.

        Parameters
        ----------
        observations : int
            The target's number of observations.
        limits : (2, q) array
            The target's lowest and highest actions.
        target : str
            The target's name, for the message.

        Raises
        ------
        Incompatible
            If the number of observations or actions, or the limits of the actions, are different.
        """
        if (self.observations, self.actions) != (observations, limits.shape[1]):
            raise Incompatible(
                f"The policy takes {self.observations} observations and gives "
                f"{self.actions} actions, and {target} has {observations} and {limits.shape[1]}. "
                "Train one for it, or choose another target."
            )
        if not np.allclose(self.limits, limits):
            raise Incompatible(
                f"The policy's actions lie in {_format(self.limits)}, and those of {target} "
                f"in {_format(limits)}. Its action space is another: choose another target."
            )


def _format(limits: Array) -> str:
    """Returns limits (2, q) as intervals."""
    return ", ".join(f"[{low:g}, {high:g}]" for low, high in limits.T)


@dataclass(frozen=True, eq=False)
class LinearPolicy(Policy):
    """A linear policy on normalised observations.

    Attributes
    ----------
    weights : (q, o) array
        Weights.
    mean, deviation : (o,) array
        Mean and standard deviation of the observations in training.
    limits : (2, q) array
        Lowest and highest actions, infinite where there are none.
    about : dict
        How the policy was trained, as JSON.

    Notes
    -----
    action = middle + half (weights ((observation - mean) / deviation)), clipped to the limits. Here
    middle is the centre of the limits and half is half their width; of unlimited actions, they are
    0 and 1.
    """

    weights: Array
    mean: Array
    deviation: Array
    limits: Array
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def observations(self) -> int:
        """The number o of observations."""
        return self.weights.shape[1]

    def __call__(self, observations: Array) -> Array:
        return linear(self.weights, self.mean, self.deviation, self.limits, observations)

    def save(self, path: str | Path) -> Path:
        """Write the policy as JSON.

        Parameters
        ----------
        path : str or Path
            A .json file, or a folder.

        Returns
        -------
        Path
            The file.
        """
        content = {
            "kind": "linear",
            "weights": self.weights.tolist(),
            "mean": self.mean.tolist(),
            "deviation": self.deviation.tolist(),
            "limits": written_limits(self.limits),
            "about": self.about,
        }
        return write(path, content)


def linear(
    weights: Array, mean: Array, deviation: Array, limits: Array, observations: Array
) -> Array:
    """Return the actions of linear policies, in sums that no library splits among threads.

    Parameters
    ----------
    weights : (q, o) or (m, q, o) array
        Weights of one policy, or of one for each row.
    mean, deviation : (o,) array
        Mean and standard deviation by which observations are normalised.
    limits : (2, q) array
        Lowest and highest actions, infinite where there are none.
    observations : (m, o) array
        Observations.

    Returns
    -------
    (m, q) array
        Actions.
    """
    scaled = (observations - mean) / deviation
    limited = np.isfinite(limits).all(axis=0)
    low, high = np.where(limited, limits, np.array([[-1.0], [1.0]]))
    actions = (weights * scaled[:, None]).sum(axis=-1) * (high - low) / 2 + (low + high) / 2
    return np.clip(actions, *limits)


def written_limits(limits: Array) -> list[list[float | None]]:
    """Write limits of actions as JSON.

    Parameters
    ----------
    limits : (2, q) array
        Lowest and highest actions.

    Returns
    -------
    list of list of float or None
        Two rows; None for infinite limits.
    """
    return [[float(value) if np.isfinite(value) else None for value in row] for row in limits]


def read_limits(rows: list[list[float | None]]) -> Array:
    """Read limits of actions from JSON.

    Parameters
    ----------
    rows : list of list of float or None
        Two rows, as `written_limits` gives them.

    Returns
    -------
    (2, q) array
        Lowest and highest actions, infinite where there is None.
    """
    low, high = rows
    return np.array(
        [
            [-np.inf if value is None else value for value in low],
            [np.inf if value is None else value for value in high],
        ]
    )


def write(path: str | Path, content: dict[str, Any]) -> Path:
    """Write a policy's JSON, whole or not at all.

    Parameters
    ----------
    path : str or Path
        A file whose name ends with ".json", or a folder.
    content : dict
        The content, one line a key; the version is added.

    Returns
    -------
    Path
        The file.
    """
    path = Path(path)
    path = path if path.suffix == ".json" else path / FILE
    lines = []
    for name, value in {**content, "version": __version__}.items():
        lines.append(f" {json.dumps(name)}: {json.dumps(value, allow_nan=False)}")
    write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")
    return path


def load_policy(path: str | Path, *, trusted: bool = True) -> Policy:
    """Read the policy at a path.

    Parameters
    ----------
    path : str or Path
        The policy's file, or the folder that training wrote.
    trusted : bool
        Read networks too: the files of stable-baselines3 may hold code that runs as they are read.

    Returns
    -------
    Policy
        A LinearPolicy or a NetworkPolicy.

    Raises
    ------
    BadFile
        If there is no file, or it does not hold a policy.
    Incompatible
        If it holds a network and is not trusted.
    MissingPackage
        If it holds a network and stable-baselines3 is not installed.
    """
    path = Path(path)
    if path.is_dir():
        path = path / FILE
    elif path.suffix == ".zip":
        path = path.with_suffix(".json")
    from dropo.core.services.files.file_schema import check_content
    from dropo.training.policy_schema import SCHEMAS, SavedPolicy

    content = read_json(path, EXPECTED)
    check_content(path, content, SCHEMAS.get(str(content.get("kind")), SavedPolicy))
    if content["kind"] == "network" and not trusted:
        refuse_untrusted(path.with_suffix(".zip"))
    with refusing_faults(path, EXPECTED):
        return _read(path, content)


def refuse_untrusted(path: Path) -> NoReturn:
    """Refuse to read a network's file.

    Parameters
    ----------
    path : Path
        The file, for the message.

    Raises
    ------
    Incompatible
        In any case.

    Returns
    -------
    NoReturn
    """
    raise Incompatible(
        f"{path}: a network, whose file may hold Python code, is read only where it is trusted: "
        "give --trust, or load it in Python."
    )


def _read(path: Path, content: dict[str, Any]) -> Policy:
    """Returns the policy of a file's content."""
    limits = read_limits(content["limits"])
    about = content["about"]
    if content["kind"] == "network":
        from dropo.training.networks import NetworkPolicy

        return NetworkPolicy.read(path, content, limits, about)
    q = limits.shape[1]
    weights = float_array("weights", content["weights"], (q, None), str(path))
    o = weights.shape[1]
    mean = float_array("mean", content["mean"], (o,), str(path))
    deviation = float_array("deviation", content["deviation"], (o,), str(path))
    return LinearPolicy(weights, mean, deviation, limits, about)
