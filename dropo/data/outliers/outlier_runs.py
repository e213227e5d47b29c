"""Runs that disagree with the others: another payload, another machine, a joint that was warm."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array, float_array, require
from dropo.data.outliers.disturbances import cut
from dropo.data.outliers.robust_fit import robust_fit

LEVEL = 0.001  # false alarms over all runs and parameters
# blocks of time whose scores are independent, within a run; windows of a run at least
BLOCKS = 20
FEWEST = 8
RUNS = 4  # that are compared at least
WINDOWS = 200  # of a run that its own fit sees


@dataclass(frozen=True)
class OutlierRun:
    """A run whose own value of a parameter lies outside of what the others, spread and all, leave
    room for. run: its group or trajectory; held_out: of those held out.
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
        return (
            f"{name} disagrees with the others: its {self.parameter} is {self.value:.4g} "
            f"+- {self.se:.2g}{unit}, theirs"
            f" {self.others:.4g} with a spread of {self.spread:.2g} (p = {self.p_value:.1g})"
        )


@dataclass(frozen=True, eq=False)
class Runs:
    """Each run's own values (n, d) and standard errors (n, d), inf where it says nothing; `number`
    (n,) of the runs; those that are odd.
    """

    number: Ints
    values: Array
    errors: Array
    odd: tuple[OutlierRun, ...]

    def __str__(self) -> str:
        return "\n".join(map(str, self.odd)) if self.odd else f"The {len(self.number)} runs agree."


def compare_runs(
    simulator: Simulator,
    trajectories: Trajectories,
    values: Array,
    step: float,
    *,
    seconds: float = 0.1,
) -> Runs:
    """Each run's own parameters around the common ones (d,), and the runs that differ from the
    rest; step: of the control [s].

    A run is a group of the data, or a trajectory where there are none. A run is odd in a parameter
    where a Student t test of it against all others says so; their own spread counts (DerSimonian
    and Laird 1986), so that among runs that all differ none is. The most odd one is taken out
    before the rest is tested again. Leave disturbances out first.
    """
    value = float_array("values", values, (len(simulator.space),), "compare_runs")
    label = trajectories.group if trajectories.group is not None else trajectories.trajectory
    runs = [(int(run), trajectories.rows(np.flatnonzero(label == run))) for run in np.unique(label)]
    length = max(1, round(seconds / step))
    runs = [
        (run, data)
        for run, data in runs
        if max(b - a for a, b in data.spans) >= length and len(cut(data, length)) >= FEWEST
    ]
    require(
        len(runs) >= RUNS,
        "trajectories",
        f"of at least {RUNS} runs of {FEWEST} windows",
        len(runs),
        "compare_runs",
    )
    own = [_own(simulator, data, value, length) for _, data in runs]
    number = np.array([run for run, _ in runs], dtype=np.int64)
    found, errors = (np.array(part) for part in zip(*own, strict=True))
    odd = [
        one
        for i in range(len(value))
        for one in _odd(number, found[:, i], errors[:, i], i, simulator)
    ]
    return Runs(number, found, errors, tuple(sorted(odd, key=lambda one: one.p_value)))


def _own(
    simulator: Simulator, data: Trajectories, value: Array, length: int
) -> tuple[Array, Array]:
    """A run's values and their standard errors: a robust fit to its windows, errors from the scores
    of blocks of time.
    """
    windows = cut(data, length)
    width = simulator.space.high - simulator.space.low
    fit = robust_fit(simulator, windows.take(windows.thin(WINDOWS)), value, beyond=True)
    blocks = np.array(
        [part.sum(axis=0) for part in np.array_split(fit.scores, min(BLOCKS, len(fit.scores)))]
    )
    blocks = blocks - blocks.mean(axis=0)
    covariance = fit.inverse @ (blocks.T @ blocks) @ fit.inverse * len(blocks) / (len(blocks) - 1)
    silent = np.diagonal(fit.information) * np.diagonal(fit.inverse) < 1e-3
    return fit.value, np.where(silent, np.inf, width * np.sqrt(np.diagonal(covariance)))


def _odd(
    number: Ints, values: Array, errors: Array, place: int, simulator: Simulator
) -> list[OutlierRun]:
    """The runs that are odd in one parameter, the most odd first."""
    parameter = simulator.space.parameters[place]
    left = np.isfinite(errors)
    out = []
    tests = int(left.sum()) * len(simulator.space)
    while left.sum() >= RUNS:
        found = [
            (i, *_against(values[i], errors[i], values[rest], errors[rest]))
            for i in np.flatnonzero(left).tolist()
            for rest in [_but(left, i)]
        ]
        i, mean, spread, p_value = min(found, key=lambda one: one[3])
        if p_value > LEVEL / tests:
            break
        out.append(
            OutlierRun(
                int(number[i]),
                parameter.name,
                parameter.unit,
                float(values[i]),
                float(errors[i]),
                mean,
                spread,
                p_value,
            )
        )
        left[i] = False
    return out


def _but(left: NDArray[np.bool_], i: int) -> Ints:
    return np.array([j for j in np.flatnonzero(left) if j != i], dtype=np.int64)


def _against(
    value: float, error: float, others: Array, errors: Array
) -> tuple[float, float, float]:
    """The others' mean and spread, and the p-value of one more of them."""
    w = 1 / np.maximum(errors, 1e-300) ** 2
    mean = float(w @ others / w.sum())
    excess = float(w @ (others - mean) ** 2) - (len(others) - 1)
    between = max(0.0, excess / float(w.sum() - (w @ w) / w.sum()))
    w = 1 / (errors**2 + between)
    mean = float(w @ others / w.sum())
    own = error**2
    rest = between + 1 / float(w.sum())
    degrees = (own + rest) ** 2 / (
        own**2 / (BLOCKS - 1) + rest**2 / (len(others) - 1)
    )  # Welch and Satterthwaite
    return (
        mean,
        float(np.sqrt(between)),
        float(2 * student_t.sf(abs(value - mean) / np.sqrt(own + rest), degrees)),
    )
