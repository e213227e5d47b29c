"""Measured motion and what two models predict for it, for the figures of a fit or a diagnosis."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.files.atomic_write import write_npz
from dropo.core.services.files.saved_files import read_npz, require_shapes
from dropo.core.services.validation import Array

FILE = "predictions.npz"
SIDES = ("before", "after")
SIDE_RULES = {
    "name": "text",
    "line": "number W L p",
    "band": "number 2 W L p",
    "by_horizon": "number H",
    "by_signal": "number p",
}
RULES = {
    "names": "text p",
    "units": "text p",
    "seconds": "number",
    "begins": "whole W",
    "measured": "number W L p",
    "rows": "number W L P",
    "spread": "number p",
    "horizons": "whole H",
    "noise": "number H",
    "rows_after": "whole",
    "held_out": "flag",
    **{f"{side}.{name}": rule for side in SIDES for name, rule in SIDE_RULES.items()},
    **{f"{side}.pit": f"number {side}" for side in SIDES},
}
"""The arrays of predictions.npz with their kinds and axes."""
RUN = "run."
RUN_RULES = {
    "run.trajectory": "whole",
    "run.length": "whole",
    "run.measured": "number T p",
    "run.rows": "number T P",
    "run.before": "number T p",
    "run.after": "number T p",
    "run.held_out": "flag T",
}
"""Those of a whole run, where there is one."""
LEVEL = 0.9
"""The fraction of the measured motion that a band should hold."""


@dataclass(frozen=True, eq=False)
class Side:
    """What one model predicts for W windows of L steps and p signals.

    Attributes
    ----------
    name : str
        For legends.
    line : (W, L, p) array
        The mean prediction; NaN where a simulation failed.
    band : (2, W, L, p) array
        The ends of the bands that should hold the fraction `LEVEL`.
    by_horizon : (H,) array
        Root mean square errors after each horizon, over all signals, each in units of its own
        standard deviation.
    by_signal : (p,) array
        Root mean square errors `rows_after` steps after a start, in each signal's unit.
    pit : (n,) array
        The predicted probability of values below each measurement (probability integral
        transform); uniform if the predictions are calibrated.
    """

    name: str
    line: Array
    band: Array
    by_horizon: Array
    by_signal: Array
    pit: Array


@dataclass(frozen=True, eq=False)
class WholeRun:
    """A run of T steps, and what two models predict in windows that follow each other.

    Attributes
    ----------
    trajectory : int
        Which of the data's, from 0; of those held out where these are data of their own.
    length : int
        Control steps after which predictions start again from a measurement.
    measured : (T, p) array
        The measured signals.
    rows : (T, P) array
        The same as observation rows.
    before, after : (T, p) array
        What the two models predict; NaN where a simulation failed.
    held_out : (T,) array of bool
        Which steps no fit has seen.
    """

    trajectory: int
    length: int
    measured: Array
    rows: Array
    before: Array
    after: Array
    held_out: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Predictions:
    """Measured windows, and what two models predict for them.

    Attributes
    ----------
    names, units : tuple of str
        Of the p signals.
    seconds : float
        Length of a control step [s]; NaN where unknown.
    begins : (W,) array of int
        The step of its trajectory at which each window begins.
    measured : (W, L, p) array
        The measured signals.
    rows : (W, L, P) array
        The same as observation rows.
    spread : (p,) array
        Standard deviation of each signal in the data without its noise; 0 where it is constant.
    horizons : (H,) array of int
        Control steps after which errors are given.
    noise : (H,) array
        The error that the measurements' noise alone gives by horizon; NaN where it is unknown.
    rows_after : int
        How many control steps after a start the rows of `by_signal` are.
    held_out : bool
        Whether no fit has seen these data.
    before, after : Side
        The two models.
    run : WholeRun or None
        A whole run; None where none was kept.
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
    run: WholeRun | None = None

    def save(self, folder: str | Path) -> None:
        """Write predictions.npz, whole or not at all.

        Parameters
        ----------
        folder : str or Path
            Made where it is missing.
        """
        write_npz(Path(folder) / FILE, _arrays(self), compressed=True)

    @classmethod
    def load(cls, folder: str | Path) -> "Predictions":
        """Read what `save` wrote.

        Parameters
        ----------
        folder : str or Path
            Where it was written.

        Returns
        -------
        Predictions

        Raises
        ------
        BadFile
            If there is no such file, or it cannot be read, or its arrays do not fit together.
        """
        path = Path(folder) / FILE
        kept = read_npz(path, "what a run of `dropo fit --out` or `dropo diagnose --out` keeps")
        has_run = any(name.startswith(RUN) for name in kept)
        require_shapes(path, kept, RULES | RUN_RULES if has_run else RULES)
        return _from_arrays(cls, kept)


def _arrays(found: Predictions) -> dict[str, Any]:
    """All fields by name, those of the sides as "before.line", those of the run as "run.rows"."""
    own = {field.name: getattr(found, field.name) for field in fields(found)}
    parts = {name: own.pop(name) for name in (*SIDES, "run")}
    for name, part in parts.items():
        if part is not None:
            own |= {f"{name}.{field.name}": getattr(part, field.name) for field in fields(part)}
    return {name: np.asarray(value) for name, value in own.items()}


def _from_arrays(cls: type[Predictions], kept: dict[str, Any]) -> Predictions:
    """The predictions from the arrays that `_arrays` gave."""

    def side(name: str) -> Side:
        arrays = {field.name: kept[f"{name}.{field.name}"] for field in fields(Side)}
        return Side(**{**arrays, "name": str(arrays["name"])})

    names = [field.name for field in fields(cls) if field.name not in (*SIDES, "run")]
    own: dict[str, Any] = {name: kept[name] for name in names}
    for name in ("names", "units"):
        own[name] = tuple(own[name].tolist())
    for name in ("seconds", "rows_after", "held_out"):
        own[name] = own[name].item()
    return cls(**own, before=side("before"), after=side("after"), run=_run(kept))


def _run(kept: dict[str, Any]) -> WholeRun | None:
    """The whole run, where there is one."""
    if not any(name.startswith(RUN) for name in kept):
        return None
    arrays = {field.name: kept[f"{RUN}{field.name}"] for field in fields(WholeRun)}
    whole = {name: arrays[name].item() for name in ("trajectory", "length")}
    return WholeRun(**{**arrays, **whole})
