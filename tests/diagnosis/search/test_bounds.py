"""Numbers at the end of their interval are warned of, in the search for single effects too."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import dropo.diagnosis.diagnose as module
from dropo import Diagnose
from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.diagnosis.search.bounds import at_bounds
from tests.models.hidden_in_arm import problem

FRICTION = EffectInstance(
    "joint_friction", "elbow", (Quantity("frictionloss", "N m", -0.2, 1.0, (0.1,), base=0.2),)
)
LIBRARY = SimpleNamespace(
    indices_of={FRICTION.label: np.array([1])},
    simulator=SimpleNamespace(
        space=SimpleNamespace(
            names=("mass", "joint_friction:elbow/frictionloss"),
            low=np.array([0.5, -0.2]),
            high=np.array([2.0, 1.0]),
        )
    ),
)


@pytest.mark.parametrize(
    ("mass", "friction", "named"),
    [
        (1.0, 0.3, ()),
        (1.0, -0.2, ()),  # all of the model's friction is gone: that is a number, and no end
        (1.0, 1.0, ("joint_friction",)),
        (1.0, 1.0 - 1e-9, ("joint_friction",)),
        (0.5, 1.0, ("mass", "joint_friction")),
    ],
)
def test_what_is_at_an_end_is_named(mass, friction, named):
    """Declared parameters and sizes of effects; what is not fitted does not count."""
    theta = np.array([mass, friction])
    told = at_bounds(LIBRARY, theta, np.arange(2), (FRICTION,))
    assert [text.split("/")[0].split(":")[0].split(" ")[0] for text in told] == list(named)
    assert all("at its bound" in text for text in told)
    assert at_bounds(LIBRARY, theta, np.arange(0), (FRICTION,)) == ()


def test_a_size_on_its_bound_is_a_warning_of_a_diagnosis(monkeypatch):
    """An interval that ends at half of what is missing; the control is the effect's own."""
    honest = module.instances_for

    def narrow(*given):
        found = []
        for one in honest(*given):
            quantity = replace(one.quantities[0], high=0.025)
            found.append(replace(one, quantities=(quantity,)))
        return found

    diagnose = Diagnose(("joint_damping:elbow",), length=5, windows=16, disturbances=False)
    hidden = problem([("joint_damping:elbow", [0.05])])
    assert not any("at its bound" in text for text in diagnose.run(hidden).warnings)
    monkeypatch.setattr(module, "instances_for", narrow)
    found = diagnose.run(hidden)
    assert [one.effect for one in found.causes] == ["joint_damping"]
    assert any("joint_damping:elbow/damping is at its bound" in text for text in found.warnings)
