"""What is told of causes: harmonics that belong together, and those that only draw a shape."""

from types import SimpleNamespace

import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.findings.causes import _shape

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
