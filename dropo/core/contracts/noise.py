"""The error of the measurements: known or learned, Gaussian or with long tails, on the start states
too or not.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dropo.core.numerics.array_api import constant
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array, known, require


@dataclass(frozen=True, eq=False)
class Noise:
    """What a likelihood takes for the measurement's error; where it is known and Gaussian, its
    variance alone will do.

    variance: one, or (p,) each signal's [signal unit^2]. learned: "factor", one factor on the
    variances is found with the rest; "each", one for each signal; factors lie in [1e-8, 1e4].
    start: whether the measured start states carry it too: the same variances, in the same
    coordinates. degrees: nu > 2, each row is a multivariate Student t in the Gaussian's place
    (Lange, Little, Taylor 1989, J. Am. Stat. Assoc. 84), whose scale matrix is the Gaussian's
    covariance: its own covariance is nu / (nu - 2) times as large. None: Gaussian. rows: (R, p, p)
    a known covariance of each compared row beside all this.
    """

    variance: float | Array
    learned: Literal["factor", "each"] | None = None
    start: bool = False
    degrees: float | None = None
    rows: Array | None = None

    def __post_init__(self) -> None:
        if self.learned is not None:
            known("learned", self.learned, ("factor", "each"))
        require(
            self.degrees is None or self.degrees > 2,
            "degrees",
            "above 2, to have a variance",
            self.degrees,
            "Noise",
        )


Epsilon = float | Array | Noise


class NoiseModel:
    """epsilon as given, or its factor as an unknown of the likelihood's own."""

    def __init__(self, epsilon: Epsilon, signals: int):
        self.noise = epsilon if isinstance(epsilon, Noise) else Noise(epsilon)
        given = self.noise.variance
        array = np.asarray(given, dtype=float)
        require(
            array.shape in ((), (signals,)),
            "epsilon",
            f"one number, or one for each of {signals} signals",
            array.shape,
            "Likelihood",
        )
        require(
            bool(np.isfinite(array).all() and (array >= 0).all()),
            "epsilon",
            "a finite variance, not negative",
            given,
            "Likelihood",
        )
        self.shape = np.broadcast_to(array, (signals,)).astype(float)
        own = (
            [f"epsilon[{i}]" for i in range(signals)]
            if self.noise.learned == "each"
            else ["epsilon"]
        )
        self.unknowns = (
            tuple(Parameter(name, 1e-8, 1e4, scale="log") for name in own)
            if self.noise.learned
            else ()
        )

    def positive(self, caller: str) -> "NoiseModel":
        """Itself, where no epsilon is 0: a local model's own error must not pass for the noise."""
        if (self.shape <= 0).any():
            raise BadArgument(
                f"The epsilon of {caller} must be positive for every signal: without noise "
                "its covariance is singular."
                " Give epsilon > 0 (the variance of the measurement noise), or 'learn'."
            )
        return self

    def plain(self, caller: str) -> "NoiseModel":
        """Itself, where it is Gaussian and on the compared rows alone, which is all that the caller
        knows.
        """
        if self.noise.start or self.noise.degrees is not None or self.noise.rows is not None:
            raise Incompatible(
                f"{caller} knows no noise on the start states and no Student t. Use "
                "'emulated', 'linear' or 'unscented'."
            )
        return self

    def epsilon(self, own: Array) -> Array:
        """(p,) from the likelihood's own unknowns (p,), (1,) or (0,), array or tensor."""
        shape = constant(self.shape, own)
        return shape * own if self.unknowns else shape

    def slopes(self) -> Array:
        """D epsilon / d own unknown (n, p)."""
        n = len(self.unknowns)
        return (
            np.diag(self.shape) if n == len(self.shape) else np.repeat(self.shape[None], n, axis=0)
        )
