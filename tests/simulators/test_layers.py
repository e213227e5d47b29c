"""What effects do around the physics, one function at a time."""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.simulators.mujoco.layers import (
    clamp,
    commands_per_physics_step,
    declared_values,
    delay_columns,
    measured_signals,
    split_by_time_profile,
    total_delays,
)

SIZE = Quantity("size", "1", -1.0, 1.0, (0.5,))
MODEL = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><joint name="a"/>
  <geom size="0.1"/></body></worldbody><actuator>
  <motor joint="a" ctrllimited="true" ctrlrange="-1 2"/><motor joint="a"/></actuator></mujoco>""")


def data(lengths=(3, 2)):
    """Trajectories of two commands that count up."""
    n = sum(lengths)
    ends = np.isin(np.arange(n), np.cumsum(lengths) - 1)
    actions = np.column_stack([np.arange(n), -np.arange(n)]).astype(float)
    return Trajectories(np.zeros((n, 1)), actions, np.zeros((n, 1)), ends)


def doubled(commands, magnitudes):
    return (1 + magnitudes[0]) * commands


def summed(commands, step, magnitudes):
    return np.cumsum(commands, axis=0)


DOUBLE = EffectInstance("double", None, (SIZE,), command=doubled)
SUM = EffectInstance("sum", None, (SIZE,), actuation=summed)
ONE = np.ones(1)


def test_commands_in_order():
    """`command` sees control steps before the clamp, `actuation` physics steps behind it, each
    trajectory from its beginning.
    """
    rows = data()
    segments = rows.segments(horizon=2)
    found = commands_per_physics_step(
        segments, np.arange(2), rows.actions, MODEL, 2, [(SUM, ONE), (DOUBLE, ONE)]
    )
    first = np.cumsum(np.repeat(np.clip([0.0, 2, 4], -1, 2), 2))
    second = np.cumsum(np.repeat(np.clip([6.0, 8], -1, 2), 2))
    np.testing.assert_array_equal(found[:, :, 0], [first[:4], second])
    np.testing.assert_array_equal(found[0, :, 1], np.cumsum(np.repeat([0.0, -2, -4], 2))[:4])


def test_commands_without_actuation_are_left_to_mujoco():
    """Where no effect acts behind the clamp, MuJoCo clamps."""
    rows = data()
    found = commands_per_physics_step(
        rows.segments(), np.arange(5), rows.actions, MODEL, 1, [(DOUBLE, ONE)]
    )
    np.testing.assert_array_equal(found[:, 0], 2 * rows.actions)


def test_clamp():
    """As MuJoCo: declared ranges, others open."""
    np.testing.assert_array_equal(
        clamp(np.array([[-3.0, -3.0], [3.0, 3.0]]), MODEL), [[-1, -3], [2, 3]]
    )


def half_of_it(segments, magnitudes):
    return np.where(np.arange(len(segments)) % 2 == 0, 1.0, 0.5)


def later(segments, magnitudes):
    return (np.arange(len(segments)) > 2).astype(float)


def test_by_time_profile():
    """Segments are put together by what holds in them, magnitudes with their factor; what is absent
    is left out.
    """
    segments = data().segments()
    always = DOUBLE
    half = EffectInstance("half", None, (SIZE,), command=doubled, time_profile=half_of_it)
    late = EffectInstance("late", None, (SIZE,), time_profile=later)
    assert split_by_time_profile([(always, ONE)], segments, np.arange(5)) == [
        (pytest.approx(np.arange(5)), [(always, ONE)])
    ]
    found = split_by_time_profile(
        [(always, ONE), (half, ONE), (late, ONE)], segments, np.array([1, 2, 3, 4])
    )
    named = {
        tuple(part): [(instance.effect, float(magnitudes[0])) for instance, magnitudes in active]
        for part, active in found
    }
    assert named == {
        (1,): [("double", 1.0), ("half", 0.5)],
        (2,): [("double", 1.0), ("half", 1.0)],
        (3,): [("double", 1.0), ("half", 0.5), ("late", 1.0)],
        (4,): [("double", 1.0), ("half", 1.0), ("late", 1.0)],
    }
    with pytest.raises(Incompatible, match="half changes from segment to segment"):
        split_by_time_profile(
            [(half, ONE)],
            data((4, 2)).segments(horizon=2, reset="partial", set_columns=[False]),
            np.arange(3),
        )


def test_declared_values():
    """Hooks on the declared parameters follow each other."""
    add = EffectInstance(
        "add", None, (SIZE,), declared=lambda values, magnitudes: values + magnitudes[0]
    )
    np.testing.assert_array_equal(
        declared_values(np.array([1.0, 2.0]), [(add, ONE), (add, 2 * ONE)]), [4.0, 5.0]
    )


def test_measurements_and_delays_add_up():
    """Sensor effects follow each other; delays of one signal add up."""
    louder = EffectInstance(
        "louder",
        None,
        (SIZE,),
        measurement=lambda signals, magnitudes: signals * (1 + magnitudes[0]),
        sensor_delay=lambda magnitudes: np.array([0.0, magnitudes[0]]),
    )
    np.testing.assert_array_equal(
        measured_signals(np.ones((2, 2)), [(louder, ONE), (louder, ONE)]), np.full((2, 2), 4.0)
    )
    np.testing.assert_array_equal(total_delays([(louder, ONE), (louder, 2 * ONE)], 2), [0, 3])


def test_delayed_columns():
    """A delayed straight line is the line before, also before its start; a bend is interpolated."""
    line = np.arange(6.0)[None, :, None] * np.array([1.0, 2.0])
    np.testing.assert_allclose(
        delay_columns(line, np.array([1.5, 9.0]))[0],
        np.column_stack([np.arange(1, 6) - 1.5, 2 * (np.arange(1, 6) - 9.0)]),
    )
    bend = np.array([0.0, 1.0, 1.0, 1.0])[None, :, None]
    np.testing.assert_allclose(delay_columns(bend, np.array([1.25]))[0, :, 0], [-0.25, 0.75, 1.0])
