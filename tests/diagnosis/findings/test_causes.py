"""What is told of causes: harmonics that belong together, and those that only draw a shape."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.findings.causes import _shape, p_of, p_of_sizes
from dropo.diagnosis.parts import Estimate

HALVES = (Quantity("sine", "N m", -1, 1, (0.01,)), Quantity("cosine", "N m", -1, 1, (0.01,)))


@pytest.mark.parametrize(
    ("orders", "shape"),
    [((12,), None), ((12, 24, 36), None), ((6, 8), "qpos.elbow"), ((7, 12, 14), "qpos.elbow")],
)
def test_unrelated_harmonics_are_a_shape(orders, shape):
    """Cogs and their multiples are cogging; harmonics of different numbers stand in for something
    else. Another joint's do not count.
    """
    accepted = [
        EffectInstance("joint_cogging", "elbow", HALVES, str(order), order=order)
        for order in orders
    ]
    other = EffectInstance("joint_cogging", "wrist", HALVES, "10", order=10)
    damping = EffectInstance("joint_damping", "elbow", HALVES[:1])
    state = SimpleNamespace(accepted=(*accepted, other, damping))
    assert [_shape(state, instance) for instance in accepted] == [shape] * len(orders)
    assert _shape(state, other) is None
    assert _shape(state, damping) is None


@pytest.mark.parametrize("degrees", [3.0, 11.0, np.inf])
def test_p_values_follow_from_what_the_intervals_do(degrees):
    """At the end of a 95 % interval p is 0.05 for one effect tried; 40 tried, or a second size,
    make it so many times larger, up to 1. Far away it is not 0. The control: 2.4 standard errors
    are never one in a million.
    """
    one = Estimate(1.0, 0.1, "N m", degrees=degrees)
    low, _ = one.interval()
    at_end = Estimate(1.0 - low, 0.1, "N m", degrees=degrees)
    assert p_of_sizes([at_end], 1) == pytest.approx(0.05)
    assert p_of_sizes([at_end, Estimate(0.0, 0.1, "N m")], 1) == pytest.approx(0.1)
    assert p_of_sizes([at_end], 40) == 1.0
    assert p_of_sizes([Estimate(0.24, 0.1, "N m", degrees=degrees)], 1) > 0.01
    assert 0 < p_of_sizes([Estimate(1e300, 1e-9, "N m", degrees=degrees)], 1) < 1e-20


def test_sizes_without_errors_say_nothing():
    """Neither alone nor beside one that has an error."""
    unknown = Estimate(5.0, np.nan, "N m")
    assert p_of_sizes([unknown], 10) == 1.0
    beside = p_of_sizes([unknown, Estimate(1.0, 0.1, "N m")], 1)
    assert beside == pytest.approx(2 * p_of_sizes([Estimate(1.0, 0.1, "N m")], 1))


def test_p_of_a_gain_counts_all_effects_tried():
    """Twice as many make it twice as large, whichever of the two figures decides."""
    for gain, z in ((3.0, 9.0), (300.0, 4.0)):
        assert p_of(gain, 4, z, 12) == pytest.approx(2 * p_of(gain, 2, z, 12))
    assert p_of(0.0, 2, 0.0, 12) == 1.0
