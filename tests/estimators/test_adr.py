"""Automatic domain randomization: bounds that end where the performance does."""

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument
from dropo.estimators.adr import ADR
from dropo.problems.simulated.slide import slide

# where the policy succeeds, inside mass 0.5..4 and damping 0.1..3
LOW = np.array([1.0, 0.9])
HIGH = np.array([3.0, 2.2])


def succeeds(values, rng):
    return float(((values >= LOW) & (values <= HIGH)).all())


def test_bounds_end_where_the_policy_fails():
    """Each within one step of the known bound; the control: another region, whose bounds are more
    than a step away.
    """
    step = 0.02 * (slide().space.high - slide().space.low)
    fit = ADR(performance=succeeds, budget=1200, buffer=3).fit(slide(), rng=0)
    ends = fit.search_record.bounds[-1]
    assert (np.abs(ends - [LOW, HIGH]) <= step + 1e-12).all()
    assert (np.abs(ends - [LOW + 2 * step, HIGH - 2 * step]) > step + 1e-12).all()
    assert fit.family == "uniform"
    np.testing.assert_allclose([fit.mean - fit.scale, fit.mean + fit.scale], ends)
    assert fit.search_record.target_transitions == 0


def test_a_policy_that_never_succeeds_leaves_a_point():
    """And one that always does, the whole box."""
    never, always = (
        ADR(performance=lambda v, rng, p=p: p, budget=1000, buffer=2, step=0.1).fit(slide())
        for p in (0.0, 1.0)
    )
    np.testing.assert_array_equal(*never.search_record.bounds[-1])
    np.testing.assert_allclose(
        always.search_record.bounds[-1], [slide().space.low, slide().space.high]
    )


def test_bounds_come_back():
    """Where the policy gets worse than the lower threshold, inwards; between the two thresholds
    they stay.
    """
    space = slide().space
    found = {}
    for late in (0.0, 0.5):
        asked = []

        def performance(values, rng, asked=asked, late=late):
            asked.append(1)
            return 1.0 if len(asked) <= 200 else late

        fit = ADR(performance=performance, budget=400, buffer=1).fit(slide())
        width = np.ptp(fit.search_record.bounds, axis=1) / (space.high - space.low)
        found[late] = width[200].mean(), width[-1].mean()
    assert found[0.5][0] == pytest.approx(found[0.5][1])
    assert found[0.0][1] < 0.5 * found[0.0][0]


def test_values_lie_on_a_bound():
    """Each call puts one parameter on one of the two bounds, every one of the four in turn, the
    others between theirs.
    """
    asked = []

    def performance(values, rng):
        asked.append(values.copy())
        return 1.0

    fit = ADR(performance=performance, budget=300, buffer=3).fit(slide())
    bounds = fit.search_record.bounds[:-1]  # those in force at each call
    values = np.array(asked)[:, None]
    on = (values == bounds)[200:]  # by now no two bounds are the same
    assert on.any(axis=(1, 2)).all()
    assert on.any(axis=0).all()
    assert ((values[:, 0] >= bounds[:, 0]) & (values[:, 0] <= bounds[:, 1])).all()


def test_same_seed_same_bounds():
    noisy = lambda values, rng: rng.random()
    one, same, other = (
        ADR(performance=noisy, budget=100, buffer=1).fit(slide(), rng=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.search_record.bounds, same.search_record.bounds)
    assert (one.search_record.bounds != other.search_record.bounds).any()


def test_interrupted_it_keeps_its_bounds():
    def performance(values, rng, asked=[]):  # noqa: B006
        if len(asked) == 60:
            raise KeyboardInterrupt
        asked.append(1)
        return 1.0

    fit = ADR(performance=performance, buffer=2).fit(slide())
    assert fit.status is Status.INTERRUPTED
    assert fit.message == "Interrupted after 60 calls: these are the bounds so far."
    assert (fit.scale > 1e-3).all()


def test_refusals():
    with pytest.raises(BadArgument, match="'thresholds' of ADR must be the lower one first"):
        ADR(performance=succeeds, thresholds=(0.8, 0.2))
    with pytest.raises(BadArgument, match="'step' of ADR must be a fraction of the interval"):
        ADR(performance=succeeds, step=0.0)
