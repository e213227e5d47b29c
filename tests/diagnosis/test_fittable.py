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
