"""Independent log-normal distributions, for quantities that are positive."""

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array


class LogNormal(Family):
    """log xi_i ~ N(log mean_i - scale_i^2 / 2, scale_i^2): mean_i is the mean of xi_i itself,
    scale_i the sd of its logarithm.

    sd = mean sqrt(exp(scale^2) - 1). Means are searched on a log scale in the search interval;
    scales in [1e-5, log(high / low) / 2], the lower end shrunk with intervals narrower than a
    factor e.
    """

    standard = NORMAL
    logarithmic = True

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        reach = [_log_ratio(p) for p in space]
        means = [Parameter(f"mean.{p.name}", p.low, p.high, p.unit, scale="log") for p in space]
        scales = [
            Parameter(f"scale.{p.name}", 1e-5 * min(1.0, r), r / 2, scale="log")
            for p, r in zip(space, reach, strict=True)
        ]
        self.unknowns = ParameterSpace((*means, *scales))

    def _draw(self, phi: Array, base: Array) -> Array:
        s = self.scale(phi)
        return self.mean(phi) * namespace(phi).exp(
            s * constant(NORMAL.quantile(base), phi) - s**2 / 2
        )

    def mean(self, phi: Array) -> Array:
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        xp = namespace(phi)
        return self.mean(phi) * xp.sqrt(xp.expm1(self.scale(phi) ** 2))


def _log_ratio(parameter: Parameter) -> float:
    if parameter.low <= 0:
        raise BadArgument(
            f"The 'low' of Parameter {parameter.name!r} must be positive for LogNormal. "
            f"Got {parameter.low!r} instead."
            " Give a positive low, or take another family, such as 'truncated_gaussian'."
        )
    return float(np.log(parameter.high / parameter.low))
