"""Runs that disagree with the others: another payload, another machine, a joint that was warm."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from dropo.analysis.disturbances import cut
from dropo.core.checks import Array, float_array, require
from dropo.core.data import Ints, Trajectories
from dropo.core.simulator import Simulator

LEVEL = 0.001  # false alarms over all runs and parameters
BLOCKS, FEWEST = 20, 8  # blocks of time whose scores are independent, within a run; windows of a run at least
RUNS = 4  # that are compared at least
ROUNDS = 4  # of a run's own Gauss-Newton steps from the common values


@dataclass(frozen=True)
class OddRun:
    """A run whose own value of a parameter lies outside of what the others, spread and all, leave room for."""

    run: int
    parameter: str
    unit: str
    value: float
    se: float
    others: float
    spread: float
    p_value: float

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"run {self.run} disagrees with the others: its {self.parameter} is {self.value:.4g} +- {self.se:.2g}{unit}, theirs"
            f" {self.others:.4g} with a spread of {self.spread:.2g} (p = {self.p_value:.1g})"
        )


@dataclass(frozen=True, eq=False)
class Runs:
    """Each run's own values (n, d) and standard errors (n, d), inf where it says nothing; `number` (n,) of the runs; those that are odd."""

    number: Ints
    values: Array
    errors: Array
    odd: tuple[OddRun, ...]

    def __str__(self) -> str:
        return "\n".join(map(str, self.odd)) if self.odd else f"The {len(self.number)} runs agree."


def compare_runs(simulator: Simulator, trajectories: Trajectories, values: Array, step: float, *, seconds: float = 0.1) -> Runs:
    """Each run's own parameters around the common ones (d,), and the runs that differ from the rest; step: of the control [s].

    A run is a group of the data, or a trajectory where there are none. A run is odd in a parameter where a Student t test
    of it against all others says so; their own spread counts (DerSimonian and Laird 1986), so that among runs that all differ
    none is. The most odd one is taken out before the rest is tested again. Leave disturbances out first.
    """
    value = float_array("values", values, (len(simulator.space),), "compare_runs")
    label = trajectories.group if trajectories.group is not None else trajectories.trajectory
    runs = [(int(run), trajectories.rows(np.flatnonzero(label == run))) for run in np.unique(label)]
    length = max(1, round(seconds / step))
    runs = [(run, data) for run, data in runs if max(b - a for a, b in data.spans) >= length and len(cut(data, length)) >= FEWEST]
    require(len(runs) >= RUNS, "trajectories", f"of at least {RUNS} runs of {FEWEST} windows", len(runs), "compare_runs")
    own = [_own(simulator, data, value, length) for _, data in runs]
    number = np.array([run for run, _ in runs], dtype=np.int64)
    found, errors = (np.array(part) for part in zip(*own, strict=True))
    odd = [one for i in range(len(value)) for one in _odd(number, found[:, i], errors[:, i], i, simulator)]
    return Runs(number, found, errors, tuple(sorted(odd, key=lambda one: one.p_value)))


def _own(simulator: Simulator, data: Trajectories, value: Array, length: int) -> tuple[Array, Array]:
    """A run's values and their standard errors: robust Gauss-Newton on its windows, errors from the scores of blocks of time."""
    windows, space = cut(data, length), simulator.space
    windows = windows.take(windows.spread_out(200))
    width, measured = space.high - space.low, simulator.targets(windows)
    for _ in range(ROUNDS):
        predicted, slopes = simulator.linearise(value, windows, step=1e-3 * width)
        errors = measured - predicted
        scale = np.maximum(1.4826 * np.median(np.abs(errors), axis=0), 1e-300)
        weights = 4 / (3 + np.mean((errors / scale) ** 2, axis=1))
        white, rest = slopes * width / scale[:, None], errors / scale
        information = np.einsum("w,wpd,wpe->de", weights, white, white)
        scores = weights[:, None] * np.einsum("wpd,wp->wd", white, rest)
        bread = np.linalg.inv(information + 1e-6 * np.eye(len(value)))  # a prior as wide as a thousand boxes
        value = np.clip(value + width * np.clip(bread @ scores.sum(axis=0), -0.25, 0.25), space.lower, space.upper)
    blocks = np.array([part.sum(axis=0) for part in np.array_split(scores, min(BLOCKS, len(scores)))])
    blocks = blocks - blocks.mean(axis=0)
    covariance = bread @ (blocks.T @ blocks) @ bread * len(blocks) / (len(blocks) - 1)
    silent = np.diagonal(information) * np.diagonal(bread) < 1e-3
    return value, np.where(silent, np.inf, width * np.sqrt(np.diagonal(covariance)))


def _odd(number: Ints, values: Array, errors: Array, place: int, simulator: Simulator) -> list[OddRun]:
    """The runs that are odd in one parameter, the most odd first."""
    parameter, left, out = simulator.space.parameters[place], np.isfinite(errors), []
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
        out.append(OddRun(int(number[i]), parameter.name, parameter.unit, float(values[i]), float(errors[i]), mean, spread, p_value))
        left[i] = False
    return out


def _but(left: NDArray[np.bool_], i: int) -> Ints:
    return np.array([j for j in np.flatnonzero(left) if j != i], dtype=np.int64)


def _against(value: float, error: float, others: Array, errors: Array) -> tuple[float, float, float]:
    """The others' mean and spread, and the p-value of one more of them."""
    w = 1 / np.maximum(errors, 1e-300) ** 2
    mean = float(w @ others / w.sum())
    excess = float(w @ (others - mean) ** 2) - (len(others) - 1)
    between = max(0.0, excess / float(w.sum() - (w @ w) / w.sum()))
    w = 1 / (errors**2 + between)
    mean = float(w @ others / w.sum())
    own, rest = error**2, between + 1 / float(w.sum())
    degrees = (own + rest) ** 2 / (own**2 / (BLOCKS - 1) + rest**2 / (len(others) - 1))  # Welch and Satterthwaite
    return mean, float(np.sqrt(between)), float(2 * student_t.sf(abs(value - mean) / np.sqrt(own + rest), degrees))
