"""Runs that disagree with the others: another payload, another machine, a joint that was warm."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.gauss_newton import ReweightingSettings
from dropo.core.numerics.tails import student_tail
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.data.outliers.disturbances import cut
from dropo.data.outliers.robust_fit import robust_fit


@dataclass(frozen=True)
class OutlierRunSettings:
    """How runs are compared.

    Attributes
    ----------
    level : float
        False alarms over all runs and parameters.
    blocks : int
        Blocks of time within a run whose scores count as independent.
    fewest_windows : int
        Windows of a run below which it is not compared.
    fewest_runs : int
        Runs that are compared at least.
    windows : int
        Windows of a run that its own fit uses, at most.
    fitting : ReweightingSettings
        How that fit steps.
    """

    level: float = 0.001
    blocks: int = 20
    fewest_windows: int = 8
    fewest_runs: int = 4
    windows: int = 200
    fitting: ReweightingSettings = field(default_factory=ReweightingSettings)


SETTINGS = OutlierRunSettings()


@dataclass(frozen=True)
class OutlierRun:
    """A run whose own value of a parameter lies outside of the others' distribution.

    Attributes
    ----------
    run : int
        Its group or trajectory.
    parameter, unit : str
        Which parameter.
    value, se : float
        The run's own value and its standard error.
    others, spread : float
        The mean of the other runs, and the standard deviation between them.
    p_value : float
        Of one run that belongs to the others.
    held_out : bool
        Whether the run is one of those held out.
    """

    run: int
    parameter: str
    unit: str
    value: float
    se: float
    others: float
    spread: float
    p_value: float
    held_out: bool = False

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        name = f"{'held-out ' * self.held_out}run {self.run}"
        own = f"{self.value:.4g} +- {self.se:.2g}{unit}"
        others = f"{self.others:.4g} with a spread of {self.spread:.2g}"
        return (
            f"{name} disagrees with the others: its {self.parameter} is {own}, theirs {others}"
            f" (p = {self.p_value:.1g})"
        )


@dataclass(frozen=True, eq=False)
class ComparedRuns:
    """The parameters of each of n runs by itself.

    Attributes
    ----------
    number : (n,) int array
        Each run's group or trajectory.
    values : (n, d) array
        Its own values.
    errors : (n, d) array
        Their standard errors; infinite where the run says nothing of a parameter.
    outliers : tuple of OutlierRun
        The runs that disagree with the others, the most unlikely first.
    """

    number: Ints
    values: Array
    errors: Array
    outliers: tuple[OutlierRun, ...]

    def __str__(self) -> str:
        if not self.outliers:
            return f"The {len(self.number)} runs agree."
        return "\n".join(map(str, self.outliers))


def compare_runs(
    simulator: Simulator,
    trajectories: Trajectories,
    values: Array,
    step: float,
    *,
    seconds: float = 0.1,
    settings: OutlierRunSettings = SETTINGS,
) -> ComparedRuns:
    """Estimate each run's own parameters, and find the runs that differ from the rest.

    In each parameter, a run is compared with all others by a Student t test that allows for their
    own spread [1]_, so that among runs that all differ there is no outlier. The most unlikely run
    is taken out before the rest is tested again. Leave disturbances out first.

    Parameters
    ----------
    simulator : Simulator
        With d parameters.
    trajectories : Trajectories
        A run is a group of the data, or a trajectory where there are no groups.
    values : (d,) array
        The common parameters, around which those of each run are sought.
    step : float
        Of the control [s].
    seconds : float
        Horizon of the windows that are fitted [s].
    settings : OutlierRunSettings
        How runs are compared.

    Returns
    -------
    ComparedRuns

    Raises
    ------
    BadArgument
        If there are not d values, or fewer runs than are needed that are long enough.

    References
    ----------
    .. [1] DerSimonian and Laird, Controlled Clinical Trials 7, 1986.
    """
    common = float_array("values", values, (len(simulator.space),), "compare_runs")
    length = max(1, round(seconds / step))
    label = trajectories.trajectory if trajectories.group is None else trajectories.group

    # The runs that are long enough.
    numbers = []
    runs = []
    for run in np.unique(label):
        data = trajectories.rows(np.flatnonzero(label == run))
        longest = max(stop - start for start, stop in data.spans)
        if longest >= length and len(cut(data, length)) >= settings.fewest_windows:
            numbers.append(int(run))
            runs.append(data)
    needed = f"of at least {settings.fewest_runs} runs of {settings.fewest_windows} windows"
    enough = len(runs) >= settings.fewest_runs
    require(enough, "trajectories", needed, len(runs), "compare_runs")

    # Each run by itself.
    fits = [fit_run(simulator, data, common, length, settings) for data in runs]
    number = np.array(numbers, dtype=np.int64)
    found = np.array([fit.value for fit in fits])
    errors = np.array([fit.errors for fit in fits])

    # Each parameter by itself.
    outliers: list[OutlierRun] = []
    for i in range(len(common)):
        outliers += _outliers(number, found[:, i], errors[:, i], i, simulator, settings)
    outliers.sort(key=lambda run: run.p_value)
    return ComparedRuns(number, found, errors, tuple(outliers))


@dataclass(frozen=True, eq=False)
class SingleRunFit:
    """The parameters of one run by itself.

    Attributes
    ----------
    value : (d,) array
        Its values.
    covariance : (d, d) array
        Of their errors, from the scores of blocks of time.
    silent : (d,) array of bool
        The parameters of which the run says nothing.
    """

    value: Array
    covariance: Array
    silent: NDArray[np.bool_]

    @property
    def errors(self) -> Array:
        """Standard errors (d,); infinite where the run says nothing of a parameter."""
        return np.where(self.silent, np.inf, np.sqrt(np.diagonal(self.covariance)))


def fit_run(
    simulator: Simulator,
    data: Trajectories,
    common: Array,
    length: int,
    settings: OutlierRunSettings = SETTINGS,
) -> SingleRunFit:
    """Fit the parameters to one run by itself, robustly.

    Parameters
    ----------
    simulator : Simulator
        With d parameters.
    data : Trajectories
        The run.
    common : (d,) array
        Where the fit begins.
    length : int
        Control steps in a window.
    settings : OutlierRunSettings
        How many windows and blocks there are.

    Returns
    -------
    SingleRunFit

    Raises
    ------
    SimulationFailed
        If there is nothing to start from.
    """
    windows = cut(data, length)
    width = simulator.space.high - simulator.space.low
    chosen = windows.take(windows.thin(settings.windows))
    fit = robust_fit(simulator, chosen, common, beyond=True, settings=settings.fitting)
    pieces = np.array_split(fit.scores, min(settings.blocks, len(fit.scores)))
    blocks = np.array([piece.sum(axis=0) for piece in pieces])
    blocks = blocks - blocks.mean(axis=0)
    # A product with its own transpose: no variance is below 0, however singular the information is.
    moved = blocks @ fit.inverse.T
    covariance = moved.T @ moved * len(blocks) / (len(blocks) - 1)
    # The prior, not the run, determines parameters without information.
    silent = np.diagonal(fit.information) * np.diagonal(fit.inverse) < 1e-3
    return SingleRunFit(fit.value, covariance * np.outer(width, width), silent)


def _outliers(
    number: Ints,
    values: Array,
    errors: Array,
    place: int,
    simulator: Simulator,
    settings: OutlierRunSettings,
) -> list[OutlierRun]:
    """The outlier runs in one parameter, the most unlikely first."""
    parameter = simulator.space.parameters[place]
    left = np.isfinite(errors)
    tests = int(left.sum()) * len(simulator.space)
    found = []
    while left.sum() >= settings.fewest_runs:
        # The run that fits the others least.
        candidates = []
        for i in np.flatnonzero(left).tolist():
            others = _without(left, i)
            mean, spread, p_value = _compare(
                values[i], errors[i], values[others], errors[others], settings.blocks
            )
            candidates.append((i, mean, spread, p_value))
        i, mean, spread, p_value = min(candidates, key=lambda candidate: candidate[3])
        if p_value > settings.level / tests:
            break
        outlier = OutlierRun(
            run=int(number[i]),
            parameter=parameter.name,
            unit=parameter.unit,
            value=float(values[i]),
            se=float(errors[i]),
            others=mean,
            spread=spread,
            p_value=p_value,
        )
        found.append(outlier)
        left[i] = False
    return found


def _without(left: NDArray[np.bool_], i: int) -> Ints:
    """The indices of all runs that are left but one."""
    indices: Ints = np.flatnonzero(left)
    return indices[indices != i]


def _compare(
    value: float, error: float, others: Array, errors: Array, blocks: int
) -> tuple[float, float, float]:
    """The others' mean and spread, and the p-value of one more of them."""
    # The variance between the others (DerSimonian and Laird 1986).
    w = 1 / np.maximum(errors, 1e-300) ** 2
    mean = float(w @ others / w.sum())
    excess = float(w @ (others - mean) ** 2) - (len(others) - 1)
    between = max(0.0, excess / float(w.sum() - (w @ w) / w.sum()))
    # Their mean with that variance, and one more value beside it.
    w = 1 / (errors**2 + between)
    mean = float(w @ others / w.sum())
    own = error**2
    rest = between + 1 / float(w.sum())
    # Degrees of freedom by Welch and Satterthwaite.
    degrees = (own + rest) ** 2 / (own**2 / (blocks - 1) + rest**2 / (len(others) - 1))
    t = abs(value - mean) / np.sqrt(own + rest)
    return mean, float(np.sqrt(between)), float(2 * student_tail(t, degrees))
