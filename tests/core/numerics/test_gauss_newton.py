"""Gauss-Newton on problems whose answer is known: outliers, bounds, directions without data, and
steps that are too long.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dropo.core.numerics.gauss_newton import (
    GaussNewtonSettings,
    ReweightingSettings,
    damped_step,
    fit_reweighted,
    maximize,
)

SETTINGS = ReweightingSettings()
BOX = (np.zeros(2), np.full(2, 10.0))


class Lines:
    """Rows of y = a + b x with noise of 0.1, some of which are 20 off; counts its Jacobians."""

    def __init__(self, outliers, seed=0):
        rng = np.random.default_rng(seed)
        x = np.linspace(0, 1, 200)
        self.slopes = np.stack([np.ones(200), x], axis=1)
        self.measured = self.slopes @ [3.0, 5.0] + 0.1 * rng.normal(size=200)
        self.measured[:outliers] += 20.0
        self.differentiated = 0

    def errors(self, values):
        return (self.measured - values @ self.slopes.T)[..., None]

    def jacobian(self, value, close):
        self.differentiated += 1
        return self.slopes[:, None, :]


def test_outliers_count_for_little():
    """With a quarter of the rows 20 off, values are within 0.1 of the truth; equal weights, by very
    many degrees, are beyond 1.
    """
    start = np.array([1.0, 1.0])
    settings = replace(SETTINGS, maximum_step=1.0)
    found = fit_reweighted(Lines(50), start, BOX, np.ones(2), settings)
    np.testing.assert_allclose(found.value, [3, 5], atol=0.1)
    equal = fit_reweighted(Lines(50), start, BOX, np.ones(2), replace(settings, degrees=1e12))
    assert np.abs(equal.value - [3, 5]).max() > 1
    np.testing.assert_allclose(found.information @ found.inverse, np.eye(2), atol=1e-4)
    np.testing.assert_allclose(found.scores.sum(axis=0), 0, atol=1e-2 * np.abs(found.scores).sum())


def test_rows_without_noise_are_fitted_to_the_end():
    """Where most errors become 0 but for rounding, the outliers pull no more than before."""
    rows = Lines(20)
    rows.measured = rows.slopes @ [3.0, 5.0]
    rows.measured[:20] += 20.0
    found = fit_reweighted(rows, np.array([1.0, 1.0]), BOX, np.ones(2), SETTINGS)
    np.testing.assert_allclose(found.value, [3, 5], atol=1e-9)


def test_a_reweighted_fit_stays_in_the_box_and_takes_short_steps():
    """A bound below the truth is where it ends; no step is longer than a quarter of the width."""
    rows = Lines(0)
    tried = []

    def watched(values):
        tried.append(values[0])
        return Lines.errors(rows, values)

    rows.errors = watched
    box = (np.zeros(2), np.array([10.0, 4.0]))
    found = fit_reweighted(rows, np.full(2, 1.0), box, np.full(2, 4.0), SETTINGS)
    assert found.value[1] == 4.0
    assert np.abs(np.diff(tried, axis=0)).max() <= 1.0 + 1e-12
    assert rows.differentiated <= SETTINGS.steps.iterations


def test_a_reweighted_fit_of_bent_rows_ends_at_the_same_place_from_everywhere():
    """y = sin(a t) + b, a fifth of the rows off: from both sides to 1e-4; one step does not do."""
    t = np.linspace(0, 3, 300)
    noise = 0.01 * np.random.default_rng(3).normal(size=300)
    measured = np.sin(2.0 * t) + 0.5 + noise
    measured[100:160] += 3.0

    class Sines:
        def errors(self, values):
            return (measured - np.sin(values[:, :1] * t) - values[:, 1:])[..., None]

        def jacobian(self, value, close):
            return np.stack([t * np.cos(value[0] * t), np.ones(300)], axis=-1)[:, None, :]

    box = (np.array([0.0, -5.0]), np.array([10.0, 5.0]))

    def ends(settings):
        starts = ([1.2, 3.0], [2.9, -3.0])
        fits = [
            fit_reweighted(Sines(), np.array(start), box, np.full(2, 10.0), settings)
            for start in starts
        ]
        return [fit.value for fit in fits]

    first, second = ends(SETTINGS)
    np.testing.assert_allclose(first, second, atol=1e-4)
    np.testing.assert_allclose(first, [2.0, 0.5], atol=0.01)
    one_step = replace(SETTINGS, steps=replace(SETTINGS.steps, iterations=1), rounds=1)
    assert np.abs(np.subtract(*ends(one_step))).max() > 0.1


def test_a_damped_step_is_the_penalized_least_squares_solution():
    """Within the box that of the normal equations; at a bound the best of those allowed; the
    promise is what a linear model gains.
    """
    rng = np.random.default_rng(1)
    jacobian = rng.normal(size=(3, 40))
    residuals = rng.normal(size=40)
    prior_sd = np.array([0.5, 1.0, 2.0])
    free = (np.full(3, -10.0), np.full(3, 10.0))
    step, promised = damped_step(jacobian, residuals, free, prior_sd)
    normal = jacobian @ jacobian.T + np.diag(prior_sd**-2)
    np.testing.assert_allclose(step, np.linalg.solve(normal, jacobian @ residuals), rtol=1e-6)
    before = 0.5 * (residuals**2).sum()
    after = 0.5 * ((residuals - step @ jacobian) ** 2).sum()
    assert promised == pytest.approx(before - after, rel=1e-10)
    half = abs(step[0]) / 2
    room = (np.array([-half, -10, -10]), np.array([half, 10, 10]))
    held, _ = damped_step(jacobian, residuals, room, prior_sd)

    def cost(s):
        return 0.5 * ((residuals - s @ jacobian) ** 2).sum() + 0.5 * ((s / prior_sd) ** 2).sum()

    best = minimize(cost, np.zeros(3), bounds=list(zip(*room, strict=True)), tol=1e-12).x
    # the bounded solver works from inside, to 1e-10 of the cost
    assert abs(held[0]) == pytest.approx(half, rel=1e-7)
    np.testing.assert_allclose(held, best, atol=1e-4)


def test_a_direction_without_data_is_not_followed():
    """Two numbers of which only the sum shows: the step moves both alike, by their prior."""
    jacobian = np.ones((2, 10))
    step, _ = damped_step(
        jacobian, np.ones(10), (np.full(2, -5.0), np.full(2, 5.0)), np.full(2, 100.0)
    )
    np.testing.assert_allclose(step, [0.5, 0.5], rtol=1e-3)


class Bent:
    """Rows with residuals truth - x^3 of one number x; counts its Jacobians."""

    def __init__(self, truth=8.0):
        self.truth = truth
        self.jacobians = []

    def objective(self, x):
        return -0.5 * (self.truth - x**3) ** 2

    def differentiate(self, x, close):
        self.jacobians.append((x, close))
        return np.array([[3 * x**2]])

    def step(self, x, jacobian):
        room = (np.array([-5.0]), np.array([5.0]))
        return damped_step(jacobian, np.array([self.truth - x**3]), room, np.array([100.0]))

    def try_steps(self, x, steps):
        gains = [self.objective(x + step) - self.objective(x) for step in steps[:, 0]]
        best = int(np.argmax(gains))
        return (x + steps[best, 0], gains[best]) if gains[best] > 0 else (x, 0.0)


def test_steps_that_are_too_long_are_shortened():
    """From 0.5 the whole step ends near 11, where all is worse; with shorter ones it climbs to 2,
    without it stays where it was.
    """
    settings = GaussNewtonSettings(iterations=30, tolerance=1e-10)
    found, _ = maximize(Bent(), 0.5, settings)
    assert found == pytest.approx(2.0, abs=1e-4)
    stuck, _ = maximize(Bent(), 0.5, replace(settings, fractions=(1.0,)))
    assert stuck == 0.5


def test_a_jacobian_is_kept_while_it_keeps_its_promise():
    """Close to the maximum one Jacobian does for all steps, and is handed on; one given is used
    first.
    """
    near = Bent()
    found, jacobian = maximize(near, 1.99, GaussNewtonSettings(tolerance=1e-8))
    assert found == pytest.approx(2.0, abs=1e-4)
    assert len(near.jacobians) == 1
    assert jacobian is not None
    again = Bent()
    maximize(again, 1.995, GaussNewtonSettings(tolerance=1e-8), jacobian=jacobian)
    assert again.jacobians == []


def test_differences_come_closer_where_steps_gain_nothing():
    """A Jacobian of the wrong sign at first: no step gains, so it is found anew by narrow
    differences, which are right.
    """

    class Misled(Bent):
        def differentiate(self, x, close):
            right = super().differentiate(x, close)
            return right if close else -right

    problem = Misled()
    found, _ = maximize(problem, 1.5, GaussNewtonSettings(iterations=20, tolerance=1e-8))
    assert [close for _, close in problem.jacobians][:2] == [False, True]
    assert found == pytest.approx(2.0, abs=1e-3)


def test_steps_that_are_too_short_are_lengthened():
    """Usual differences four times too steep, as where contacts come and go, and narrow ones that
    are rough: step after step gains a part, and longer ones reach 2 in five; without them it ends
    far from it.
    """

    class Rough(Bent):
        def differentiate(self, x, close):
            right = super().differentiate(x, close)
            return np.array([[1e6]]) if close else 4 * right

    settings = GaussNewtonSettings(tolerance=1e-8)
    found, _ = maximize(Rough(), 3.0, settings)
    assert found == pytest.approx(2.0, abs=0.03)
    stuck, _ = maximize(Rough(), 3.0, replace(settings, multiples=(1e-9,)))
    assert stuck > 2.1
