"""What a diagnosis keeps for its pictures says the same as its result."""

import numpy as np
import pytest
from scipy import stats

from dropo import Diagnose
from dropo.diagnosis.findings.figures import own_axis
from dropo.diagnosis.search.invariance import regimes
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.windows import split
from tests.models.hidden_in_arm import SOME, instance, problem


@pytest.fixture(scope="module")
def hidden():
    """The data of an arm whose elbow has more damping than its model."""
    return problem([("joint_damping:elbow", [0.05])])


@pytest.fixture(scope="module")
def damped(hidden):
    """The diagnosis of an arm whose elbow has more damping than its model."""
    return Diagnose(SOME, length=5, windows=48).run(hidden)


def test_candidates_are_the_searchs(damped):
    """The accepted one is the cause with its gain on data held out; the others gain less."""
    (cause,), first = damped.causes, damped.figures.rounds[0]
    accepted = [bar for bar in first if bar.accepted]
    assert [bar.label for bar in accepted] == ["joint_damping:elbow"]
    gain = damped.gain
    assert (
        0.6 < accepted[0].gain / (gain * 48 * 5) < 1.05
    )  # as all candidates are compared, before everything is fitted to the end
    assert all(
        bar.gain < accepted[0].gain for bar in first if bar.gain is not None and not bar.accepted
    )
    assert damped.figures.needed < accepted[0].gain
    assert {bar.label.split(":")[0] for bar in first if not bar.told} == {
        other.effect for other in cause.confused_with
    }


def test_errors_follow_the_effects_own_axis(damped):
    """Over the joint's speed errors have a slope before, by more than three standard errors, and
    none after.
    """
    (shown,) = damped.figures.axes
    assert (shown.axis, shown.axis_unit, shown.signal) == ("qvel.elbow", "rad/s", "qvel.elbow")
    before, after = (stats.linregress(shown.x, values) for values in (shown.before, shown.after))
    assert abs(before.slope) > 3 * before.stderr
    assert abs(after.slope) < 4.5 * after.stderr


def test_a_true_cause_has_one_size(damped):
    """Damping: within 4.5 standard errors of one size in every part."""
    assert {"qvel.elbow", "time"} <= {one.variable for one in damped.figures.sizes}
    for one in damped.figures.sizes:
        np.testing.assert_array_less(np.abs(np.array(one.size) - 1), 4.5 * np.array(one.error))


@pytest.mark.study
def test_a_proxy_has_not_one_size(hidden):
    """Friction in the place of damping, where it alone may be named: its size differs with the
    joint's speed. The same of one fit is in test_selection.py.
    """
    proxy = Diagnose(("joint_friction",), length=5, windows=96).run(hidden)
    assert proxy.causes[0].effect == "joint_friction"
    assert next(one.p_value for one in proxy.figures.sizes if one.variable == "|qvel.elbow|") < 0.01


@pytest.mark.parametrize(
    ("label", "axis"),
    [
        ("actuator_gain:elbow_motor", "the command of elbow_motor"),
        ("actuator_lag:elbow_motor", "the change of the command of elbow_motor"),
        ("joint_damping:elbow", "qvel.elbow"),
    ],
)
def test_own_axis_is_one_of_the_regimes(label, axis):
    """The variable that an effect acts on goes by the same name wherever it is looked up."""
    arm = problem([])
    effect = instance(arm.simulator, label)
    library = Library(arm.simulator.with_effects([effect]), [effect], 0)
    windows = split(arm, 5, 24)[0]
    assert own_axis(library, effect) == axis
    assert axis in regimes(windows, library)


def test_forces_fall_where_the_cause_is(damped):
    """At the elbow most before; after, nothing is left there."""
    forces = damped.figures.forces
    elbow = forces.names.index("elbow")
    assert forces.there_before
    assert not forces.there_after
    assert forces.after[elbow] < 0.5 * forces.before[elbow]


def test_similarities_and_sums(damped):
    """A symmetric matrix with ones on its diagonal; a bridge that ends at 0 and stays small."""
    cosines = np.array(damped.figures.similarity.cosines)
    np.testing.assert_allclose(cosines, cosines.T, atol=1e-12)
    np.testing.assert_allclose(np.diagonal(cosines), 1)
    (sums,) = damped.figures.sums
    assert abs(sums.score[-1]) < 1e-9
    assert np.abs(sums.score).max() < 2.5


def test_motion_is_calibrated_after_and_not_before(damped):
    """Errors fall at every horizon; probabilities are nearly uniform after, which they are not
    before.
    """
    motion = damped.motion
    assert motion.held_out
    assert (motion.after.by_horizon <= 1.05 * motion.before.by_horizon).all()
    assert motion.after.by_horizon[-1] < 0.5 * motion.before.by_horizon[-1]
    worst = [stats.kstest(side.pit, "uniform").statistic for side in (motion.before, motion.after)]
    assert worst[1] < 0.05
    low, high = motion.after.band
    assert np.mean((motion.measured >= low) & (motion.measured <= high)) > 0.8


def test_nothing_hidden_has_pictures_too():
    """No cause: no evidence to show, forces and motion as they are."""
    found = Diagnose(("joint_damping", "joint_friction"), length=5, windows=24).run(problem([]))
    assert found.causes == found.figures.axes == found.figures.sizes == found.figures.sums == ()
    assert found.figures.forces.before == found.figures.forces.after
    assert found.motion.before.name == "the model as it is"
