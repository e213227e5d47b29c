"""The typed parts of a fit that say what was chosen for it: the noise, the horizon, the data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from dropo.core.records.fits.fit_parts import FitPart, number_or_nan, number_or_null


@dataclass(frozen=True)
class NoiseTrial:
    """The fit at one noise variance.

    Attributes
    ----------
    epsilon : float
        The noise variance of the first signal [signal unit^2].
    total_variance : float
        The sum of the distribution's variances.
    mse : float
        The mean squared error of the mean prediction.
    log_likelihood : float
        Of all rows [nats].
    """

    epsilon: float
    total_variance: float
    mse: float
    log_likelihood: float


@dataclass(frozen=True)
class NoiseTuning(FitPart):
    """The noise variance chosen by a sweep (Tiboni 2021, section 5.3).

    Attributes
    ----------
    trials : tuple of NoiseTrial
        By rising noise variance.
    mse_threshold : float
        The largest mean squared error that was accepted.
    """

    trials: tuple[NoiseTrial, ...]
    mse_threshold: float
    keys = ("tuning", "mse_threshold")

    def to_json(self) -> dict[str, Any]:
        rows = [dict(vars(trial)) for trial in self.trials]
        return {"tuning": rows, "mse_threshold": self.mse_threshold}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        """Make the record from the entries that `to_json` gave."""
        trials = tuple(NoiseTrial(**row) for row in content["tuning"])
        return cls(trials, content["mse_threshold"])


@dataclass(frozen=True)
class HorizonTrial:
    """The fit at one horizon, scored on data that it has not seen.

    Attributes
    ----------
    horizon : int
        Control steps in a segment: the thesis' lambda.
    below_best : float
        How far its held-out log-likelihood is below the best one's [nats]; NaN where a simulation
        diverged.
    paired_error : float
        The standard error of that difference.
    chosen : bool
        Whether it was taken.
    mean, mean_se : tuple of float
        The fitted means (d,) and their standard errors, NaN where there is none.
    """

    horizon: int
    below_best: float
    paired_error: float
    chosen: bool
    mean: tuple[float, ...]
    mean_se: tuple[float, ...]


@dataclass(frozen=True)
class HorizonChoice(FitPart):
    """The horizons that were tried, of which one was chosen by its held-out predictions.

    Attributes
    ----------
    trials : tuple of HorizonTrial
        One for each horizon, of which one is chosen.
    """

    trials: tuple[HorizonTrial, ...]
    keys = ("lambda_choice",)

    @property
    def chosen(self) -> int:
        """The horizon that was taken [control steps]."""
        return next(trial.horizon for trial in self.trials if trial.chosen)

    def to_json(self) -> dict[str, Any]:
        rows = [
            {
                "lambda": trial.horizon,
                "below_best": number_or_null(trial.below_best),
                "paired_error": trial.paired_error,
                "chosen": trial.chosen,
                "mean": list(trial.mean),
                "mean_se": [number_or_null(error) for error in trial.mean_se],
            }
            for trial in self.trials
        ]
        return {"lambda_choice": rows}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        """Make the record from the entries that `to_json` gave."""
        trials = tuple(
            HorizonTrial(
                horizon=row["lambda"],
                below_best=number_or_nan(row["below_best"]),
                paired_error=row["paired_error"],
                chosen=row["chosen"],
                mean=tuple(row["mean"]),
                mean_se=tuple(number_or_nan(error) for error in row["mean_se"]),
            )
            for row in content["lambda_choice"]
        )
        return cls(trials)


@dataclass(frozen=True)
class ExcludedSpan:
    """A span of time that was left out, since something acts in it that no command explains.

    Attributes
    ----------
    run : int
        The trajectory's number.
    held_out : bool
        Whether it is one of those held out.
    start, end : float
        From the trajectory's beginning [s].
    signal, unit : str
        The signal that is off most, and its unit.
    error : float
        By how much it is off, in that unit.
    after : float
        After how long a prediction [s].
    times : float
        That error in units of the usual one.
    """

    run: int
    held_out: bool
    start: float
    end: float
    signal: str
    unit: str
    error: float
    after: float
    times: float

    def to_json(self) -> dict[str, Any]:
        """The span as fit.json has it.

        Returns
        -------
        dict
            As fit.json has it.
        """
        return {
            "run": self.run,
            "held_out": self.held_out,
            "from": self.start,
            "to": self.end,
            "seconds": self.end - self.start,
            "signal": self.signal,
            "unit": self.unit,
            "off": self.error,
            "after": self.after,
            "times": self.times,
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make the span from what `to_json` gave.

        Parameters
        ----------
        saved : mapping of str to Any
            The span's entries of fit.json; `times` may be missing.

        Returns
        -------
        ExcludedSpan
            Its `times` is NaN where it is missing.
        """
        return cls(
            run=saved["run"],
            held_out=saved["held_out"],
            start=saved["from"],
            end=saved["to"],
            signal=saved["signal"],
            unit=saved["unit"],
            error=saved["off"],
            after=saved["after"],
            times=saved.get("times", np.nan),
        )


@dataclass(frozen=True)
class ExcludedSpans(FitPart):
    """The spans of time that were left out before the fit.

    Attributes
    ----------
    spans : tuple of ExcludedSpan
        In the order of the runs.
    """

    spans: tuple[ExcludedSpan, ...]
    keys = ("disturbances",)

    def to_json(self) -> dict[str, Any]:
        return {"disturbances": [span.to_json() for span in self.spans]}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        """Make the record from the entries that `to_json` gave."""
        return cls(tuple(ExcludedSpan.from_json(span) for span in content["disturbances"]))
