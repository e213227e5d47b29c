"""How often 95 % intervals hold the truth.

Under independent, autocorrelated and start-state noise, and with friction left out of the model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array, require
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.hopper.data import simulate as simulate_hopper
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.toy import SlidingBlock, simulate
from dropo.studies.engine.study import Study, Table
from dropo.studies.engine.work import Work

RHO = 0.9  # autocorrelation of the autocorrelated noise from one control step to the next
NOISE = 5e-3  # standard deviation, in each signal's unit
DRY = 0.3  # [N] the friction that the model leaves out
BLOCK = np.array([1.5, 0.8])  # [kg], [N s/m]
FEW = (2, 500)
"""Trajectories, and control steps of each: few long ones."""
MANY = (25, 40)
"""Trajectories, and control steps of each: many short ones."""

METHODS: dict[str, Callable[[], Estimator]] = {
    "least squares": LeastSquares,
    "dropo": lambda: DROPO(likelihood="emulated", family="point", epsilon="learn"),
}
Case = tuple[str, str, str, tuple[int, int]]
"""Robot, noise, method, and the data's size."""
CASES: tuple[Case, ...] = (
    ("block", "independent", "least squares", MANY),
    ("block", "independent", "least squares", FEW),
    ("block", "independent", "dropo", MANY),
    ("block", "autocorrelated", "least squares", MANY),
    ("block", "autocorrelated", "least squares", FEW),
    ("block", "autocorrelated", "dropo", MANY),
    ("block", "start", "dropo", MANY),
    ("block", "start", "dropo", FEW),
    ("hopper", "independent", "dropo", MANY),
    ("hopper", "autocorrelated", "dropo", MANY),
    ("block", "dry friction", "least squares", MANY),
    ("block", "dry friction", "least squares", FEW),
    ("block", "dry friction", "dropo", MANY),
)
"""The cases; "dry friction" is independent noise, and friction that the model does not have."""


@dataclass(frozen=True)
class CoverageSettings:
    """How large the study is, and which coverage is accepted.

    Attributes
    ----------
    replications : int
        Data sets of each case.
    accepted : (float, float)
        Bounds of the coverage of 95 % intervals, outside of which a remark says so.
    """

    replications: int = 100
    accepted: tuple[float, float] = (0.90, 0.98)


DEFAULT = CoverageSettings()


class DryBlock(SlidingBlock):
    """The sliding block with Coulomb friction beside the viscous one, solved exactly.

    It slides one way until it stops; then it stays if the push is weaker than the friction, or
    slides the other way.
    """

    def _replay(self, value: Array, starts: Array, actions: Array) -> Array:
        """States behind each control step, for one parameter vector."""
        mass, damping = value
        lag = mass / damping
        out = np.empty((*actions.shape[:2], 2))
        x, v = starts.T
        for j, force in enumerate(actions[:, :, 0].T):
            # Until the end of the step, or until the block stops.
            final = (force - DRY * np.sign(v)) / damping
            duration = np.where(v == 0, 0.0, np.minimum(_stop_time(v, final, lag), self.dt))
            x, v = _slide(x, v, final, lag, duration)
            stopped = duration < self.dt
            v = np.where(stopped, 0.0, v)
            # The rest of the step, from rest.
            restart = np.sign(force) * np.maximum(np.abs(force) - DRY, 0.0) / damping
            x, v = _slide(x, v, np.where(stopped, restart, v), lag, self.dt - duration)
            out[:, j] = np.stack([x, v], axis=-1)
        return out


def _stop_time(v: Array, final: Array, lag: float) -> Array:
    """When a velocity that approaches a final one of the other sign is 0; infinity if it is not."""
    turns = v * final < 0
    ratio = np.where(turns, -v / np.where(turns, final, 1.0), 0.0)
    return np.where(turns, lag * np.log1p(ratio), np.inf)


def _slide(x: Array, v: Array, final: Array, lag: float, time: Array) -> tuple[Array, Array]:
    """Position and velocity after a time, towards a final velocity with a time constant."""
    decay = np.exp(-time / lag)
    return x + final * time + (v - final) * (1 - decay) * lag, final + (v - final) * decay


def coverage(
    work: Work,
    seeds: int | None = None,
    *,
    cases: tuple[Case, ...] = CASES,
    settings: CoverageSettings = DEFAULT,
) -> Study:
    """How often 95 % intervals hold the truth, and how often a fit says that its model is wrong.

    Parameters
    ----------
    work : Work
        Runs the replications.
    seeds : int or None
        Data sets of each case; None for the settings' number.
    cases : tuple of Case
        Robot, noise, method, and the data's size.
    settings : CoverageSettings
        The number of data sets, and which coverage is accepted.

    Returns
    -------
    Study
        The coverage of each case.

    Raises
    ------
    BadArgument
        If `seeds` is below 2, or there is no such noise.
    """
    count = settings.replications if seeds is None else seeds
    require(count >= 2, "seeds", "at least 2", count, "coverage")
    items = []
    for robot, noise, method, shape in cases:
        items += [[robot, noise, method, list(shape), seed] for seed in range(count)]
    answers = work.map(replication, items)
    rows = []
    data = {}
    remarks = []
    low, high = settings.accepted
    for i, (robot, noise, method, (trajectories, steps)) in enumerate(cases):
        own = answers[i * count : (i + 1) * count]
        inside = np.array([answer["inside"] for answer in own])
        flagged = float(np.mean([answer["flagged"] for answer in own]))
        each = inside.mean(axis=0)
        errors = np.sqrt(each * (1 - each) / count)
        shown = ", ".join(f"{c:.0%} ± {e:.0%}" for c, e in zip(each, errors, strict=True))
        extent = f"{trajectories} x {steps}"
        rows.append(
            (f"{robot}, {noise}", extent, method, shown, f"{inside.mean():.1%}", f"{flagged:.0%}")
        )
        name = f"{robot}, {noise}, {method}, {extent}"
        sentences = {sentence for answer in own for sentence in answer["sentences"]}
        data[name] = {"coverage": each, "flagged": flagged, "sentences": sorted(sentences)}
        if noise != "dry friction" and not low <= inside.mean() <= high:
            remarks.append(f"{name}: {inside.mean():.1%} is not within {low:.0%} to {high:.0%}.")
    remarks.append(
        f"With a dry friction of {DRY} N left out the intervals cannot hold; the last "
        "column is how often the fit says so."
    )
    header = (
        "data",
        "trajectories",
        "method",
        "coverage of each mean",
        "of all",
        "said to be wrong",
    )
    return Study(
        "coverage",
        f"Coverage of 95 % intervals, {count} data sets each",
        (Table("Intervals of 95 %", header, tuple(rows)),),
        tuple(remarks),
        data,
    )


def replication(item: list[Any]) -> dict[str, Any]:
    """One data set and its fit.

    Parameters
    ----------
    item : list
        Robot, noise, method, the data's size, and the seed.

    Returns
    -------
    dict
        inside: whether each mean's interval holds the truth; flagged: whether the fit does not
        trust its model; sentences: what it says of that.
    """
    robot, noise, method, (count, steps), seed = item
    problem, truth = data_set(robot, noise, count, steps, np.random.default_rng([seed, count]))
    fit = METHODS[method]().fit(problem, rng=seed)
    low, high = fit.interval().T
    sentences = [text for text in fit.warnings if text.startswith("the model is wrong")]
    return {
        "inside": ((low <= truth) & (truth <= high)).tolist(),
        "flagged": fit.trusted is False,
        "sentences": sentences,
    }


def data_set(
    robot: str, noise: str, count: int, steps: int, rng: np.random.Generator
) -> tuple[Problem, Array]:
    """Simulates the data of one case.

    Parameters
    ----------
    robot : str
        "block" or "hopper".
    noise : str
        "independent", "autocorrelated", "start" or "dry friction".
    count : int
        Number of trajectories.
    steps : int
        Control steps of each.
    rng : numpy.random.Generator
        Source of forces and noise.

    Returns
    -------
    problem : Problem
        The problem on these data.
    truth : (d,) array
        True parameters.

    Raises
    ------
    BadArgument
        If there is no such noise.
    """
    known = ("independent", "autocorrelated", "start", "dry friction")
    require(noise in known, "noise", f"one of {known}", noise, "data_set")
    model: Any
    if robot == "block":
        model = SlidingBlock()
        truth = BLOCK
        forces = np.repeat(rng.normal(0.0, 3.0, (count, -(-steps // 5), 1)), 5, axis=1)[:, :steps]
        simulator = DryBlock() if noise == "dry friction" else SlidingBlock()
        clean = simulate(simulator, np.tile(truth, (count, 1)), forces, np.zeros(2))
    else:
        model = hopper_simulator(threads=1)
        truth = np.array([TRUTH[name] for name in model.space.names])
        clean, _ = simulate_hopper(steps, count, rng=rng)
    before = clean.observations
    after = clean.next_observations
    shape = (count, steps, after.shape[1])
    if noise == "start":
        # A measured state is the end of one step and the start of the next, with one error.
        errors = NOISE * rng.standard_normal((count, steps + 1, before.shape[1]))
        before = before + errors[:, :-1].reshape(before.shape)
        after = after + errors[:, 1:].reshape(after.shape)
    elif noise == "autocorrelated":
        after = after + autocorrelated(shape, rng).reshape(after.shape)
    else:
        after = after + (NOISE * rng.standard_normal(shape)).reshape(after.shape)
    data = Trajectories(before, clean.actions, after, clean.terminals)
    return Problem(f"{robot}, {noise}", model, data, start_noise=noise == "start"), truth


def autocorrelated(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """Errors of a stationary first-order autoregression along the control steps.

    Parameters
    ----------
    shape : (int, int, int)
        Trajectories, control steps, signals.
    rng : numpy.random.Generator
        Source of the errors.

    Returns
    -------
    array
        Of that shape, with standard deviation `NOISE` and correlation `RHO` of neighbours.
    """
    errors = NOISE * rng.standard_normal(shape)
    for t in range(1, shape[1]):
        errors[:, t] = RHO * errors[:, t - 1] + np.sqrt(1 - RHO**2) * errors[:, t]
    return errors
