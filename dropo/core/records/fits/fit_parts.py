"""The typed parts of a fit: what the built-in methods find beside the distribution itself."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array


class FitPart(ABC):
    """A part of a fit, which knows its own entries of fit.json and its own arrays of fit.npz.

    Attributes
    ----------
    keys : tuple of str
        Its keys in fit.json; the part is there where the first one is.
    array_names : tuple of str
        Its arrays in fit.npz.
    """

    keys: ClassVar[tuple[str, ...]]
    array_names: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Give the part's entries of fit.json.

        Returns
        -------
        dict
            By key; numbers that do not exist are None.
        """

    def to_arrays(self) -> dict[str, Array]:
        """Give the part's arrays of fit.npz.

        Returns
        -------
        dict of str to array
            By name.
        """
        return {}

    @classmethod
    @abstractmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        """Make the part from the contents of a saved fit, of which it takes its own.

        Parameters
        ----------
        content : mapping of str to Any
            The entries of fit.json, by key.
        arrays : mapping of str to array
            The arrays of fit.npz, by name.

        Returns
        -------
        FitPart
            Equal to the one that was saved.
        """


def number_or_null(value: float) -> float | None:
    """Turn a number into what JSON can hold.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float or None
        None, which JSON has as null, where the number is not finite.
    """
    return float(value) if np.isfinite(value) else None


def number_or_nan(saved: float | None) -> float:
    """Turn what JSON holds into a number.

    Parameters
    ----------
    saved : float or None
        As `number_or_null` gave it.

    Returns
    -------
    float
        NaN for null.
    """
    return np.nan if saved is None else float(saved)


def numbers_or_null(values: Mapping[str, float]) -> dict[str, float | None]:
    """Turn named numbers into what JSON can hold.

    Parameters
    ----------
    values : mapping of str to float
        Numbers by name.

    Returns
    -------
    dict of str to float or None
        None where a number is not finite.
    """
    return {name: number_or_null(value) for name, value in values.items()}


def numbers_or_nan(saved: Mapping[str, float | None]) -> dict[str, float]:
    """Turn what JSON holds into named numbers.

    Parameters
    ----------
    saved : mapping of str to float or None
        As `numbers_or_null` gave it.

    Returns
    -------
    dict of str to float
        NaN for null.
    """
    return {name: number_or_nan(value) for name, value in saved.items()}


@dataclass(frozen=True)
class EmulatorCheck(FitPart):
    """The simulator beside its emulator at the fit, on the same draws and rows.

    Attributes
    ----------
    draws, rows : int
        How many draws of the fitted distribution, on how many rows.
    simulator, emulator : float
        The log-likelihood of these rows under each [nats]; NaN where it is not finite.
    """

    draws: int
    rows: int
    simulator: float
    emulator: float
    keys = ("emulator_check",)

    def to_json(self) -> dict[str, Any]:
        values = {
            "draws": self.draws,
            "rows": self.rows,
            "simulator": number_or_null(self.simulator),
            "emulator": number_or_null(self.emulator),
        }
        return {"emulator_check": values}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        saved = content["emulator_check"]
        simulator = number_or_nan(saved["simulator"])
        return cls(saved["draws"], saved["rows"], simulator, number_or_nan(saved["emulator"]))


@dataclass(frozen=True)
class PriorUse(FitPart):
    """What priors are to the means of a fit that was searched with them.

    Attributes
    ----------
    laws : mapping of str to str
        The priors as texts, by the parameters that have one.
    share : mapping of str to float
        How much of what is known of each parameter's mean the priors give, 0 to 1: the part of the
        inverse of its variance that is lost without them. NaN for a mean on its bound.
    apart : mapping of str to float
        How many standard deviations data and prior are apart, by the parameters that have one; NaN
        of a prior without curvature, such as a uniform one.
    """

    laws: Mapping[str, str]
    share: Mapping[str, float]
    apart: Mapping[str, float]
    keys = ("priors",)

    def to_json(self) -> dict[str, Any]:
        values = {
            "laws": dict(self.laws),
            "share": numbers_or_null(self.share),
            "apart": numbers_or_null(self.apart),
        }
        return {"priors": values}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        saved = content["priors"]
        return cls(saved["laws"], numbers_or_nan(saved["share"]), numbers_or_nan(saved["apart"]))


@dataclass(frozen=True)
class StartFilter(FitPart):
    """How the Kalman filter of the start states and the fit settled, in turn.

    Attributes
    ----------
    moves : tuple of float
        By how many standard errors the means moved at each turn, at most.
    resets : int
        How often an innovation was too large, so that the filter began anew.
    """

    moves: tuple[float, ...]
    resets: int
    keys = ("filter",)

    def to_json(self) -> dict[str, Any]:
        return {"filter": {"moves": list(self.moves), "resets": self.resets}}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        return cls(tuple(content["filter"]["moves"]), content["filter"]["resets"])


@dataclass(frozen=True)
class ResidualSize:
    """The size of the whitened residuals.

    Attributes
    ----------
    mean_square, standard_error : float
        Their mean square, 1 for a right model, and its standard error.
    """

    mean_square: float
    standard_error: float


@dataclass(frozen=True)
class ResidualStructure:
    """The strongest dependence of residuals on state and action.

    Attributes
    ----------
    signal, feature : str
        The signal whose residuals follow one feature most.
    z : float
        The normal score of that dependence.
    held_out_signal : str
        The signal whose residuals all features together predict best, in data held out.
    held_out_z : float
        The normal score of that prediction.
    """

    signal: str
    feature: str
    z: float
    held_out_signal: str
    held_out_z: float


@dataclass(frozen=True)
class ModelCheck(FitPart):
    """Whether the fitted model can be right, on which standard errors and intervals rest.

    Attributes
    ----------
    passed : bool
        Whether nothing speaks against the model.
    size : ResidualSize or None
        Where the noise was given; None where it was learned.
    structure : ResidualStructure or None
        None where all residuals are rounding.
    sentences : tuple of str
        What speaks against the model. They are among the fit's warnings, and not saved here.
    """

    passed: bool
    size: ResidualSize | None = None
    structure: ResidualStructure | None = None
    sentences: tuple[str, ...] = field(default=(), compare=False)
    keys = ("model_check",)

    def to_json(self) -> dict[str, Any]:
        found: dict[str, Any] = {"passed": self.passed}
        if self.size is not None:
            found["size"] = vars(self.size)
        if self.structure is not None:
            found["structure"] = vars(self.structure)
        return {"model_check": found}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        saved = content["model_check"]
        size = ResidualSize(**saved["size"]) if "size" in saved else None
        structure = ResidualStructure(**saved["structure"]) if "structure" in saved else None
        return cls(saved["passed"], size, structure)


@dataclass(frozen=True)
class HeldOutErrors(FitPart):
    """Errors on trajectories that no fit has seen.

    Attributes
    ----------
    rows, steps : int
        Compared rows, and control steps in the longest segment.
    rmse : mapping of str to float
        By unit, the root mean square error over the unit's signals at the fitted mean; NaN where a
        simulation diverged.
    rmse_nominal : mapping of str to float, or None
        The same with the parameters as they stand in the model; None where it has none.
    """

    rows: int
    steps: int
    rmse: Mapping[str, float]
    rmse_nominal: Mapping[str, float] | None = None
    keys = ("held_out",)

    def to_json(self) -> dict[str, Any]:
        found = {"rows": self.rows, "steps": self.steps, "rmse": numbers_or_null(self.rmse)}
        if self.rmse_nominal is not None:
            found["rmse_nominal"] = numbers_or_null(self.rmse_nominal)
        return {"held_out": found}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        saved = content["held_out"]
        nominal = numbers_or_nan(saved["rmse_nominal"]) if "rmse_nominal" in saved else None
        return cls(saved["rows"], saved["steps"], numbers_or_nan(saved["rmse"]), nominal)


@dataclass(frozen=True)
class VarianceTest:
    """A likelihood-ratio test that a variance component is 0.

    Attributes
    ----------
    statistic : float
        Twice the gain in log-likelihood of having it.
    p_value : float
        Of the test.
    """

    statistic: float
    p_value: float


@dataclass(frozen=True)
class VarianceComponentTests:
    """Whether groups differ, and in which parameters: tests that variance components are 0.

    Attributes
    ----------
    overall : VarianceTest
        All components against none.
    parameters : mapping of str to VarianceTest
        Each parameter's own component against none.
    """

    overall: VarianceTest
    parameters: Mapping[str, VarianceTest]

    def to_json(self) -> dict[str, Any]:
        """The tests as plain numbers.

        Returns
        -------
        dict
            Plain numbers, by key.
        """
        parameters = {name: dict(vars(test)) for name, test in self.parameters.items()}
        return {**vars(self.overall), "parameters": parameters}

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Make the tests from what `to_json` gave.

        Parameters
        ----------
        saved : mapping of str to Any
            The entry of fit.json: the test of all together, and under "parameters" each one's.

        Returns
        -------
        VarianceComponentTests
            Equal to those that were saved.
        """
        parameters = {name: VarianceTest(**test) for name, test in saved["parameters"].items()}
        return cls(VarianceTest(saved["statistic"], saved["p_value"]), parameters)


@dataclass(frozen=True, eq=False)
class GroupEffects(FitPart):
    """The groups that each have one draw of the parameters from the fitted population.

    Attributes
    ----------
    kind : {"groups", "trajectories"}
        What a group is.
    fewest_rows, most_rows : int
        Rows of the smallest and of the largest group.
    shrinkage : mapping of str to float
        By parameter, the fraction by which a group's own deviation shrinks, on average.
    median_sd : mapping of str to float
        By parameter, the median of the groups' own standard deviations; NaN where unknown.
    predictive_sd : mapping of str to float
        By parameter, the standard deviation for a new group: the population's, and the
        uncertainty of its mean.
    tests : VarianceComponentTests
        Whether the groups differ.
    number : (G,) array
        Each group's number in the data.
    mean : (G, d) array
        Each group's parameters given all data.
    covariance : (G, d, d) array
        Their covariance, with the uncertainty of the population's mean and not of its spread.
    """

    kind: Literal["groups", "trajectories"]
    fewest_rows: int
    most_rows: int
    shrinkage: Mapping[str, float]
    median_sd: Mapping[str, float]
    predictive_sd: Mapping[str, float]
    tests: VarianceComponentTests
    number: Array
    mean: Array
    covariance: Array
    keys = ("groups", "groups_differ", "predictive_sd")
    array_names = ("group", "group_mean", "group_covariance")

    def __len__(self) -> int:
        return len(self.number)

    def to_json(self) -> dict[str, Any]:
        groups = {
            "of": self.kind,
            "count": len(self),
            "fewest_rows": self.fewest_rows,
            "most_rows": self.most_rows,
            "shrinkage": numbers_or_null(self.shrinkage),
            "median_sd": numbers_or_null(self.median_sd),
        }
        return {
            "groups": groups,
            "groups_differ": self.tests.to_json(),
            "predictive_sd": numbers_or_null(self.predictive_sd),
        }

    def to_arrays(self) -> dict[str, Array]:
        return {
            "group": self.number,
            "group_mean": self.mean,
            "group_covariance": self.covariance,
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        saved = content["groups"]
        return cls(
            kind=saved["of"],
            fewest_rows=saved["fewest_rows"],
            most_rows=saved["most_rows"],
            shrinkage=numbers_or_nan(saved["shrinkage"]),
            median_sd=numbers_or_nan(saved["median_sd"]),
            predictive_sd=numbers_or_nan(content["predictive_sd"]),
            tests=VarianceComponentTests.from_json(content["groups_differ"]),
            number=arrays["group"],
            mean=arrays["group_mean"],
            covariance=arrays["group_covariance"],
        )


@dataclass(frozen=True)
class PosteriorDiagnostics:
    """Convergence diagnostics of a posterior's chains, by unknown.

    Attributes
    ----------
    autocorrelation_time : mapping of str to float
        Integrated, of one walker [steps].
    split_r_hat : mapping of str to float
        1 where the walkers agree (Vehtari et al. 2021).
    effective_sample_size : mapping of str to float
        Independent draws that would give the mean as well.
    """

    autocorrelation_time: Mapping[str, float]
    split_r_hat: Mapping[str, float]
    effective_sample_size: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class PosteriorDraws(FitPart):
    """The draws of a posterior and their diagnostics.

    Attributes
    ----------
    over : {"parameters", "distribution"}
        What was drawn: the parameters, or the unknowns of the distribution that they come from.
    unknowns : tuple of str
        The names of the m unknowns.
    diagnostics : PosteriorDiagnostics
        Of each unknown.
    chain : (S, W, m) array
        The states of W walkers over S steps.
    log_density : (S, W) array
        The log of the posterior's density at each state, up to a constant.
    observed : (R, p) array
        The measured targets.
    diverging : (S, W) array of bool, or None
        The steps at which the sampler's trajectory diverged, where it has such.
    row_log_likelihood : (S, W, R) array, or None
        The log-likelihood of each row, where a local model gives it and it is small.
    """

    over: Literal["parameters", "distribution"]
    unknowns: tuple[str, ...]
    diagnostics: PosteriorDiagnostics
    chain: Array
    log_density: Array
    observed: Array
    diverging: NDArray[np.bool_] | None = None
    row_log_likelihood: Array | None = None
    keys = ("over", "unknowns", "posterior")
    array_names = ("chain", "log_density", "diverging", "row_log_likelihood", "observed")

    def to_json(self) -> dict[str, Any]:
        columns = {key: numbers_or_null(found) for key, found in vars(self.diagnostics).items()}
        return {"over": self.over, "unknowns": list(self.unknowns), "posterior": columns}

    def to_arrays(self) -> dict[str, Array]:
        kept = {name: getattr(self, name) for name in self.array_names}
        return {name: array for name, array in kept.items() if array is not None}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], arrays: Mapping[str, Any]) -> Self:
        columns = {key: numbers_or_nan(found) for key, found in content["posterior"].items()}
        return cls(
            over=content["over"],
            unknowns=tuple(content["unknowns"]),
            diagnostics=PosteriorDiagnostics(**columns),
            chain=arrays["chain"],
            log_density=arrays["log_density"],
            observed=arrays["observed"],
            diverging=arrays.get("diverging"),
            row_log_likelihood=arrays.get("row_log_likelihood"),
        )
