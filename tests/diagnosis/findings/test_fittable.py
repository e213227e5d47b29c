"""What was found as parameters with bounds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.findings.fittable import SETTINGS, _bounded, fittable
from dropo.diagnosis.parts import Estimate
from tests.models.hidden_in_arm import instance, problem


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


def test_what_is_found_beside_a_stated_effect_of_its_kind_is_fitted():
    """A gain that the problem states and that is off by 5 %: the 5 % have bounds, what was stated
    stays, and no name is there twice.
    """
    arm = problem([], episodes=2, steps=10)
    gain = instance(arm.simulator, "actuator_gain:shoulder_motor")
    pairs = [(gain, np.array([0.1])), (gain, np.array([-0.05]))]
    robot = arm.simulator.with_effects(fixed=pairs)
    cause = SimpleNamespace(
        effect=gain.effect,
        target=gain.target,
        variant=gain.variant,
        estimate={"gain": Estimate(-0.05, 0.001, "1")},
    )
    found = fittable(replace(arm, simulator=robot), [cause]).simulator
    assert [float(sizes[0]) for _, sizes in found.fixed] == [0.1]
    assert found.space.names == (*arm.simulator.space.names, "actuator_gain:shoulder_motor/gain")
    np.testing.assert_allclose(found.space.high[-1], -0.025)
