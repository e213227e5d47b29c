"""Where a search begins in a wide box, and under likelihoods with several maxima."""

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Trajectories
from dropo.estimators import dropo as method
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.first_mean.descent import descend
from dropo.estimators.support.first_mean.global_search import best_start
from dropo.estimators.support.first_mean.misfit import Misfit
from dropo.simulators.function import FunctionSimulator

DT = 0.05  # [s]
TRUTH = np.array([7.0, 0.15])  # [rad/s], [1/s]


def swing(value, starts, actions, unit=10.0):
    """A damped oscillation in closed form: position, and velocity over a frequency [rad/s]."""
    frequency, damping = value
    time = DT * np.arange(1, actions.shape[1] + 1)
    decay = np.exp(-damping * time)
    cos, sin = decay * np.cos(frequency * time), decay * np.sin(frequency * time)
    x, v = starts[:, :1], unit / frequency * starts[:, 1:]
    return np.stack([x * cos + v * sin, (v * cos - x * sin) * frequency / unit], axis=2)


def oscillation(horizon=40, noise=1e-3, seed=0, damped=True):
    """Segments of an oscillator, of which only the ends are compared, in a box of decades."""
    rng = np.random.default_rng(seed)
    parameters = [Parameter("frequency", 0.5, 100.0, "rad/s"), Parameter("damping", 0.01, 2.0)]
    if not damped:
        parameters = parameters[:1]

    def function(value, starts, actions):
        if damped:
            return swing(value, starts, actions)
        return swing((value[0], 0.0), starts, actions, unit=value[0])

    simulator = FunctionSimulator(function, parameters, ["x", "v"])
    truth = TRUTH if damped else TRUTH[:1]
    starts = rng.normal(0, 1, (12, 2))
    states = simulator._replay(truth, starts, np.zeros((12, 120, 1)))
    states = np.concatenate([starts[:, None], states], axis=1)
    states = states + noise * rng.standard_normal(states.shape)
    ends = np.tile(np.arange(120) == 119, 12)
    before, after = states[:, :-1].reshape(-1, 2), states[:, 1:].reshape(-1, 2)
    data = Trajectories(before, np.zeros((len(before), 1)), after, ends)
    return Problem("oscillation", simulator, data, horizon=horizon)


def starts_of(problem, count, seed):
    """Random starts, uniform over the box."""
    space = problem.space
    return space.low + np.random.default_rng(seed).random((count, len(space))) * (
        space.high - space.low
    )


def is_right(value):
    """Whether the frequency is the true one, and no other that ends alike."""
    return abs(value[0] / TRUTH[0] - 1) < 0.02


def test_every_start_leads_to_the_best_optimum():
    """From 20 random starts in a box of decades; most descents without the stage end elsewhere."""
    problem = oscillation()
    starts = starts_of(problem, 20, 1)
    found = [best_start(problem, Run(problem, np.random.default_rng(0)), start) for start in starts]
    assert sum(is_right(each.best) for each in found) == 20

    misfit = Misfit(problem, Run(problem, np.random.default_rng(0)), problem.segments)
    alone = misfit.values_of(descend(misfit, misfit.unit_of(starts))[0])
    assert sum(is_right(value) for value in alone) < 10


def test_a_fit_ends_there(monkeypatch):
    """The fit from a bad start ends in the truth; without the stage it does not."""
    problem = oscillation()
    start = (60.0, 1.5)
    fit = DROPO(family="point", start=start).fit(problem, rng=0)
    assert is_right(fit.mean)
    assert not fit.warnings

    monkeypatch.setattr(method, "is_wide", lambda space: False)
    monkeypatch.setattr(method, "may_have_several", lambda problem: False)
    assert not is_right(DROPO(family="point", start=start).fit(problem, rng=0).mean)


def test_optima_that_the_data_cannot_tell_apart_are_named():
    """Of an undamped oscillation that is compared after equal times; not where times are short."""
    fit = DROPO(family="point").fit(oscillation(damped=False, noise=0.02), rng=0)
    assert any("two optima explain the data alike, frequency" in text for text in fit.warnings)
    short = DROPO(family="point").fit(oscillation(1, damped=False, noise=0.02), rng=0)
    assert not any("optima" in text for text in short.warnings)


def test_a_start_that_leads_there_is_kept():
    """A start near the best optimum is not moved: rounds of the fit find it themselves."""
    problem = oscillation(1)
    near = TRUTH * [1.05, 0.9]
    run = Run(problem, np.random.default_rng(0))
    np.testing.assert_array_equal(best_start(problem, run, near).value, near)
    far = np.array([90.0, 1.9])
    assert is_right(best_start(problem, run, far).value)


@pytest.mark.parametrize("low", [-50.0, 0.0])
def test_boxes_that_are_not_positive(low):
    """Are searched as they are; points and parameters are each other's inverse."""
    parameters = [Parameter("a", low, 100.0), Parameter("b", 0.1, 100.0)]
    simulator = FunctionSimulator(lambda v, s, a: s[:, None] + v[0] * a, parameters, ["y"])
    data = Trajectories(np.zeros((20, 1)), np.ones((20, 1)), 3 * np.ones((20, 1)), np.ones(20))
    problem = Problem("line", simulator, data)
    misfit = Misfit(problem, Run(problem, np.random.default_rng(0)), problem.segments)
    unit = np.random.default_rng(2).random((50, 2))
    values = misfit.values_of(unit)
    np.testing.assert_allclose(misfit.unit_of(values), unit, atol=1e-12)
    assert np.median(values[:, 1]) < 10 < np.median(values[:, 0] - low)
    found = best_start(problem, Run(problem, np.random.default_rng(0)), np.array([90.0, 50.0]))
    assert found.best[0] == pytest.approx(3, rel=1e-3)
