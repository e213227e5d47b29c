"""Intervals of standard deviations and correlations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import BadArgument
from dropo.estimators.uniform_randomization import UniformRandomization
from dropo.problems.simulated.slide import slide

SETS = 1500
ANY_FIT = UniformRandomization().fit(slide(), rng=0)


def sample_fit(x):
    """The fit of a sample (G, 2) whose groups are known exactly, with the sandwich's errors."""
    count = len(x)
    away = x - x.mean(axis=0)
    sd = away.std(axis=0)
    u, v = (away / sd).T
    factor = count / (count - 1)
    scale_se = 0.5 * sd * np.sqrt(np.sum(((away / sd) ** 2 - 1) ** 2, axis=0) * factor) / count
    r = float(np.mean(u * v))
    influence = u * v - r * (u**2 + v**2) / 2
    error = np.sqrt(np.sum(influence**2) * factor) / count
    correlation = np.array([[1.0, r], [r, 1.0]])
    return replace(
        ANY_FIT,
        scale=sd,
        sd=sd,
        scale_se=scale_se,
        degrees_of_freedom=np.full(2, count - 1.0),
        correlation=correlation,
        correlation_se=error * (1 - np.eye(2)),
    )


@pytest.mark.parametrize("count", [12, 50])
def test_intervals_of_sds_and_correlations_cover(count):
    """Samples of a Gaussian with correlation 0.5: 95 % within 2 % and three standard errors, where
    symmetric intervals of the sd miss by more.
    """
    rng = np.random.default_rng(0)
    z = rng.standard_normal((SETS, count, 2))
    z[..., 1] = 0.5 * z[..., 0] + np.sqrt(0.75) * z[..., 1]
    fits = [sample_fit(0.2 * x) for x in z]
    intervals = np.stack([fit.sd_interval()[0] for fit in fits])
    covered = np.mean((intervals[:, 0] <= 0.2) & (intervals[:, 1] >= 0.2))
    off = 0.02 + 3 * np.sqrt(0.05 * 0.95 / SETS)
    assert covered == pytest.approx(0.95, abs=off)
    of_correlation = np.stack([fit.correlation_interval()[0, 1] for fit in fits])
    covered = np.mean((of_correlation[:, 0] <= 0.5) & (of_correlation[:, 1] >= 0.5))
    assert covered == pytest.approx(0.95, abs=off)
    t = stats.t.ppf(0.975, count - 1)
    symmetric = [abs(fit.sd[0] - 0.2) <= t * fit.scale_se[0] for fit in fits]
    assert np.mean(symmetric) < 0.93


@pytest.mark.parametrize("truth", [0.0, 0.05, 0.2])
def test_intervals_of_sds_cover_under_noise(truth):
    """Variances (25 groups) less a noise of known size, which may be much larger and leave 0: 93 %
    of intervals or more hold the truth, and those of 0 begin at 0.
    """
    rng = np.random.default_rng(2)
    count = 25
    noise = 0.1**2
    held = []
    for _ in range(SETS // 3):
        seen = (truth**2 + noise) * rng.chisquare(count - 1) / count
        variance = max(seen - noise, 0.0)
        sd = np.full(2, np.sqrt(variance))
        fit = replace(
            ANY_FIT,
            scale=sd,
            sd=sd,
            scale_se=np.full(2, np.nan),
            variance_se=np.full(2, (variance + noise) * np.sqrt(2 / (count - 1))),
            degrees_of_freedom=np.full(2, count - 1.0),
        )
        low, high = fit.sd_interval()[0]
        held.append(low <= truth <= high)
        assert variance > 0 or low == 0
    assert np.mean(held) > 0.93


def test_lower_ends_of_sds_hold_where_few_units_weigh():
    """Half of the 5 % that miss may do so there, within three standard errors: a variance of which
    few of 50 units say most (as many as 12 alike) has a larger error where it comes out large.
    """
    rng = np.random.default_rng(5)
    weights = 0.85 ** np.arange(50)
    weights /= weights.sum()
    above = 0
    for x in rng.standard_normal((SETS, 50)):
        variance = np.sum(weights * x**2)
        error = np.sqrt(np.sum(weights**2 * (x**2 - variance) ** 2) * 50 / 49)
        fit = replace(
            ANY_FIT,
            sd=np.full(2, np.sqrt(variance)),
            scale_se=np.full(2, np.nan),
            variance_se=np.full(2, max(error, variance * np.sqrt(2 / 50))),
            degrees_of_freedom=np.full(2, 49.0),
        )
        above += fit.sd_interval()[0, 0] > 1
    assert above / SETS < 0.025 + 3 * np.sqrt(0.025 * 0.975 / SETS)


def test_what_has_no_error_has_no_interval(tmp_path):
    """A scale without one, a family without correlations; both come back from the files."""
    fit = sample_fit(np.random.default_rng(1).standard_normal((20, 2)))
    blind = replace(fit, scale_se=np.array([np.nan, 0.1]), correlation_se=None)
    assert np.isnan(blind.sd_interval()[0]).all()
    assert np.isfinite(blind.sd_interval()[1]).all()
    assert np.isnan(blind.correlation_interval()[0, 1]).all()
    np.testing.assert_array_equal(blind.correlation_interval()[0, 0], [1, 1])
    assert "correlation_se" not in blind.to_json()
    fit.save(tmp_path)
    again = Fit.load(tmp_path)
    np.testing.assert_array_equal(again.correlation_se, fit.correlation_se)
    assert again.variance_se is None
    none = replace(fit, variance_se=np.array([0.1, np.nan]))
    none.save(tmp_path)
    np.testing.assert_array_equal(Fit.load(tmp_path).variance_se, [0.1, np.nan])
    entry = fit.to_json()["parameters"]["mass"]
    assert entry["sd_interval"] == pytest.approx(fit.sd_interval()[0].tolist())
    assert again.to_json() == fit.to_json()


def test_a_mean_on_its_bound_leaves_the_spread_its_groups():
    """Its interval is that of as many groups as the others have; without any there is none."""
    fit = sample_fit(np.random.default_rng(1).standard_normal((20, 2)))
    on_bound = replace(fit, degrees_of_freedom=np.array([np.nan, 19.0]))
    np.testing.assert_array_equal(on_bound.sd_interval(), fit.sd_interval())
    np.testing.assert_array_equal(on_bound.correlation_interval(), fit.correlation_interval())
    none = replace(fit, degrees_of_freedom=np.full(2, np.nan))
    assert np.isnan(none.sd_interval()).all()
    known = replace(fit, degrees_of_freedom=None)
    assert np.all(known.sd_interval()[:, 1] < fit.sd_interval()[:, 1])


def test_a_level_must_be_a_probability():
    """As of the means' intervals."""
    with pytest.raises(BadArgument, match="level"):
        ANY_FIT.sd_interval(1.0)
    with pytest.raises(BadArgument, match="level"):
        ANY_FIT.correlation_interval(0.0)
