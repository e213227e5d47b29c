"""Measured motion beside what a model predicts, before and after: what pictures of a fit or a
diagnosis are drawn from.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.atomic_write import write_npz
from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array

FILE = "predictions.npz"
SIDES = ("before", "after")
LEVEL = 0.9
"""How much of the measured motion a band should hold."""


@dataclass(frozen=True, eq=False)
class Side:
    """What one model predicts, for W windows of L steps and p signals; NaN where a simulation
    failed.

    Attributes
    ----------
    name
        What stands in legends.
    line
        (W, L, p) the mean prediction.
    band
        (2, W, L, p) the ends of the bands that hold a share `LEVEL`.
    by_horizon
        (H,) root mean square errors after each horizon, all signals together, each in units of its
        own spread.
    by_signal
        (p,) root mean square errors `rows_after` steps after a start, in each signal's unit.
    pit
        (n,) the predicted probability of what is below each measurement, uniform where that is
        calibrated.
    """

    name: str
    line: Array
    band: Array
    by_horizon: Array
    by_signal: Array
    pit: Array


@dataclass(frozen=True, eq=False)
class Predictions:
    """Measured windows, and what two models predict for them.

    Attributes
    ----------
    names, units
        Of the p signals.
    seconds
        In a control step; NaN where unknown.
    begins
        (W,) the step of the data at which a window begins, counted within its trajectory.
    measured
        (W, L, p) the signals of the windows.
    rows
        (W, L, P) the same as observation rows.
    spread
        (p,) each signal's standard deviation in the data without its noise; 0 where it is constant.
    horizons
        (H,) control steps after which errors are given.
    noise
        (H,) what the measurements' noise alone gives by horizon; NaN where it is unknown.
    rows_after
        How many steps after a start the rows of `by_signal` are.
    held_out
        Whether no fit has seen these data.
    before, after
        The two models.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    seconds: float
    begins: NDArray[np.int64]
    measured: Array
    rows: Array
    spread: Array
    horizons: NDArray[np.int64]
    noise: Array
    rows_after: int
    held_out: bool
    before: Side
    after: Side

    def save(self, folder: str | Path) -> None:
        """Writes predictions.npz, whole or not at all."""
        write_npz(Path(folder) / FILE, _arrays(self), compressed=True)

    @classmethod
    def load(cls, folder: str | Path) -> "Predictions":
        """What `save` wrote into a folder."""
        path = Path(folder) / FILE
        if not path.is_file():
            raise BadFile(
                path,
                "",
                "what a run of `dropo fit --out` or `dropo diagnose --out` keeps",
                "no such file",
            )
        try:
            with np.load(path, allow_pickle=False) as kept:
                return _from_arrays(cls, dict(kept))
        except (KeyError, ValueError, OSError) as error:
            raise BadFile(
                path,
                "",
                "what a run of `dropo fit --out` keeps",
                f"{type(error).__name__}: {error}",
            ) from None


def _arrays(found: Predictions) -> dict[str, Any]:
    """All fields by name, those of the sides as "before.line"."""
    own = {field.name: getattr(found, field.name) for field in fields(found)}
    sides = {name: own.pop(name) for name in SIDES}
    own |= {
        f"{name}.{field.name}": getattr(side, field.name)
        for name, side in sides.items()
        for field in fields(side)
    }
    return {name: np.asarray(value) for name, value in own.items()}


def _from_arrays(cls: type[Predictions], kept: dict[str, Any]) -> Predictions:
    def side(name: str) -> Side:
        arrays = {field.name: kept[f"{name}.{field.name}"] for field in fields(Side)}
        return Side(**{**arrays, "name": str(arrays["name"])})

    own: dict[str, Any] = {
        field.name: kept[field.name] for field in fields(cls) if field.name not in SIDES
    }
    own |= {name: tuple(own[name].tolist()) for name in ("names", "units")}
    own |= {name: own[name].item() for name in ("seconds", "rows_after", "held_out")}
    return cls(**own, before=side("before"), after=side("after"))
