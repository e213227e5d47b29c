"""What was found as parameters with bounds."""

from types import SimpleNamespace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.findings.fittable import SETTINGS, _bounded
from dropo.diagnosis.parts import Estimate


def test_bounds_lie_around_what_is_known():
    """Six standard errors, or half the size; a quantity that nothing was said of keeps its own."""
    quantities = (
        Quantity("stiffness", "N m/rad", 0.0, 50.0, (0.1,)),
        Quantity("load", "N m", -5.0, 5.0, (0.1,)),
    )
    instance = EffectInstance("joint_stiffness", "elbow", quantities, "rest")
    cause = SimpleNamespace(estimate={"load": Estimate(-1.0, 0.1, "N m")})
    stiffness, load = _bounded(instance, np.array([0.0, -1.0]), cause, SETTINGS).quantities
    assert (stiffness.low, stiffness.high) == (0.0, 50.0)
    np.testing.assert_allclose((load.low, load.high), (-1.6, -0.4))


def test_bounds_lie_around_what_a_search_would_not_have_reached():
    """A rotor twice as heavy as a search by simulation tries, by regression: with its error, and
    without.
    """
    quantities = (Quantity("armature", "kg", 0.0, 1.25, (0.1,)),)
    instance = EffectInstance("joint_armature", "slide", quantities)
    for se, low in ((0.1, 1.25), (np.nan, 1.25)):
        cause = SimpleNamespace(estimate={"armature": Estimate(2.5, se, "kg")})
        (armature,) = _bounded(instance, np.array([2.5]), cause, SETTINGS).quantities
        np.testing.assert_allclose((armature.low, armature.high), (low, 3.75))
