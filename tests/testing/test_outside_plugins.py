"""Plug-ins written outside the package, about twenty lines each: they pass the shipped checks and
are found by name.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import t

from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services import registry as catalogue
from dropo.core.services.errors import UnknownName
from dropo.testing import check_family, check_likelihood, check_optimizer, check_simulator
from tests.models.triangle import Triangle


@dataclass(frozen=True)
class StudentT(SampledLikelihood):
    """Independent Student's t of `dof` degrees of freedom in (y - mean) / sqrt(variance + epsilon),
    for outliers in the data.
    """

    dof: float = 4.0

    def _log_density(self, predictions, targets, epsilon, noise):
        scale = np.sqrt(predictions.var(axis=0, ddof=1) + epsilon)  # (R, p)
        return (
            t.logpdf((targets - predictions.mean(axis=0)) / scale, self.dof) - np.log(scale)
        ).sum(axis=1)


class Cooling(Simulator):
    """Newton's cooling towards the room, T' = -(T - u) / tau, exactly over dt: pure Python, one
    segment after the other.
    """

    space = ParameterSpace((Parameter("tau", 0.5, 5.0, "s"),))
    signals = (Signal("temperature", "K"),)

    def _predict(self, values, segments, offsets):
        starts = np.broadcast_to(segments.starts, (len(values), *segments.starts.shape)) + (
            0.0 if offsets is None else offsets
        )
        return np.array([self._one(tau, starts[k], segments) for k, (tau,) in enumerate(values)])

    def _one(self, tau, starts, segments, dt=0.1):
        steps = np.full(segments.steps.shape, np.nan)
        for n, (length, actions) in enumerate(zip(segments.lengths, segments.actions, strict=True)):
            chained = segments.previous[n] >= 0 and not segments.set_columns[0]
            temperature = (
                steps[segments.previous[n], segments.lengths[segments.previous[n]] - 1]
                if chained
                else starts[n, 0]
            )
            for j in range(length):
                temperature = actions[j, 0] + (temperature - actions[j, 0]) * math.exp(-dt / tau)
                steps[n, j] = temperature
        return steps[segments.rows][:, None]


class RandomSearch(Optimizer):
    """Normal steps around the best point so far, which shrink slowly."""

    asked = 0

    def _ask(self):
        self.asked += 1
        width = self.step / math.sqrt(1 + self.asked / (10 * self.dimension))
        steps = self.rng.standard_normal((8, self.dimension)) * self.rng.random((8, 1))
        return np.clip(self.best[0] + width * steps, 0.0, 1.0)

    def _tell(self, points, costs, gradients):
        pass

    def _stop(self):
        return (
            f"Its {self.budget} evaluations are spent." if 8 * self.asked >= self.budget else None
        )


def cooling():
    """The problem of that simulator: two measured trajectories of five rows."""
    rng = np.random.default_rng(0)
    start = rng.uniform(300, 350, (10, 1))
    room = rng.uniform(280, 300, (10, 1))
    after = room + (start - room) * math.exp(-0.1 / 2.0)
    return Problem(
        "cooling",
        Cooling(),
        Trajectories(start, room, after, np.isin(np.arange(10), [4, 9])),
        truth={"tau": 2.0},
    )


@pytest.fixture(autouse=True)
def _fresh_catalogue(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(catalogue, "_registered", {kind: {} for kind in catalogue.BUILT_IN})


@pytest.mark.parametrize(
    ("kind", "name", "plugin"),
    [
        ("families", "triangle", Triangle),
        ("likelihoods", "student-t", StudentT),
        ("problems", "cooling", cooling),
        ("optimizers", "random-search", RandomSearch),
        ("simulators", "cooling", Cooling),
    ],
)
def test_registered_plugins_are_found_by_name(kind, name, plugin):
    """Unknown before, listed and found after; a typo is corrected."""
    with pytest.raises(UnknownName):
        catalogue.find(kind, name)
    catalogue.register(kind, name, plugin)
    assert catalogue.find(kind, name) is plugin
    assert name in catalogue.names(kind)
    with pytest.raises(UnknownName, match=f"Did you mean '{name}'"):
        catalogue.find(kind, name + "s")


def test_family_passes():
    """The family keeps to the contract."""
    check_family(Triangle)


def test_likelihood_passes():
    """The likelihood keeps to the contract."""
    check_likelihood(StudentT())
    check_likelihood(StudentT(dof=2.5))


@pytest.mark.parametrize(
    "cut",
    [
        {},
        {"horizon": 2},
        {"reset": "start"},
        {"horizon": 2, "reset": "partial", "set_columns": [False]},
    ],
)
def test_simulator_passes(cut):
    """The simulator keeps to the contract, on segments of every kind."""
    problem = cooling()
    check_simulator(problem.simulator, problem.trajectories.segments(**cut))
    np.testing.assert_allclose(
        problem.simulator.predict([[2.0]], problem.segments)[0], problem.segments.targets
    )


def test_optimizer_finds_a_bowl():
    """The optimizer gets within 0.02 of the least point of a bowl in three dimensions, and stops
    with a reason.
    """
    optimizer = RandomSearch(3, np.random.default_rng(0), budget=2000)
    least = np.array([0.2, 0.5, 0.7])
    while optimizer.stop() is None:
        points = optimizer.ask()
        optimizer.tell(points, ((points - least) ** 2).sum(axis=1))
    np.testing.assert_allclose(optimizer.best[0], least, atol=0.02)
    assert "2000 evaluations" in optimizer.stop()


def test_optimizer_passes():
    """The optimizer keeps to the contract."""
    check_optimizer(RandomSearch)
