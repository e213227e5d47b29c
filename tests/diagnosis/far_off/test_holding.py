"""Whether dry friction creeps or holds is asked of the motions."""

import pytest

from dropo.core.contracts.estimator import silent
from dropo.diagnosis.far_off.motions import LongWindowSettings
from dropo.diagnosis.far_off.search import FarOffSearch, FarOffSettings
from tests.models.holding_servo import FRICTION, without_friction

SETTINGS = FarOffSettings(
    laws=(), families=(), motions=LongWindowSettings(seconds=(1.0, 5.0), physics_steps=12_000)
)
WITHIN = 4.0
"""Standard errors that the friction may be off by."""


@pytest.mark.parametrize("holding", [True, False])
@pytest.mark.parametrize("seed", [0, 1])
def test_friction_is_found_as_it_was_recorded(holding, seed):
    """Machines that hold and machines that creep, each with a physics step four times finer."""
    found = FarOffSearch(SETTINGS, silent).run(without_friction(holding, seed))
    assert found.model.holds == holding
    assert abs(found.model.theta[0] - FRICTION) < WITHIN * found.errors[0] < 0.3 * FRICTION
