"""How far predictions are off after 1, 5, 20 steps on data held out, and what share of that the sensors' noise explains."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.simulator import Simulator
from dropo.diagnosis.model import Library, look
from dropo.diagnosis.windows import Windows


@dataclass(frozen=True, eq=False)
class Horizon:
    """Errors after so many steps (`seconds`). rmse: of all signals, in units of each one's own spread; noise: what the sensors' noise
    alone would give, likewise; units: the norm of the errors of all signals of one unit, and what noise gives there."""

    steps: int
    seconds: float | None
    rmse: float
    noise: float
    units: dict[str, tuple[float, float]]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        units = {unit: {"rmse": found, "noise": noise} for unit, (found, noise) in self.units.items()}
        return {"steps": self.steps, "seconds": self.seconds, "rmse": self.rmse, "noise": self.noise, "units": units}


def horizon(library: Library, windows: Windows, theta: Array, sigma: Array) -> Horizon:
    """The errors at the windows' last step. Medians of squares over windows would hide impacts: these are means."""
    seen = look(library, windows, theta, sigma)
    good, p = ~seen.lost, len(sigma)
    errors = (windows.measured - library.predict(theta[None], windows)[0])[good, -p:]
    squares = np.mean(errors**2, axis=0)
    reach = seen.whiten.loadings[good, -p:]
    noise = sigma**2 + np.mean(np.sum((reach * sigma) ** 2, axis=2), axis=0)
    spread = np.maximum(np.var(library.simulator.targets(windows.segments), axis=0) - sigma**2, 1e-300)
    seconds = getattr(library.simulator, "control_step", None)
    return Horizon(
        windows.length, None if seconds is None else windows.length * seconds, float(np.sqrt(np.mean(squares / spread))),
        float(np.sqrt(np.mean(noise / spread))), by_unit(library.simulator, squares, noise),
    )  # fmt: skip


def by_unit(simulator: Simulator, squares: Array, noise: Array) -> dict[str, tuple[float, float]]:
    """The root of the sum of squares (p,) over all signals of one unit, and of the noise's."""
    units = [signal.unit or "-" for signal in simulator.signals]
    same = {unit: np.array([u == unit for u in units]) for unit in dict.fromkeys(units)}
    return {unit: (float(np.sqrt(squares[mask].sum())), float(np.sqrt(noise[mask].sum()))) for unit, mask in same.items()}
