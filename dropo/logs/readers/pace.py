"""Data of PACE (sim-to-real of legged robots): a file of torch with tensors by name."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import Arrays, Log, Progress, expand_columns, package


class PaceLog(Log):
    """A .pt file: `time` (n,) [s], `dof_pos` and `des_dof_pos` (n, k), and others of n rows.

    Columns are "dof_pos[0]"; where the file has a list `joint_order`, also "dof_pos[elbow]".
    """

    time_column = "time"
    expected = "a file of torch with tensors by name, `time` and `dof_pos` among them"

    @cached_property
    def _table(self) -> Arrays:
        """The columns."""
        torch = package("torch", self.path, "torch")
        try:
            content = torch.load(self.path, map_location="cpu", weights_only=True)
        except Exception as error:  # the decoder's, and the unpickler's own
            raise self.broken(self.expected, "", str(error).splitlines()[0]) from None
        if not isinstance(content, dict) or "time" not in content:
            got = ", ".join(map(str, content)) if isinstance(content, dict) else type(content)
            raise BadFile(self.path, "", self.expected, got)
        rows = len(content["time"])
        order = content.get("joint_order") or ()
        arrays: Arrays = {}
        for name, value in content.items():
            array = _numbers(value)
            if array is not None and array.ndim >= 1 and len(array) == rows:
                arrays[str(name)] = array.astype(float)
        columns = expand_columns(arrays)
        for name, array in arrays.items():
            if array.ndim == 2 and array.shape[1] == len(order):
                columns |= {f"{name}[{joint}]": array[:, i] for i, joint in enumerate(order)}
                for i in range(len(order)):
                    columns.pop(f"{name}[{i}]", None)
        return columns

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        return list(self._table)

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        progress(1.0, f"reading {self.path.name}")
        return {name: self._table[name] for name in columns}


def _numbers(value: Any) -> np.ndarray | None:
    """A tensor as an array; None of anything else."""
    return np.asarray(value.numpy()) if hasattr(value, "numpy") else None
