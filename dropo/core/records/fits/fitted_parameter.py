"""One parameter of a fit, by its name."""

from dataclasses import dataclass

import numpy as np

from dropo.core.services.tables import estimate, number


@dataclass(frozen=True)
class FittedParameter:
    """What a fit says of one parameter.

    Attributes
    ----------
    name, unit : str
        Which one, and its unit.
    mean, mean_se : float
        Mean of the distribution, and its standard error (NaN without one).
    interval : (float, float)
        Of the mean, at 95 %.
    scale : float
        The family's own parameter.
    sd : float
        Standard deviation of the distribution.
    truth : float or None
        What the data were simulated with, where that is known.
    """

    name: str
    unit: str
    mean: float
    mean_se: float
    interval: tuple[float, float]
    scale: float
    sd: float
    truth: float | None = None

    def __float__(self) -> float:
        return self.mean

    def __str__(self) -> str:
        """Such as "mass 3.42 +- 0.071 kg, sd 0.56"."""
        unit = f" {self.unit}" if self.unit else ""
        mean = estimate(self.mean, self.mean_se) if np.isfinite(self.mean_se) else number(self.mean)
        error = f" +- {number(self.mean_se, 2)}" if np.isfinite(self.mean_se) else ""
        return f"{self.name} {mean}{error}{unit}, sd {number(self.sd, 2)}"
