"""How far predictions are off after few and many steps on data held out, and what share of that the
sensors' noise explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import State
from dropo.diagnosis.search.windows import FEWEST, held_out_windows, spread_of

HORIZONS = (1, 5, 20, 100, 400)
# windows of a horizon, control steps of them all, at most; but no fewer than LEAST windows
MOST = 480
ROWS = 4800
LEAST = 40
DRAWS = 2  # of each window's start, that tell what noise explains


@dataclass(frozen=True, eq=False)
class Horizon:
    """Errors after so many steps (`seconds`). rmse: of all signals, in units of each one's own
    spread; noise: what the sensors' noise alone would give, likewise; units: the norm of the
    errors of all signals of one unit, and what noise gives there.
    """

    steps: int
    seconds: float | None
    rmse: float
    noise: float
    units: dict[str, tuple[float, float]]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        units = {
            unit: {"rmse": found, "noise": noise} for unit, (found, noise) in self.units.items()
        }
        return {
            "steps": self.steps,
            "seconds": self.seconds,
            "rmse": self.rmse,
            "noise": self.noise,
            "units": units,
        }


def horizons(
    problem: Problem,
    library: Library,
    thetas: Sequence[Array],
    last: State,
    rng: np.random.Generator,
    lengths: Sequence[int] = HORIZONS,
) -> list[list[Horizon]]:
    """The errors under each theta after each of the lengths, and after that of the windows, for
    which the data held out are long enough.

    The noise is that of the last state: its starts are drawn anew, so that it is known at impacts,
    too. Windows may overlap.
    """
    found: list[list[Horizon]] = [[] for _ in thetas]
    thetas = [*thetas, last.theta]
    different, which = np.unique(
        np.stack(thetas), axis=0, return_inverse=True
    )  # with nothing found, or nothing fitted, some are the same
    which = which.ravel()
    sigma = last.train.whiten.sigma
    variance = spread_of(library.simulator, last.test.windows) ** 2
    for steps in sorted({*lengths, last.train.windows.length}):
        windows = held_out_windows(problem, steps, max(LEAST, min(MOST, ROWS // steps)))
        if len(windows) < FEWEST:
            break
        predicted = library.predict(different, windows)
        offsets = sigma * rng.standard_normal((DRAWS, len(windows), len(sigma)))
        moved = (
            library.predict(np.repeat(last.theta[None], DRAWS, axis=0), windows, offsets)
            - predicted[which[-1]]
        )
        reach = moved[np.isfinite(moved).all(axis=2), -len(sigma) :]
        noise = sigma**2 + np.mean(reach**2, axis=0)
        every = [
            _horizon(library.simulator, steps, windows.measured - one, noise, variance)
            for one in predicted
        ]
        for out, i in zip(found, which[:-1].tolist(), strict=True):
            out.append(every[i])
    return found


def _horizon(
    simulator: Simulator, steps: int, errors: Array, noise: Array, variance: Array
) -> Horizon:
    """Errors (W, n) of which the last step counts.

    Medians over windows would hide impacts: these are means; NaN windows are left out.
    """
    last = errors[:, -len(noise) :]
    squares = np.mean(last[np.isfinite(last).all(axis=1)] ** 2, axis=0)
    spread = np.maximum(variance - noise, 1e-3 * variance)
    seconds = simulator.control_step
    return Horizon(
        steps,
        None if seconds is None else steps * seconds,
        float(np.sqrt(np.mean(squares / spread))),
        float(np.sqrt(np.mean(noise / spread))),
        by_unit(simulator, squares, noise),
    )


def by_unit(simulator: Simulator, squares: Array, noise: Array) -> dict[str, tuple[float, float]]:
    """The root of the sum of squares (p,) over all signals of one unit, and of the noise's."""
    units = [signal.unit or "-" for signal in simulator.signals]
    same = {unit: np.array([u == unit for u in units]) for unit in dict.fromkeys(units)}
    return {
        unit: (float(np.sqrt(squares[mask].sum())), float(np.sqrt(noise[mask].sum())))
        for unit, mask in same.items()
    }
