"""Independent log-normal distributions, for quantities that are positive."""

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array


class LogNormal(Family):
    """Independent log-normal distributions.

    The mean is that of the parameter itself, the scale the standard deviation of its logarithm.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters; the `low` of each must be positive.

    Attributes
    ----------
    min_scale : float
        Lower bound of a scale in the box of phi, multiplied by log(high / low) where that is below
        1.

    Raises
    ------
    BadArgument
        If the search interval of a parameter contains zero or negative values.

    Notes
    -----
    log xi_i ~ N(log mean_i - scale_i^2 / 2, scale_i^2), so that sd = mean sqrt(exp(scale^2) - 1).
    Means are searched on a log scale in the search interval, scales between `min_scale` and
    log(high / low) / 2.
    """

    standard = NORMAL
    logarithmic = True
    min_scale = 1e-5

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        widths = [_log_width(p) for p in space]
        means = [Parameter(f"mean.{p.name}", p.low, p.high, p.unit, scale="log") for p in space]
        scales = [
            Parameter(f"scale.{p.name}", self.min_scale * min(1.0, width), width / 2, scale="log")
            for p, width in zip(space, widths, strict=True)
        ]
        self.unknowns = ParameterSpace((*means, *scales))

    def _draw(self, phi: Array, base: Array) -> Array:
        s = self.scale(phi)
        z = constant(NORMAL.quantile(base), phi)
        return self.mean(phi) * namespace(phi).exp(s * z - s**2 / 2)

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,) of the parameters themselves."""
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,) of the parameters themselves."""
        xp = namespace(phi)
        return self.mean(phi) * xp.sqrt(xp.expm1(self.scale(phi) ** 2))


def _log_width(parameter: Parameter) -> float:
    """Returns log(high / low) of a search interval."""
    if parameter.low <= 0:
        raise BadArgument(
            f"The 'low' of Parameter {parameter.name!r} must be positive for LogNormal. "
            f"Got {parameter.low!r} instead. "
            "Give a positive low, or take another family, such as 'truncated_gaussian'."
        )
    return float(np.log(parameter.high / parameter.low))
