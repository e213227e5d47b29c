"""The contract of measurement noise: known or learned, Gaussian or Student t, on starts or not."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dropo.core.numerics.array_api import constant
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array, known, require


@dataclass(frozen=True, eq=False)
class Noise:
    """What a likelihood assumes of the measurements' error.

    Where the noise is Gaussian and known, its variance alone can be passed in place of this.

    Attributes
    ----------
    variance : float or (p,) array
        One variance, or one for each signal [signal unit^2].
    learned : {"factor", "each"} or None
        "factor": one factor on all variances is fitted too; "each": one factor for each signal.
        Factors lie in [1e-8, 1e4].
    start : bool
        Whether the measured start states carry the noise too, with the same variances in the same
        coordinates.
    degrees : float or None
        Degrees of freedom nu > 2 of a multivariate Student t for each row; None: Gaussian. The
        scale matrix of the Student t is the covariance of the Gaussian, so its own covariance is
        nu / (nu - 2) times as large.
    rows : (R, p, p) array or None
        A known covariance of each compared row, added to the variances.

    Raises
    ------
    UnknownName
        If `learned` is another word.
    BadArgument
        If `degrees` is 2 or less.

    References
    ----------
    Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989), 881, for the Student t.
    """

    variance: float | Array
    learned: Literal["factor", "each"] | None = None
    start: bool = False
    degrees: float | None = None
    rows: Array | None = None

    def __post_init__(self) -> None:
        if self.learned is not None:
            known("learned", self.learned, ("factor", "each"))
        enough = self.degrees is None or self.degrees > 2
        require(enough, "degrees", "above 2, to have a variance", self.degrees, "Noise")


Epsilon = float | Array | Noise
"""A noise variance, one or (p,) [signal unit^2], or a `Noise`."""


class NoiseModel:
    """The noise variance as a function of a likelihood's own unknowns.

    Parameters
    ----------
    epsilon : float, (p,) array or Noise
        The noise.
    signals : int
        p, the number of signals.

    Attributes
    ----------
    noise : Noise
        The noise as it was given.
    shape : (p,) array
        Variances as given; learned factors multiply them [signal unit^2].
    unknowns : tuple of Parameter
        The learned factors, none if the noise is known.

    Raises
    ------
    BadArgument
        If a variance is negative or not finite, or if there is neither one nor p of them.
    """

    def __init__(self, epsilon: Epsilon, signals: int):
        self.noise = epsilon if isinstance(epsilon, Noise) else Noise(epsilon)
        given = self.noise.variance
        array = np.asarray(given, dtype=float)
        rule = f"one number, or one for each of {signals} signals"
        require(array.shape in ((), (signals,)), "epsilon", rule, array.shape, "Likelihood")
        valid = bool(np.isfinite(array).all() and (array >= 0).all())
        require(valid, "epsilon", "a finite variance, not negative", given, "Likelihood")
        self.shape = np.broadcast_to(array, (signals,)).astype(float)
        names: list[str] = []
        if self.noise.learned == "each":
            names = [f"epsilon[{i}]" for i in range(signals)]
        elif self.noise.learned:
            names = ["epsilon"]
        self.unknowns = tuple(Parameter(name, 1e-8, 1e4, scale="log") for name in names)

    def positive(self, caller: str) -> "NoiseModel":
        """Return this model if no variance is 0, else a local model's error would pass for noise.

        Parameters
        ----------
        caller : str
            Who asks, for the message.

        Returns
        -------
        NoiseModel
            Itself.

        Raises
        ------
        BadArgument
            If a variance is 0.
        """
        if (self.shape <= 0).any():
            raise BadArgument(
                f"The epsilon of {caller} must be positive for every signal: without noise its "
                "covariance is singular. Give epsilon > 0 (the variance of the measurement "
                "noise), or 'learn'."
            )
        return self

    def plain(self, caller: str) -> "NoiseModel":
        """Return this model if it is Gaussian and on the compared rows alone.

        Parameters
        ----------
        caller : str
            Who asks, for the message: a likelihood that knows no other noise.

        Returns
        -------
        NoiseModel
            Itself.

        Raises
        ------
        Incompatible
            If the noise is on the start states, a Student t, or has a covariance of each row.
        """
        if self.noise.start or self.noise.degrees is not None or self.noise.rows is not None:
            raise Incompatible(
                f"{caller} knows no noise on the start states and no Student t. Use "
                "'emulated', 'linear' or 'unscented'."
            )
        return self

    def epsilon(self, own: Array) -> Array:
        """Evaluate the noise variances.

        Parameters
        ----------
        own : (n,) array
            The n learned factors, array or tensor; n is 0, 1 or p.

        Returns
        -------
        (p,) array
            Variance of each signal [signal unit^2].
        """
        shape = constant(self.shape, own)
        return shape * own if self.unknowns else shape

    def slopes(self) -> Array:
        """Give the derivatives of the variances.

        Returns
        -------
        (n, p) array
            By each of the n learned factors.
        """
        n = len(self.unknowns)
        if n == len(self.shape):
            return np.diag(self.shape)
        return np.repeat(self.shape[None], n, axis=0)
