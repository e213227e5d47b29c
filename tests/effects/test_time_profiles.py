"""Effects that set in at a moment of the data, or grow through it."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.time_profile import place_in_data, sets_in_at_an_end
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.problems.file.writer import write_problem
from dropo.problems.loading import load
from tests.models.effects_on_arm import instance
from tests.models.robots import ROBOTS

PAYLOAD = "parameter_drift:body_mass:upper"


def arm():
    """The arm of three trajectories of six rows, its lower mass declared."""
    return ROBOTS["arm"]()


def under(robot, label, *magnitudes):
    """Predictions of every single step with an effect."""
    simulator = robot.simulator.with_effects((), [(instance(robot, label), np.array(magnitudes))])
    return simulator.predict(simulator.nominal[None], robot.data.segments())[0]


def test_place_in_data():
    """Trajectories share the data evenly, rows a trajectory, whatever its length."""
    data = arm().data
    np.testing.assert_allclose(place_in_data(data.segments()), np.arange(18) / 18)
    short = data.rows(np.r_[0:2, 6:12])
    np.testing.assert_allclose(
        place_in_data(short.segments()), [0, 0.25, *(0.5 + np.arange(6) / 12)]
    )
    np.testing.assert_allclose(place_in_data(data.segments(horizon=3)), np.arange(6) / 6)


@pytest.mark.parametrize(("shift", "first"), [(-0.25, 5), (0.0, 9), (0.3, 15)])
def test_setting_in(shift, first):
    """Before the moment the base model, from there on the whole effect, bit for bit."""
    robot = arm()
    found = under(robot, f"{PAYLOAD}.from", 0.4, shift)
    without = base(robot)
    whole = under(robot, "body_mass:upper", 0.4)
    assert np.array_equal(found[:first], without[:first])
    assert np.array_equal(found[first:], whole[first:])
    assert not np.array_equal(without[first:], whole[first:])


@pytest.mark.parametrize(
    ("label", "magnitudes", "at_an_end"),
    [
        (f"{PAYLOAD}.from", (0.4, -0.449), True),
        (f"{PAYLOAD}.from", (0.4, 0.45), True),
        (f"{PAYLOAD}.from", (0.4, -0.4), False),
        (f"{PAYLOAD}.ramp", (0.45,), False),
        ("body_mass:upper", (0.45,), False),
    ],
)
def test_a_moment_on_its_bound_is_told(label, magnitudes, at_an_end):
    """Of what sets in alone; a size may be as large as it likes."""
    assert sets_in_at_an_end(instance(arm(), label), np.array(magnitudes)) == at_an_end


def base(robot):
    """Predictions of every single step without an effect."""
    return robot.simulator.predict(robot.simulator.nominal[None], robot.data.segments())[0]


def test_ramp():
    """In each tenth of the data its own fraction of the magnitude, from nothing to everything."""
    robot = arm()
    found = under(robot, f"{PAYLOAD}.ramp", 0.4)
    for row in range(18):
        stage = (10 * row) // 18
        expected = under(robot, "body_mass:upper", 0.4 * (stage / 9)) if stage else base(robot)
        assert np.array_equal(found[row], expected[row])


def test_declared_parameter():
    """A declared parameter that changes is that parameter with another value, and never leaves what
    is possible.
    """
    robot = arm()
    found = under(robot, "parameter_drift:lower_mass.from", 0.3, 0.0)
    values = np.stack([robot.simulator.nominal, robot.simulator.nominal + 0.3])
    before, after = robot.simulator.predict(values, robot.data.segments())
    np.testing.assert_array_equal(found, np.vstack([before[:9], after[9:]]))
    lower = robot.simulator.space[0].lower
    lightest = robot.simulator.predict(np.array([[lower]]), robot.data.segments())[0]
    assert np.array_equal(
        under(robot, "parameter_drift:lower_mass.from", -0.8, -0.45)[9:], lightest[9:]
    )


def test_moment_is_a_parameter():
    """Magnitude and moment are found as numbers of the simulator, a draw each."""
    robot = arm()
    free = robot.simulator.with_effects([instance(robot, f"{PAYLOAD}.from")])
    values = np.column_stack(
        [np.full(3, robot.simulator.nominal), [0.4, 0.4, 0.0], [-0.25, 0.3, 0.3]]
    )
    early, late, absent = free.predict(values, robot.data.segments())
    assert np.array_equal(early, under(robot, f"{PAYLOAD}.from", 0.4, -0.25))
    assert np.array_equal(late, under(robot, f"{PAYLOAD}.from", 0.4, 0.3))
    np.testing.assert_allclose(absent, base(robot), rtol=1e-12)


def test_parts_and_order_do_not_matter():
    """Segments keep their place in the data whichever come together."""
    robot = arm()
    simulator = robot.simulator.with_effects(
        (), [(instance(robot, f"{PAYLOAD}.ramp"), np.array([0.4]))]
    )
    segments = robot.data.segments(horizon=3, every_step=True)
    nominal = robot.simulator.nominal[None]
    whole = simulator.predict(nominal, segments)[0].reshape(6, 3, -1)
    some = simulator.predict(nominal, segments.take([1, 4, 5]))[0].reshape(3, 3, -1)
    assert np.array_equal(some, whole[[1, 4, 5]])


def test_chained_segments_are_refused():
    """What goes on where another segment ended cannot have another model; said with the way out."""
    robot = arm()
    simulator = robot.simulator.with_effects(
        (), [(instance(robot, f"{PAYLOAD}.ramp"), np.array([0.4]))]
    )
    chained = robot.data.segments(
        horizon=2, reset="partial", set_columns=[True, True, False, False]
    )
    with pytest.raises(Incompatible, match="reset='partial'"):
        simulator.predict(robot.simulator.nominal[None], chained)


def test_what_can_change():
    """Every declared parameter, and what changes on machines, in both ways."""
    labels = [a.label for a in find("effects", "parameter_drift")(arm().simulator.effect_context)]
    assert {
        "parameter_drift:lower_mass.from",
        "parameter_drift:lower_mass.ramp",
        "parameter_drift:actuator_gain:push.ramp",
    } <= set(labels)
    assert len(labels) == len(set(labels))
    trials = instance(arm(), f"{PAYLOAD}.from").trials
    assert {trial[0][1] for trial in trials} == {-0.25, 0.0, 0.25}
    assert {np.sign(trial[0][0]) for trial in trials} == {-1.0, 1.0}


def test_written_and_read(tmp_path):
    """A problem file keeps what changes and when, beside the model, which stays as it is;
    predictions agree.
    """
    robot = arm()
    drifts = [
        (instance(robot, f"{PAYLOAD}.from"), np.array([0.4, -0.25])),
        (instance(robot, "parameter_drift:lower_mass.ramp"), np.array([0.2])),
    ]
    changing = robot.simulator.with_effects((), drifts)
    read = load(write_problem(Problem("arm", changing, robot.data, epsilon=1e-4), tmp_path))
    wanted = changing.predict(changing.nominal[None], robot.data.segments())
    found = read.simulator.predict(changing.nominal[None], read.trajectories.segments())
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)  # MJCF keeps about six digits
    assert (
        np.abs(
            wanted - robot.simulator.predict(changing.nominal[None], robot.data.segments())
        ).max()
        > 1e-2
    )
