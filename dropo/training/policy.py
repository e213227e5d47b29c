"""Policies as files: a linear one is JSON; a network is stable-baselines3's zip with JSON beside
it.
"""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.atomic_write import write_text
from dropo.core.services.errors import BadFile, Incompatible
from dropo.core.services.validation import Array, float_array

NAME = "policy.json"


class Policy(ABC):
    """What acts on observations.

    limits: (2, q) the lowest and highest actions; about: how it was trained, as JSON.
    """

    limits: Array
    about: dict[str, Any]

    @property
    @abstractmethod
    def observations(self) -> int:
        """o, the numbers that it sees."""

    @property
    def actions(self) -> int:
        """q, the numbers that it sets."""
        return self.limits.shape[1]

    @abstractmethod
    def __call__(self, observations: Array) -> Array:
        """Actions (m, q), without exploration, for observations (m, o)."""

    @abstractmethod
    def save(self, path: str | Path) -> Path:
        """Writes the policy: into a folder as policy.json, or as the JSON file named; gives its
        path.
        """

    def check(self, observations: int, limits: Array, target: str) -> None:
        """Incompatible unless it takes so many observations and its actions (2, q) are those of the
        target.
        """
        if (self.observations, self.actions) != (observations, limits.shape[1]):
            raise Incompatible(
                f"The policy takes {self.observations} observations and gives "
                f"{self.actions} actions, and {target} has"
                f" {observations} and {limits.shape[1]}. Train one for it, or choose "
                "another target."
            )
        if not np.allclose(self.limits, limits):
            raise Incompatible(
                f"The policy's actions lie in {_shown(self.limits)}, and those of {target} "
                f"in {_shown(limits)}."
                " Its action space is another: choose another target."
            )


def _shown(limits: Array) -> str:
    return ", ".join(f"[{low:g}, {high:g}]" for low, high in limits.T)


@dataclass(frozen=True, eq=False)
class LinearPolicy(Policy):
    """action = middle + half ((weights ((observation - mean) / deviation)) within the limits; of
    unlimited actions, middle 0 and half 1.

    weights: (q, o); mean, deviation: (o,) of the observations seen in training; limits: (2, q);
    about: as for `Policy`.
    """

    weights: Array
    mean: Array
    deviation: Array
    limits: Array
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def observations(self) -> int:
        return self.weights.shape[1]

    def __call__(self, observations: Array) -> Array:
        return linear(self.weights, self.mean, self.deviation, self.limits, observations)

    def save(self, path: str | Path) -> Path:
        numbers = {name: getattr(self, name).tolist() for name in ("weights", "mean", "deviation")}
        return write(
            path,
            {
                "kind": "linear",
                **numbers,
                "limits": written_limits(self.limits),
                "about": self.about,
            },
        )


def linear(
    weights: Array, mean: Array, deviation: Array, limits: Array, observations: Array
) -> Array:
    """(m, q) actions of linear policies: weights (q, o) of one, or (m, q, o), one a row.

    In sums that no library splits among threads.
    """
    scaled = (observations - mean) / deviation
    limited = np.isfinite(limits).all(axis=0)
    low, high = np.where(limited, limits, np.array([[-1.0], [1.0]]))
    wanted = (weights * scaled[:, None]).sum(axis=-1) * (high - low) / 2 + (low + high) / 2
    return np.clip(wanted, *limits)


def written_limits(limits: Array) -> list[list[float | None]]:
    """Limits as JSON; null where there is none."""
    return [[float(value) if np.isfinite(value) else None for value in row] for row in limits]


def read_limits(rows: list[list[float | None]]) -> Array:
    """(2, q) from JSON."""
    return np.array(
        [
            [sign * np.inf if value is None else value for value in row]
            for sign, row in zip((-1, 1), rows, strict=True)
        ]
    )


def write(path: str | Path, content: dict[str, Any]) -> Path:
    """Writes a policy's JSON whole or not at all, and gives its path; a path without .json is a
    folder.
    """
    path = Path(path)
    path = path if path.suffix == ".json" else path / NAME
    lines = ",\n".join(
        f" {json.dumps(name)}: {json.dumps(value, allow_nan=False)}"
        for name, value in content.items()
    )
    write_text(path, f"{{\n{lines}\n}}\n")
    return path


def load_policy(path: str | Path) -> Policy:
    """The policy at a path: a file, or the folder that training wrote; BadFile where there is none."""
    path = Path(path)
    path = (
        path / NAME
        if path.is_dir()
        else path.with_suffix(".json")
        if path.suffix == ".zip"
        else path
    )
    if not path.is_file():
        raise BadFile(path, "", "a policy written by `dropo train --out`", "no such file")
    try:
        content = json.loads(path.read_text())
        limits = read_limits(content["limits"])
        about = content["about"]
        if content["kind"] == "network":
            from dropo.training.networks import NetworkPolicy

            return NetworkPolicy.of(path, content, limits, about)
        q = limits.shape[1]
        weights = float_array("weights", content["weights"], (q, None), str(path))
        mean, deviation = (
            float_array(name, content[name], (weights.shape[1],), str(path))
            for name in ("mean", "deviation")
        )
        return LinearPolicy(weights, mean, deviation, limits, about)
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        if isinstance(error, BadFile | Incompatible):
            raise
        raise BadFile(
            path, "", "a policy written by `dropo train --out`", f"{type(error).__name__}: {error}"
        ) from None
