"""From a member of a family to a Fit: standard errors that hold over many data sets, warnings,
files, text.
"""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.dependence import independent
from dropo.core.numerics.tails import student_quantile
from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.fit_parts import GroupEffects
from dropo.core.records.fits.search_records import SearchRecord
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.registry import names
from dropo.core.services.tables import estimate
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.random_effects import RandomEffects
from dropo.estimators.support import standard_errors
from dropo.estimators.support.summary import at_bounds, cut_off
from dropo.estimators.uniform_randomization import UniformRandomization
from dropo.problems.simulated.slide import slide
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from tests.reference.pushes import MEAN, SD, pushes, z_of_mean, z_of_sd

# --- standard errors


def mean_squares(estimator, count):
    """The mean square of the means' z-scores, and of the sds', over data sets of 50 pushes."""
    fits = [estimator.fit(pushes(seed, epsilon=1e-6)) for seed in range(count)]
    means = np.array([z_of_mean(fit, MEAN) for fit in fits])
    sds = (
        np.array([z_of_sd(fit, SD) for fit in fits])
        if isinstance(estimator, DROPO)
        else np.zeros((1, 1))
    )
    return float(np.mean(means**2)), float(np.nanmean(sds**2))


def test_limits_are_those_of_chance():
    """80 independent z-scores have a mean square of 0.58 to 1.56 in all but 2 in 1000 cases."""
    assert stats.chi2.ppf([0.001, 0.999], 80) / 80 == pytest.approx([0.58, 1.56], abs=0.005)


@pytest.mark.parametrize(
    "estimator",
    [LeastSquares(), pytest.param(DROPO(), marks=pytest.mark.study)],
    ids=["least-squares", "dropo"],
)
def test_standard_errors_of_means_are_right(estimator):
    """Over 40 data sets of 50 draws (DROPO: 16) the means' z-scores have a mean square of 0.6 to
    1.6.
    """
    means, sds = mean_squares(estimator, 16 if isinstance(estimator, DROPO) else 40)
    assert 0.6 < means < 1.6
    assert sds < 1.6  # scores of a fourth moment, whose chi-square limits are wider below


@pytest.mark.parametrize("estimator", [LeastSquares(), DROPO()], ids=["least-squares", "dropo"])
def test_dependent_rows_taken_as_independent_have_errors_that_are_too_small(estimator, monkeypatch):
    """The control: where every row counts as a unit of its own, the mean square is beyond 3."""
    monkeypatch.setattr(
        standard_errors, "units_of", lambda segments: independent(len(segments.rows[0]))
    )
    assert mean_squares(estimator, 4)[0] > 3


def test_few_units_give_wide_intervals():
    """20 trajectories: Student t with fewer than 19 degrees, since they do not tell the same; on a
    bound there is no interval.
    """
    fit = LeastSquares().fit(pushes(0, count=20))
    assert ((fit.degrees_of_freedom > 4) & (fit.degrees_of_freedom < 19)).all()
    half = student_quantile(0.975, fit.degrees_of_freedom) * fit.mean_se
    np.testing.assert_allclose(fit.interval(), np.stack([fit.mean - half, fit.mean + half], 1))
    assert fit.to_json()["parameters"]["mass"]["mean_interval"] == fit.interval()[0].tolist()
    assert (fit.interval(0.99)[:, 1] > fit.interval()[:, 1]).all()
    above = LeastSquares().fit(pushes(0, mean=np.array([5.0, 0.8]), sd=0.0))
    assert np.isnan(above.interval()[0]).all()
    assert above.to_json()["parameters"]["mass"]["mean_interval"] == [None, None]
    with pytest.raises(BadArgument, match=r"'level' of Fit\.interval must be between 0 and 1"):
        fit.interval(95)


def test_an_interval_ends_where_the_search_does():
    """A standard error of 1 around 0.6 kg, searched from 0.5 to 4 kg: from 0.5 kg."""
    fit = replace(
        fitted("point"),
        mean=np.array([0.6, 0.8]),
        mean_se=np.array([1.0, 0.01]),
        degrees_of_freedom=None,
    )
    np.testing.assert_allclose(fit.interval()[0], [0.5, 0.6 + 1.959964], rtol=1e-6)


def test_one_trajectory_is_looked_along():
    """One push of 400 steps has standard errors and an interval for each parameter."""
    fit = LeastSquares().fit(long_push())
    assert np.isfinite(fit.interval()).all()
    assert (fit.degrees_of_freedom < 400).all()


def long_push():
    """One trajectory of 400 transitions."""
    rng = np.random.default_rng(3)
    forces = np.repeat(rng.normal(0, 3, (1, 80, 1)), 5, axis=1)
    data = simulate(SlidingBlock(), MEAN[None], forces, np.zeros(2), noise_variance=1e-6, rng=rng)
    return Problem("push", SlidingBlock(), data)


def test_equal_weights_have_errors_of_their_own():
    """Weighted equally where one signal is 100 times noisier, the errors are those of 30 fits, and
    beyond those of noise weights.
    """
    found = [
        LeastSquares(weights="equal").fit(pushes(seed, sd=0.0, noise=[1e-4, 1e-8], count=25))
        for seed in range(30)
    ]
    spread = np.std([fit.mean for fit in found], axis=0, ddof=1)
    np.testing.assert_allclose(
        np.mean([fit.mean_se for fit in found], axis=0), spread, rtol=4.5 / np.sqrt(58)
    )
    efficient = LeastSquares().fit(pushes(0, sd=0.0, noise=[1e-4, 1e-8], count=25)).mean_se
    assert (efficient < spread / (1 + 4.5 / np.sqrt(58))).all()


def test_what_the_data_do_not_tell_has_no_error():
    """A parameter without any influence has NaN, and leaves the other's error as it is alone:
    sqrt(epsilon / sum a^2).
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(np.array([[[1.0, 0.0]]]))
    actions = rng.uniform(0.5, 1.5, (200, 1, 1))
    data = simulate(
        simulator, np.tile([1.0, 2.0], (200, 1)), actions, np.zeros(1), noise_variance=0.01, rng=rng
    )
    fit = LeastSquares().fit(Problem("blind", simulator, data))
    assert np.isnan(fit.mean_se[1])
    assert fit.mean_se[0] == pytest.approx(0.1 / np.sqrt(np.sum(actions**2)), rel=0.25)


def test_what_ends_on_a_bound_is_told():
    """A mean on either bound and a scale on its upper one; not a scale that vanished, a partial
    correlation or a noise.
    """
    space = ParameterSpace(
        (
            Parameter("mean.a", 1, 2),
            Parameter("mean.b", 1, 2),
            Parameter("scale.a", 1e-5, 0.5, scale="log"),
            Parameter("scale.b", 1e-5, 0.5, scale="log"),
            Parameter("partial.a.b", -0.99, 0.99),
            Parameter("epsilon", 1e-8, 1e4, scale="log"),
        )
    )
    end = "widen it, or the model cannot explain the data"
    assert at_bounds(space, np.array([1.0, 2.0, 1e-5, 0.5, 0.99, 1e-8])) == [
        f"mean.a ends on its lower bound 1: {end}",
        f"mean.b ends on its upper bound 2: {end}",
        f"scale.b ends on its upper bound 0.5: {end}",
    ]
    assert at_bounds(space, np.array([1.5, 1.5, 1e-5, 0.1, 0.0, 1.0])) == []


def test_a_posterior_that_a_bound_cuts_off_is_told():
    """Exponential at a bound, normal in the box, uniform over it; a mean on its bound is told of
    elsewhere.
    """
    space = ParameterSpace([Parameter(name, 0.0, 1.0) for name in "abcd"])
    mean = np.array([0.99, 0.5, 0.5, 1e-5])
    assert cut_off(space, mean, np.array([0.01, 0.1, 0.29, 1e-5])) == [
        "the posterior of a is cut off by its upper bound 1: widen it, or the model cannot explain"
        " the data"
    ]


# --- the Fit


@cache
def fitted(family):
    if family == "udr":
        return UniformRandomization().fit(slide())
    method = RandomEffects if family == "mixture" else DROPO
    return method(family=family).fit(slide(), rng=3)


def same(one, other):
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    if isinstance(one, dict) and any(isinstance(value, np.ndarray) for value in one.values()):
        return one.keys() == other.keys() and all(
            np.array_equal(one[key], other[key]) for key in one
        )
    if isinstance(one, SearchRecord | GroupEffects):
        return type(one) is type(other) and all(
            same(vars(one)[name], vars(other)[name]) for name in vars(one)
        )
    return one == other or (one != one and other != other)


@pytest.mark.parametrize("family", [*names("families"), "udr"])
def test_a_fit_comes_back_from_its_files(family, tmp_path):
    """Every field, bit for bit (the time to the millisecond), with NaN errors and further arrays;
    and the same draws.
    """
    fit = fitted(family)
    fit.save(tmp_path / "new" / "folder")
    back = Fit.load(tmp_path / "new" / "folder")
    differing = [
        f.name for f in fields(Fit) if not same(getattr(fit, f.name), getattr(back, f.name))
    ]
    assert differing in ([], ["wall_time_s"])
    assert back.wall_time_s == pytest.approx(fit.wall_time_s, abs=5e-4)
    assert np.isnan(fit.scale_se).any() == (family in ("point", "udr"))
    np.testing.assert_array_equal(back.sample(50, 1), fit.sample(50, 1))
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == [
        "fit.json",
        "fit.npz",
    ]
    kept = json.loads((tmp_path / "new" / "folder" / "fit.json").read_text())
    assert kept["parameters"]["mass"]["unit"] == "kg"
    assert kept["status"] == fit.status.value


def test_a_folder_without_a_fit_is_refused(tmp_path):
    """What was expected, and that there is none; a file of something else likewise."""
    path = tmp_path / "fit.json"
    with pytest.raises(BadFile) as refusal:
        Fit.load(tmp_path)
    assert (
        str(refusal.value)
        == f"{path}: expected a fit written by `dropo fit --out`, got no such file."
    )
    path.write_text("{}")
    np.savez(tmp_path / "fit.npz", phi=np.zeros(2))
    with pytest.raises(BadFile) as refusal:
        Fit.load(tmp_path)
    assert str(refusal.value) == f"{path}: method: expected what a run writes, got nothing."
    path.write_text("mass 1.5 kg")
    with pytest.raises(
        BadFile, match=r"got no JSON \(Expecting value: line 1 column 1 \(char 0\)\)\.$"
    ):
        Fit.load(tmp_path)


@pytest.mark.parametrize("family", ["truncated_gaussian", "full", "uniform", "log_normal"])
def test_samples_have_the_moments_that_are_printed(family):
    """40,000 draws: mean and sd within 4.5 standard errors of the fit's; the scale, where it is not
    the sd, is rejected.
    """
    fit = fitted(family)
    draws = fit.sample(40_000, 0)
    kurtosis = np.mean((draws - draws.mean(axis=0)) ** 4, axis=0) / draws.var(axis=0) ** 2
    z = lambda sd: (draws.std(axis=0) - sd) / (0.5 * sd * np.sqrt((kurtosis - 1) / len(draws)))
    assert (np.abs(draws.mean(axis=0) - fit.mean) < 4.5 * fit.sd / np.sqrt(len(draws))).all()
    assert (np.abs(z(fit.sd)) < 4.5).all()
    if family != "full":
        assert (np.abs(z(fit.scale)) > 4.5).all()


def test_a_point_is_drawn_as_it_is():
    np.testing.assert_array_equal(
        fitted("point").sample(3, 0), np.tile(fitted("point").mean, (3, 1))
    )


def test_the_text_shows_parameters_with_units_and_what_it_cost():
    """A line for each parameter with its unit, mean and sd; the simulator steps; the status in
    words.
    """
    fit = fitted("truncated_gaussian")
    lines = str(fit).splitlines()
    for i, parameter in enumerate(fit.space):
        line = next(line for line in lines if line.startswith(parameter.name))
        assert parameter.unit in line
        assert estimate(fit.mean[i], fit.mean_se[i]) in line
        assert f"{fit.sd[i]:.4g}" in line
    assert lines[0] == "slide: dropo, truncated gaussian"
    assert any(line.startswith(f"{fit.simulator_steps:,} simulator steps, ") for line in lines)
    assert f"converged: {fit.message}" in lines


def test_the_text_shows_what_there_is_not():
    """A dash in place of a NaN, and every warning on its own line."""
    fit = LeastSquares().fit(pushes(0, mean=np.array([5.0, 0.8]), sd=0.0, count=5))
    assert fit.warnings
    assert str(fit).splitlines()[-len(fit.warnings) :] == [
        f"warning: {text}" for text in fit.warnings
    ]
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(np.array([[[1.0, 0.0]]]))
    data = simulate(
        simulator, np.ones((30, 2)), np.ones((30, 1, 1)), np.zeros(1), noise_variance=0.01, rng=rng
    )
    line = next(
        line
        for line in str(LeastSquares().fit(Problem("blind", simulator, data))).splitlines()
        if line.startswith("x1")
    )
    assert " - " in line


def test_simulations_are_counted():
    """fit.simulator_steps is what the simulator itself counted during the fit."""
    for estimator in (
        LeastSquares(),
        DROPO(),
        DROPO(likelihood="monte-carlo", draws=5, budget=40),
        UniformRandomization(draws=10),
    ):
        problem = slide()
        before = problem.simulator.steps
        assert estimator.fit(problem).simulator_steps == problem.simulator.steps - before
