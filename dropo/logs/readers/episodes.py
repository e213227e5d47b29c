"""Episodes of data sets for learning: LeRobot's Parquet layout, and Minari's."""

import json
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import (
    Arrays,
    Log,
    Progress,
    expand_columns,
    join_blocks,
    package,
    part_progress,
)
from dropo.logs.readers.tables import ParquetLog


class LeRobotLog(Log):
    """A folder with meta/info.json and episodes as Parquet files under data/, in LeRobot's layout.

    Columns are "observation.state[0]", or by the names that info.json gives its elements:
    "observation.state[elbow.pos]".
    """

    run_column = "episode_index"
    time_column = "timestamp"

    @cached_property
    def _names(self) -> dict[str, str]:
        """By the name of an element, "observation.state[elbow]", that of its column, "...[0]"."""
        path = self.path / "meta" / "info.json"
        try:
            features = json.loads(path.read_text()).get("features", {})
        except ValueError as error:
            raise BadFile(path, "", "JSON", str(error)) from None
        names = {}
        for feature, content in features.items():
            elements = _list_names(content.get("names")) if isinstance(content, dict) else []
            for i, name in enumerate(elements):
                names[f"{feature}[{name}]"] = f"{feature}[{i}]"
        return names

    @cached_property
    def _files(self) -> list[ParquetLog]:
        """The files of the episodes."""
        files = [ParquetLog(path) for path in sorted((self.path / "data").rglob("*.parquet"))]
        if not files:
            raise BadFile(self.path / "data", "", "Parquet files of episodes", "none")
        return files

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        own = self._files[0].columns(None)
        return [*own, *(name for name, place in self._names.items() if place in own)]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        places = [self._names.get(name, name) for name in columns]
        blocks = []
        for i, file in enumerate(self._files):
            blocks.append(file.read(None, places, part_progress(progress, i, len(self._files))))
        found = join_blocks(blocks, places)
        return {name: found[place] for name, place in zip(columns, places, strict=True)}


def _list_names(names: Any) -> list[str]:
    """The names of a feature's elements: a list, or lists under some word ("motors")."""
    if isinstance(names, dict):
        names = next((value for value in names.values() if isinstance(value, list)), list(names))
    return [str(name) for name in names or ()]


class MinariLog(Log):
    """A Minari data set's folder, with columns "observations[0]", "actions[0]" and so on.

    A column of a dictionary is "observations.position[0]". Each episode is a run with one more
    observation than actions: the last row has no action. It has no time stamps: rows are a control
    step apart, which the mapping's `rate` gives.
    """

    run_column = "episode"
    time_column = None
    separate_runs = True

    @cached_property
    def _runs(self) -> list[Arrays]:
        """The columns of each episode."""
        minari = package("minari", self.path, "minari")
        place = self.path / "data" if (self.path / "data").is_dir() else self.path
        try:
            episodes = list(minari.MinariDataset(place).iterate_episodes())
        except (OSError, ValueError, KeyError, ImportError) as error:
            raise self.broken("a Minari data set", "", error) from None
        return [_episode(episode) for episode in episodes if len(episode.rewards)]

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        names = list(self._runs[0]) if self._runs else []
        return [*names, self.run_column]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        blocks = []
        for i, run in enumerate(self._runs):
            rows = len(next(iter(run.values())))
            numbered = run | {self.run_column: np.full(rows, i)}
            blocks.append({name: numbered[name] for name in columns})
            progress((i + 1) / len(self._runs), f"reading {self.path.name}")
        return join_blocks(blocks, columns)


def _episode(episode: Any) -> Arrays:
    """An episode's columns, T + 1 rows; the action of the last is NaN."""
    observations = _flatten("observations", episode.observations)
    parts = observations | _flatten("actions", episode.actions)
    rows = max(len(array) for array in parts.values())
    padded = {}
    for name, array in parts.items():
        padded[name] = np.full((rows, *array.shape[1:]), np.nan)
        padded[name][: len(array)] = array
    return expand_columns(padded)


def _flatten(name: str, value: Any) -> Arrays:
    """An array under its name, or the arrays of nested dictionaries under dotted names."""
    if not isinstance(value, dict):
        return {name: np.asarray(value, dtype=float)}
    arrays: Arrays = {}
    for key, item in value.items():
        arrays |= _flatten(f"{name}.{key}", item)
    return arrays
