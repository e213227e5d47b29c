"""Whether dry friction creeps or holds, and which physics steps are meant, is asked of motions."""

from dataclasses import replace

import pytest

from dropo.core.contracts.estimator import silent
from dropo.diagnosis.far_off.motions import LongWindowSettings
from dropo.diagnosis.far_off.search import FarOffSearch, FarOffSettings
from dropo.diagnosis.search.arithmetic import ArithmeticSettings
from dropo.mjmodel.dynamics.dry_friction import FrictionKind
from dropo.mjmodel.options import physics_step
from tests.models.holding_servo import FRICTION, without_friction

SETTINGS = FarOffSettings(
    laws=(), families=(), motions=LongWindowSettings(seconds=(1.0, 5.0), physics_steps=12_000)
)
WITHIN = 4.0
"""Standard errors that the friction may be off by."""


@pytest.mark.parametrize(("holding", "seed"), [(True, 0), (False, 1)])
def test_friction_is_found_as_it_was_recorded(holding, seed):
    """Machines that hold and machines that creep, each with a physics step four times finer."""
    found = FarOffSearch(SETTINGS, silent).run(without_friction(holding, seed))
    assert (found.model.friction is FrictionKind.HOLDING) == holding
    assert abs(found.model.theta[0] - FRICTION) < WITHIN * found.errors[0] < 0.3 * FRICTION


@pytest.mark.parametrize("finer", [4, 1])
def test_more_exact_steps_are_taken_where_the_machine_has_them(finer):
    """Of a machine that is stepped four times finer they are, and what they change is no error of
    the numbers. Controls: where it is stepped as its model is, and where none are offered.
    """
    few = LongWindowSettings(seconds=(1.0,), physics_steps=4_000, tried=4)
    settings = replace(SETTINGS, motions=few, laws=("joint_damping",))
    model = without_friction(False, 5, finer)
    found = FarOffSearch(settings, silent).run(model)
    assert found.own_steps == (finer == 1)
    assert physics_step(found.model.library.simulator.model) == (0.004 if finer == 1 else 0.001)
    assert abs(found.model.theta[0] - FRICTION) < WITHIN * found.errors[0]
    none = ArithmeticSettings(alternatives=(), of_runge_kutta=())
    kept = FarOffSearch(replace(settings, steps=none), silent).run(model)
    assert kept.own_steps
    assert finer == 1 or kept.errors[1] > 2 * found.errors[1]
