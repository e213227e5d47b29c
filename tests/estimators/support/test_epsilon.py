"""The noise that a fit assumes: the scale of each signal, and epsilon tuned as in the thesis."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.services.errors import UnknownName
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.epsilon import noise_scale, tail_degrees
from dropo.problems.simulated.slide import slide
from dropo.studies.intervals.data_sets import data_set
from tests.reference.pushes import pushes


def test_signals_that_do_not_vary_have_a_noise_scale():
    """By the misfit in the middle of the box; the others by their own variance."""
    problem = slide()
    constant = problem.trajectories.next_observations * [1.0, 0.0] + [0.0, 0.3]
    still = replace(problem, trajectories=replace(problem.trajectories, next_observations=constant))
    scale = noise_scale(still, Run(still, np.random.default_rng(0)))
    assert scale[0] == pytest.approx(np.var(constant[:, 0]), rel=1e-12)
    assert scale[1] > 0


def test_angles_of_zero_have_a_noise_scale():
    """Rounding of 1e-17 is no variance: taken for one, no error of a rotation could be explained,
    and a fit would follow it alone.
    """
    problem = slide()
    rounded = problem.trajectories.next_observations * [1.0, 0.0] + 1e-17 * np.arange(
        len(problem.trajectories)
    )[:, None] * [0.0, 1.0]
    turning = replace(
        problem, trajectories=replace(problem.trajectories, next_observations=rounded)
    )
    assert noise_scale(turning, Run(turning, np.random.default_rng(0)))[1] > 1e-6


@cache
def tuned(**settings):
    """Ten pushes of one block, with noise of variance 1e-5."""
    return DROPO(epsilon="tune", **settings).fit(pushes(3, noise=1e-5, sd=0.0, count=10))


def test_tuning_epsilon_has_the_shape_of_figure_6_4():
    """As epsilon rises to the noise, the total variance falls to none and the mean squared error to
    its least.
    """
    table = tuned().noise_tuning.trials
    assert [row.epsilon for row in table] == [10.0**k for k in range(-8, -1)]
    variance, error = (
        np.array([getattr(row, key) for row in table]) for key in ("total_variance", "mse")
    )
    assert (np.diff(variance[:4]) < 0).all()
    assert variance[0] > 0.5
    assert (variance[3:] < 1e-6).all()
    assert (np.diff(error[:4]) < 0).all()
    assert error[0] > 100 * error[3]
    assert error[3] == pytest.approx(1e-5, rel=4.5 * np.sqrt(2 / 400))
    assert int(np.argmax([row.log_likelihood for row in table])) == 3


def test_tuning_takes_the_smallest_acceptable_epsilon():
    """At most 1.1 times the least error without a threshold; the given threshold; and the least
    error where none reaches it.
    """
    table = tuned().noise_tuning.trials
    threshold = tuned().noise_tuning.mse_threshold
    least = min(row.mse for row in table)
    assert threshold == pytest.approx(1.1 * least, rel=1e-3)
    assert tuned().epsilon[0] == min(row.epsilon for row in table if row.mse <= threshold)
    strict = tuned(mse_threshold=1.001 * least, sweep=(1e-6, 1e-5, 1e-4))
    assert strict.epsilon.tolist() == [1e-5, 1e-5]
    assert strict.warnings == ()
    never = tuned(mse_threshold=1e-9, sweep=(1e-7, 1e-5))
    assert never.epsilon.tolist() == [1e-5, 1e-5]
    assert never.warnings == (
        "no epsilon of the sweep reaches the mean squared error 1e-09; the least is shown",
    )


def whitened(kind, seed, rows=300):
    """Residuals of two signals, and the covariance that a Gaussian fit gives them."""
    rng = np.random.default_rng([seed, 4])
    residual = rng.standard_normal((rows, 2)) * [1e-3, 2.0]
    if kind == "t3":
        residual *= np.sqrt(3 / rng.chisquare(3, (rows, 2)))
    if kind == "outliers":
        residual[rng.random(rows) < 0.02] *= 20
    if kind == "rounded":
        step = np.array([4e-3, 8.0])
        motion = rng.normal(0, 10, (rows, 2)) * step
        residual = np.round((motion + residual) / step) * step - motion
    return residual, np.tile(np.diag(residual.var(axis=0)), (rows, 1, 1))


def test_long_tails_are_noticed():
    """A Student t of 3 and 2 % outliers in each of 20 sets; in 100 Gaussian or rounded
    ones at most 3 times (1 in 400 each: more come by chance in one of 6,000 such tests).
    """
    both = np.ones(2, dtype=bool)
    for kind in ("t3", "outliers"):
        found = [tail_degrees(*whitened(kind, seed), both) for seed in range(20)]
        assert all(degrees is not None and degrees <= 6 for degrees in found)
    for kind in ("gaussian", "rounded"):
        found = [tail_degrees(*whitened(kind, seed), both) for seed in range(100)]
        assert sum(degrees is not None for degrees in found) <= 3
    nothing = np.zeros(2, dtype=bool)
    assert tail_degrees(*whitened("t3", 0), nothing) is None


def test_the_default_switches_to_long_tails():
    """Under outliers the fit says so, its intervals hold the truth, and are a third
    narrower than a Gaussian's; without outliers nothing changes.
    """
    problem, truth = data_set("block", "ends with outliers", 25, 40, np.random.default_rng(5))
    fit = DROPO(family="point").fit(problem, rng=0)
    gaussian = DROPO(family="point", noise="gaussian").fit(problem, rng=0)
    assert "long tails" in fit.message
    assert "long tails" not in gaussian.message
    low, high = fit.interval().T
    assert np.all((low < truth) & (truth < high))
    assert np.all(fit.mean_se < 0.67 * gaussian.mean_se)

    plain, _ = data_set("block", "independent", 25, 40, np.random.default_rng(5))
    as_it_comes = DROPO(family="point").fit(plain, rng=0)
    gaussian = DROPO(family="point", noise="gaussian").fit(plain, rng=0)
    np.testing.assert_array_equal(as_it_comes.phi, gaussian.phi)
    with pytest.raises(UnknownName, match="gaussian"):
        DROPO(noise="normal")
